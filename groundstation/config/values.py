"""One value of one setting: read strictly, refused with what is needed.

Rule: a file's value must have the setting's own kind (``"5"`` is no number, ``1`` is not
true); from the environment and the command line everything comes as text and is read as
its kind. What is negative, or out of a range that the name implies, is refused here,
before any engine sees it.
"""

from __future__ import annotations

import math
import types
import typing
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import orjson
from pydantic import TypeAdapter, ValidationError

from groundstation.config.settings_tree import Leaf, is_section
from groundstation.domain.errors import InputError

_NONE_WORDS = ("", "none", "null")
_NOT_NEGATIVE = frozenset({"s", "ms", "us", "ns", "h", "Hz", "bytes", "bytes/s", "m/s", "dB²", "m²"})
_RANGES: dict[str, tuple[float, float]] = {
    "port": (0, 65535),
    "system_id": (1, 255),
    "component_id": (1, 255),
}


def read_value(leaf: Leaf, seen: Any, origin: str, text: bool) -> Any:
    """``seen`` as the value of ``leaf``.

    ``origin`` stands in front of the error; ``text``: whether ``seen`` came as text.

    Raises:
        InputError: what was seen, what is needed.
    """
    optional, annotation = _optional(leaf.annotation)
    if optional and (seen is None or (isinstance(seen, str) and seen.strip().lower() in _NONE_WORDS)):
        return None
    try:
        value = (
            _from_text(annotation, seen) if text and isinstance(seen, str) else _from_file(annotation, seen)
        )
    except (ValidationError, orjson.JSONDecodeError, orjson.JSONEncodeError) as error:
        raise _refusal(leaf, seen, origin, needed(leaf.annotation)) from error
    _check_range(leaf, value, seen, origin)
    return value


def needed(annotation: Any) -> str:
    """What a value of this type looks like, in words."""
    optional, inner = _optional(annotation)
    if optional:
        return f"{needed(inner)}, or none"
    origin, arguments = get_origin(inner), get_args(inner)
    words = {int: "a whole number", float: "a number", bool: "true or false", str: "text", Path: "a path"}
    if inner in words:
        return words[inner]
    if origin is Literal:
        return "one of " + ", ".join(str(item) for item in arguments)
    if isinstance(inner, type) and issubclass(inner, Enum):
        return "one of " + ", ".join(str(item.value) for item in inner)
    if origin is tuple and len(arguments) == 2 and arguments[1] is Ellipsis:
        return f"a list, each {needed(arguments[0])}"
    if origin is tuple:
        return "a list of " + ", ".join(needed(item) for item in arguments)
    if is_section(inner):
        return "a table of " + ", ".join(typing.get_type_hints(inner))
    return str(inner)


def _optional(annotation: Any) -> tuple[bool, Any]:
    if get_origin(annotation) in (typing.Union, types.UnionType):
        rest = [item for item in get_args(annotation) if item is not type(None)]
        if len(rest) < len(get_args(annotation)):
            return True, rest[0] if len(rest) == 1 else typing.Union[tuple(rest)]  # noqa: UP007
    return False, annotation


@cache
def _adapter(annotation: Any) -> TypeAdapter[Any]:
    return TypeAdapter(annotation)


def _from_file(annotation: Any, seen: Any) -> Any:
    # JSON is what strict reading is defined for: a list is a tuple there, a word an Enum or a Path.
    if isinstance(seen, float) and not math.isfinite(seen):
        return seen
    data = orjson.dumps(seen, option=orjson.OPT_PASSTHROUGH_DATETIME)
    return _adapter(annotation).validate_json(data, strict=True)


def _from_text(annotation: Any, seen: str) -> Any:
    if get_origin(annotation) is not tuple:
        return _adapter(annotation).validate_strings(seen.strip())
    if seen.lstrip().startswith("["):
        return _adapter(annotation).validate_json(seen, strict=True)
    items = [item.strip() for item in seen.split(",")] if seen.strip() else []
    inner = get_args(annotation)[0]
    return tuple(_adapter(inner).validate_strings(item) for item in items)


def _check_range(leaf: Leaf, value: Any, seen: Any, origin: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return
    if not math.isfinite(value):
        raise _refusal(leaf, seen, origin, "a finite number")
    name = leaf.path.rpartition(".")[2]
    low, high = _RANGES.get(name, (-math.inf, math.inf))
    if leaf.unit == "0..1":
        low, high = 0.0, 1.0
    elif leaf.unit in _NOT_NEGATIVE:
        low = 0.0
    if not low <= value <= high:
        limits = f"from {low:g} to {high:g}" if math.isfinite(high) else f"of {low:g} or more"
        raise _refusal(leaf, seen, origin, f"a number {limits}")


def _refusal(leaf: Leaf, seen: Any, origin: str, need: str) -> InputError:
    return InputError(f"{origin}: {leaf.path} is {seen!r}; {need} is needed (default {show(leaf.default)})")


def show(value: Any) -> str:
    """A value as it would stand in a settings file."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(show(item) for item in value) + "]"
    if is_section(type(value)):
        names = type(value).__dataclass_fields__
        return "{" + ", ".join(f"{name} = {show(getattr(value, name))}" for name in names) + "}"
    if isinstance(value, Enum):
        return show(value.value)
    return orjson.dumps(str(value)).decode() if isinstance(value, str | Path) else repr(value)
