"""Named counters: every drop, late sample or rejection of this room ends up here.

Rule: an outcome is counted where it is decided, under one name and at most one label, so
that two totals never overlap.
"""

from __future__ import annotations

from typing import Any

from groundstation.domain.events import Counter


class Tally:
    """Running totals by (name, label value)."""

    __slots__ = ("_totals",)

    def __init__(self) -> None:
        self._totals: dict[tuple[str, str], int] = {}

    def add(self, name: str, label: str = "", count: int = 1) -> None:
        """Add ``count`` to the total ``name``; ``label`` is ``key=value`` or empty."""
        key = (name, label)
        self._totals[key] = self._totals.get(key, 0) + count

    def total(self, name: str) -> int:
        """Sum of ``name`` over its labels."""
        return sum(value for (found, _), value in self._totals.items() if found == name)

    def counters(self) -> list[Counter]:
        """All totals, by name and label."""
        found = []
        for (name, label), value in sorted(self._totals.items()):
            key, _, text = label.partition("=")
            found.append(Counter(name, ((key, text),) if label else (), value))
        return found

    def state(self) -> dict[str, Any]:
        """Totals as a tree for a snapshot."""
        return {"totals": [[name, label, value] for (name, label), value in self._totals.items()]}

    def restore(self, tree: dict[str, Any]) -> None:
        """Take the totals of ``state()`` back."""
        self._totals = {(name, label): value for name, label, value in tree["totals"]}
