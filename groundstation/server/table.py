"""One table of the picture: rows by key, what changed since the last delta, and a bound.

Rule: a key changed ten times between two deltas goes out once; a key that went away goes
out as removed, with the reason, even when it never went out before.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, Literal, TypeVar

from groundstation.server import wire

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")
Row = TypeVar("Row", bound=wire.Model)

RemovedKind = Literal[
    "vehicle", "link", "target", "regions", "explanation", "proposal", "command", "connection"
]


class Table(Generic[Key, Value, Row]):
    """Values by key, rendered to rows only when somebody looks."""

    def __init__(
        self,
        kind: RemovedKind,
        limit: int,
        render: Callable[[Key, Value], Row],
        name: Callable[[Key], str] = str,
    ) -> None:
        """``limit`` rows at most: the one not updated for longest gives way."""
        self._kind: RemovedKind = kind
        self._limit = limit
        self._render = render
        self._name = name
        self._values: dict[Key, Value] = {}
        self._changed: dict[Key, None] = {}
        self._removed: dict[Key, str] = {}
        self.evicted_total = 0

    def __len__(self) -> int:
        return len(self._values)

    def __contains__(self, key: Key) -> bool:
        return key in self._values

    @property
    def dirty(self) -> bool:
        """Whether a delta would say something."""
        return bool(self._changed or self._removed)

    def get(self, key: Key) -> Value | None:
        """The newest value."""
        return self._values.get(key)

    def put(self, key: Key, value: Value) -> Key | None:
        """Newest value of ``key``; it becomes the most recently updated. Returns who gave way, if any."""
        self._values.pop(key, None)
        self._values[key] = value
        self._changed[key] = None
        self._removed.pop(key, None)
        if len(self._values) <= self._limit:
            return None
        oldest = next(iter(self._values))
        self.remove(oldest, "evicted: too many rows")
        self.evicted_total += 1
        return oldest

    def remove(self, key: Key, reason: str) -> bool:
        """Take a row away; False if it was not there."""
        if self._values.pop(key, None) is None:
            return False
        self._changed.pop(key, None)
        self._removed[key] = reason
        return True

    def row(self, key: Key) -> Row | None:
        """The row of one key."""
        value = self._values.get(key)
        return None if value is None else self._render(key, value)

    def rows(self) -> list[Row]:
        """All rows in order of insertion or last update."""
        return [self._render(key, value) for key, value in self._values.items()]

    def take_changed(self) -> list[Row]:
        """Rows changed since the last call."""
        changed = [self._render(key, self._values[key]) for key in self._changed]
        self._changed.clear()
        return changed

    def take_removed(self) -> list[wire.Removed]:
        """Rows taken away since the last call."""
        removed = [
            wire.Removed(kind=self._kind, key=self._name(key), reason=reason)
            for key, reason in self._removed.items()
        ]
        self._removed.clear()
        return removed
