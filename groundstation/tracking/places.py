"""Places that vehicles were at, thinned: what was met there is summed up, not listed.

Exists because passing twice over the same ground teaches little and memory is bounded. Rule:
a place stands where its first visit was; when the book is full the places are taken
further apart, oldest first, so that the whole flight stays covered.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from groundstation.localization.problem import FloatArray

VEHICLE, EAST, NORTH, UP, SUMS = range(5)
_COARSER = 1.5


class Places:
    """Rows of vehicle, east, north, up and sums, at least ``spacing_m`` apart for one vehicle."""

    def __init__(self, sums: int, spacing_m: float, maximum: int) -> None:
        self.spacing_m = spacing_m
        self._maximum = max(maximum, 2)
        self.rows: FloatArray = np.zeros((0, SUMS + sums))

    def add(self, vehicle_id: int, position_enu_m: Sequence[float], sums: Sequence[float]) -> None:
        """Take in what was met at a place; the vehicle's nearest place within the spacing gets it."""
        row = np.array([vehicle_id, *position_enu_m, *sums], dtype=np.float64)
        self._put(row)
        while len(self.rows) > self._maximum:
            self.spacing_m *= _COARSER
            kept, self.rows = self.rows, self.rows[:0]
            for row in kept:
                self._put(row)

    def _put(self, row: FloatArray) -> None:
        mine = np.flatnonzero(self.rows[:, VEHICLE] == row[VEHICLE])
        if mine.size:
            square = np.square(self.rows[mine, EAST:SUMS] - row[EAST:SUMS]).sum(axis=1)
            nearest = int(np.argmin(square))
            if square[nearest] <= self.spacing_m**2:
                self.rows[mine[nearest], SUMS:] += row[SUMS:]
                return
        self.rows = np.concatenate([self.rows, row[None]])

    def state(self) -> dict[str, Any]:
        """Everything, as arrays and plain values."""
        return {"spacing_m": self.spacing_m, "rows": self.rows.copy()}

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state`` gave."""
        self.spacing_m = float(tree["spacing_m"])
        self.rows = np.array(tree["rows"], dtype=np.float64).reshape(-1, self.rows.shape[1])
