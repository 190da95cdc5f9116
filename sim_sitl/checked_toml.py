"""Reads TOML tables and says precisely what is wrong: file, key, what was seen, what is needed.

Keeps the rule that a malformed file costs its author one clear line, and that a key nobody
reads is a mistake (a typing error would otherwise silently become a default).
"""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any

from groundstation.domain.errors import InputError

_REQUIRED: Any = object()


def read_toml(text: str, file: str) -> Table:
    """The file's top table.

    Raises:
        InputError: the text is not TOML.
    """
    try:
        return Table(tomllib.loads(text), file, "")
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{file}: not valid TOML: {error}") from None


def read_toml_file(path: Path) -> Table:
    """The top table of the file at ``path``.

    Raises:
        InputError: the file cannot be read, or is not TOML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); needed: a TOML file") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text; needed: a TOML file") from None
    return read_toml(text, str(path))


class Table:
    """One table; every getter consumes its key, and ``finish`` refuses what is left."""

    def __init__(self, values: dict[str, Any], file: str, prefix: str) -> None:
        self._values = values
        self._file = file
        self._prefix = prefix
        self._seen: list[str] = []

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def wrong(self, key: str, seen: object, needed: str) -> InputError:
        """The error for ``key``."""
        return InputError(f"{self._file}: {self._prefix}{key}: saw {seen!r}; needed: {needed}")

    def _take(self, key: str, default: Any, needed: str) -> Any:
        self._seen.append(key)
        if key in self._values:
            return self._values[key]
        if default is _REQUIRED:
            raise InputError(f"{self._file}: {self._prefix}{key}: missing; needed: {needed}")
        return default

    def number(
        self, key: str, default: Any = _REQUIRED, *, low: float = -math.inf, high: float = math.inf
    ) -> float:
        """A finite number in [low, high]."""
        needed = "a number" + _range(low, high)
        value = self._take(key, default, needed)
        return self._number(key, value, low, high, needed)

    def _number(self, key: str, value: Any, low: float, high: float, needed: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.wrong(key, value, needed)
        if not low <= value <= high:
            raise self.wrong(key, value, needed)
        return float(value)

    def integer(self, key: str, default: Any = _REQUIRED, *, low: int, high: int) -> int:
        """A whole number in [low, high]; a decimal string is taken too (beyond 2⁶³)."""
        needed = f"a whole number from {low} to {high}"
        value = self._take(key, default, needed)
        if isinstance(value, str) and value.isascii() and value.isdigit():
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.wrong(key, value, needed)
        return value

    def text(self, key: str, default: Any = _REQUIRED, *, choices: tuple[str, ...] = ()) -> str:
        """A string, one of ``choices`` if there are any."""
        needed = " or ".join(f'"{choice}"' for choice in choices) if choices else "text"
        value = self._take(key, default, needed)
        if not isinstance(value, str) or (choices and value not in choices):
            raise self.wrong(key, value, needed)
        return value

    def numbers(
        self,
        key: str,
        count: int,
        default: Any = _REQUIRED,
        *,
        low: float = -math.inf,
        high: float = math.inf,
    ) -> tuple[float, ...]:
        """An array of ``count`` numbers in [low, high]."""
        needed = f"an array of {count} numbers" + _range(low, high)
        value = self._take(key, default, needed)
        if not isinstance(value, list | tuple) or len(value) != count:
            raise self.wrong(key, value, needed)
        return tuple(self._number(key, item, low, high, needed) for item in value)

    def interval(
        self, key: str, default: Any = _REQUIRED, *, low: float = -math.inf, high: float = math.inf
    ) -> tuple[float, float]:
        """An array [least, greatest] within [low, high]."""
        least, greatest = self.numbers(key, 2, default, low=low, high=high)
        if least > greatest:
            raise self.wrong(key, [least, greatest], "[least, greatest] in this order")
        return least, greatest

    def corners(self, key: str) -> tuple[tuple[float, float], ...]:
        """A polygon: at least three [east, north] corners, metres, not repeated at the end."""
        needed = "an array of at least three [east_m, north_m] corners"
        value = self._take(key, _REQUIRED, needed)
        if not isinstance(value, list) or len(value) < 3:
            raise self.wrong(key, value, needed)
        ring: list[tuple[float, float]] = []
        for corner in value:
            if not isinstance(corner, list) or len(corner) != 2:
                raise self.wrong(key, corner, needed)
            east, north = (self._number(key, item, -1e5, 1e5, needed) for item in corner)
            ring.append((east, north))
        if ring[0] == ring[-1]:
            ring.pop()
        if len(ring) < 3:
            raise self.wrong(key, value, needed)
        return tuple(ring)

    def table(self, key: str, *, required: bool = False) -> Table:
        """The sub-table ``key``; an empty one where it is missing and not required."""
        value = self._take(key, _REQUIRED if required else {}, f"a table [{self._prefix}{key}]")
        if not isinstance(value, dict):
            raise self.wrong(key, value, f"a table [{self._prefix}{key}]")
        return Table(value, self._file, f"{self._prefix}{key}.")

    def tables(self, key: str) -> list[Table]:
        """The tables of an array of tables ``[[key]]``."""
        needed = f"tables [[{self._prefix}{key}]]"
        value = self._take(key, [], needed)
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.wrong(key, value, needed)
        return [Table(item, self._file, f"{self._prefix}{key}[{i}].") for i, item in enumerate(value)]

    def finish(self) -> None:
        """Raises InputError for the first key that nobody asked for."""
        for key in self._values:
            if key not in self._seen:
                known = ", ".join(sorted(self._seen))
                raise InputError(f"{self._file}: {self._prefix}{key}: unknown key; known here: {known}")


def _range(low: float, high: float) -> str:
    if low == -math.inf and high == math.inf:
        return ""
    if high == math.inf:
        return f" of at least {low:g}"
    if low == -math.inf:
        return f" of at most {high:g}"
    return f" from {low:g} to {high:g}"
