"""Puts the layers over each other and remembers where each value came from."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from groundstation.config.schema import Config
from groundstation.config.settings_tree import Leaf, SettingValue, build, leaves
from groundstation.config.values import read_value, show
from groundstation.domain.errors import GroundstationError, InputError

ENVIRONMENT_PREFIX = "GROUNDSTATION_"
COMMAND_LINE = "command line"
DEFAULT = "default"


@dataclass(frozen=True, slots=True)
class LoadedConfig:
    """The settings in force, and where they came from."""

    config: Config
    values: tuple[SettingValue, ...]
    """Every setting, in the order of declaration."""

    def describe(self) -> list[SettingValue]:
        """Every value with its origin, unit and documentation."""
        return list(self.values)

    def text(self) -> str:
        """``describe`` as a settings file: what ``groundstation config show`` prints."""
        lines: list[str] = []
        section = ""
        for value in self.values:
            table, _, name = value.path.rpartition(".")
            if table != section:
                section = table
                lines += ["", f"[{table}]"]
            entry = f"{name} = {show(value.value)}"
            lines.append(entry if value.value is not None else f"# {entry}")
            unit = f" [{value.unit}]" if value.unit else ""
            lines.append(f"    # {value.origin}{unit}: {value.doc}")
        return "\n".join(lines) + "\n"

    def plain(self) -> dict[str, str]:
        """Every value as text by its dotted name: for a session's metadata."""
        return {value.path: show(value.value) for value in self.values}


def load_config(
    command_line: Mapping[str, Any] | None = None,
    environment: Mapping[str, str] | None = None,
    file: Path | None = None,
) -> LoadedConfig:
    """Settings by command line > environment > file > default.

    ``command_line``: by dotted name (``server.port``); text is read as the setting's kind;
    None means not given. ``environment``: the process's, where ``GROUNDSTATION_SERVER__PORT``
    sets ``server.port``. ``file``: TOML; a relative path in it starts from the file's folder.

    Raises:
        InputError: an unknown name or a wrong value: where, what was seen, what is needed.
    """
    known = {leaf.path: leaf for leaf in leaves(Config)}
    values = {path: leaf.default for path, leaf in known.items()}
    origins = dict.fromkeys(known, DEFAULT)
    if file is not None:
        _apply_file(file, known, values, origins)
    _apply_environment(environment or {}, known, values, origins)
    for path, seen in (command_line or {}).items():
        if seen is not None:
            leaf = _known_leaf(path, known, COMMAND_LINE)
            values[path] = read_value(leaf, _plain(seen), COMMAND_LINE, text=True)
            origins[path] = COMMAND_LINE
    try:
        config = build(Config, values)
    except GroundstationError:
        raise
    except ValueError as error:
        raise InputError(f"settings: {error}") from error
    _check_pairs(values, origins)
    described = [
        SettingValue(leaf.path, values[leaf.path], origins[leaf.path], leaf.default, leaf.unit, leaf.doc)
        for leaf in known.values()
    ]
    return LoadedConfig(config, tuple(described))


def parse_assignments(assignments: Iterable[str]) -> dict[str, str]:
    """``["server.port=8001", …]`` of the command line as a mapping. Raises InputError."""
    parsed: dict[str, str] = {}
    for assignment in assignments:
        name, separator, value = assignment.partition("=")
        if not separator or not name.strip():
            raise InputError(f"{COMMAND_LINE}: {assignment!r} sets nothing; NAME=VALUE is needed")
        parsed[name.strip()] = value
    return parsed


def _apply_file(file: Path, known: dict[str, Leaf], values: dict[str, Any], origins: dict[str, str]) -> None:
    try:
        document = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{file}: not valid TOML: {error}") from error
    for path, seen in _flatten(document, known, file):
        leaf = _known_leaf(path, known, str(file))
        values[path] = _beside(read_value(leaf, seen, str(file), text=False), file)
        origins[path] = f"file {file}"


def _flatten(
    table: dict[str, Any], known: dict[str, Leaf], file: Path, prefix: str = ""
) -> Iterable[tuple[str, Any]]:
    for name, seen in table.items():
        path = prefix + name
        is_table = any(other.startswith(path + ".") for other in known)
        if isinstance(seen, dict) and (is_table or path not in known):
            if not is_table:
                _known_leaf(path, known, str(file))
            yield from _flatten(seen, known, file, path + ".")
        elif is_table:
            raise InputError(f"{file}: {path} is {seen!r}; a table [{path}] is needed")
        else:
            yield path, seen


def _beside(value: Any, file: Path) -> Any:
    return file.parent / value if isinstance(value, Path) else value


def _apply_environment(
    environment: Mapping[str, str], known: dict[str, Leaf], values: dict[str, Any], origins: dict[str, str]
) -> None:
    for name in sorted(environment):
        if not name.startswith(ENVIRONMENT_PREFIX):
            continue
        origin = f"environment {name}"
        path = name.removeprefix(ENVIRONMENT_PREFIX).lower().replace("__", ".")
        leaf = _known_leaf(path, known, origin)
        values[path] = read_value(leaf, environment[name], origin, text=True)
        origins[path] = origin


def _known_leaf(path: str, known: dict[str, Leaf], origin: str) -> Leaf:
    if path in known:
        return known[path]
    below = [other for other in known if other.startswith(path + ".")]
    if below:
        raise InputError(f"{origin}: {path} is a group of settings; one of {', '.join(below)} is needed")
    close = difflib.get_close_matches(path, known, n=3, cutoff=0.5)
    # The right name in the wrong table is as likely as a misspelt one.
    close += [other for other in known if other.rpartition(".")[2] == path.rpartition(".")[2]]
    hint = f"; did you mean {' or '.join(dict.fromkeys(close))}?" if close else ""
    raise InputError(f"{origin}: there is no setting {path}{hint} ('groundstation config show' lists all)")


def _plain(seen: Any) -> Any:
    if isinstance(seen, Path):
        return str(seen)
    return list(seen) if isinstance(seen, tuple) else seen


def _check_pairs(values: dict[str, Any], origins: dict[str, str]) -> None:
    for low, high in (
        ("limits.floor_m", "limits.ceiling_m"),
        ("target.height_min_m", "target.height_max_m"),
    ):
        if not values[low] < values[high]:
            raise InputError(
                f"{low} is {values[low]:g} ({origins[low]}) and {high} is {values[high]:g} "
                f"({origins[high]}); the first must be the smaller"
            )
    for name in ("separation_m", "fence_margin_m", "max_leg_m", "floor_m"):
        path = f"limits.{name}"
        if values[path] < 0:
            raise InputError(f"{origins[path]}: {path} is {values[path]:g}; 0 or more is needed")
