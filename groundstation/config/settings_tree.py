"""The settings dataclasses as a flat list of named leaves, and back.

Rule: names, kinds, defaults and documentation are read from the dataclasses themselves, so
that a setting is declared in one place.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from typing import Any, TypeVar, get_type_hints

UNITS: tuple[tuple[str, str], ...] = (
    ("_bytes_s", "bytes/s"),
    ("_m_s", "m/s"),
    ("_m2", "m²"),
    ("_db2", "dB²"),
    ("_dbm", "dBm"),
    ("_db", "dB"),
    ("_bytes", "bytes"),
    ("_percent", "%"),
    ("_probability", "0..1"),
    ("_rad", "rad"),
    ("_deg", "deg"),
    ("_hz", "Hz"),
    ("_ms", "ms"),
    ("_ns", "ns"),
    ("_us", "µs"),
    ("_h", "h"),
    ("_m", "m"),
    ("_s", "s"),
)
"""Unit of a setting by the ending of its name; the first that fits counts."""


@dataclass(frozen=True, slots=True)
class Leaf:
    """One setting as declared."""

    path: str
    """Dotted: ``measurement.window_age_s``."""
    annotation: Any
    """Type of its value."""
    default: Any
    doc: str
    """One line."""
    unit: str
    """By the name's ending; empty where there is none."""


@dataclass(frozen=True, slots=True)
class SettingValue:
    """One setting as it stands: what ``groundstation config show`` prints."""

    path: str
    """Dotted: ``measurement.window_age_s``."""
    value: Any
    origin: str
    """``command line``, ``environment NAME``, ``file PATH`` or ``default``."""
    default: Any
    unit: str
    """Empty where there is none."""
    doc: str
    """One line."""


@cache
def leaves(kind: type) -> tuple[Leaf, ...]:
    """Every setting below the dataclass ``kind``, in the order of declaration."""
    return tuple(_leaves(kind, kind(), ""))


def _leaves(kind: type, default: Any, prefix: str) -> list[Leaf]:
    hints, docs = get_type_hints(kind), field_docs(kind)
    found: list[Leaf] = []
    for item in fields(kind):
        path, value, annotation = prefix + item.name, getattr(default, item.name), hints[item.name]
        if is_section(annotation):
            found.extend(_leaves(annotation, value, path + "."))
        else:
            found.append(Leaf(path, annotation, value, docs.get(item.name, ""), unit_of(item.name)))
    return found


def is_section(annotation: Any) -> bool:
    """Whether a field of this type holds further settings."""
    return isinstance(annotation, type) and is_dataclass(annotation)


T = TypeVar("T")


def build(kind: type[T], values: dict[str, Any], prefix: str = "") -> T:
    """The dataclass ``kind`` from the values of all its leaves."""
    hints = get_type_hints(kind)
    arguments: dict[str, Any] = {}
    for name, annotation in hints.items():
        path = prefix + name
        arguments[name] = build(annotation, values, path + ".") if is_section(annotation) else values[path]
    return kind(**arguments)


def unit_of(name: str) -> str:
    """Unit by the ending of a setting's name."""
    return next((unit for ending, unit in UNITS if f"_{name}".endswith(ending)), "")


@cache
def field_docs(kind: type) -> dict[str, str]:
    """The docstring below each field of a dataclass, as one line."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(kind)))
    definition = tree.body[0]
    assert isinstance(definition, ast.ClassDef)
    docs: dict[str, str] = {}
    for statement, following in zip(definition.body, definition.body[1:], strict=False):
        if (
            isinstance(statement, ast.AnnAssign)
            and isinstance(statement.target, ast.Name)
            and isinstance(following, ast.Expr)
            and isinstance(following.value, ast.Constant)
            and isinstance(following.value.value, str)
        ):
            docs[statement.target.id] = " ".join(following.value.value.split())
    return docs
