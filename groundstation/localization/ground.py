"""Heights of the ground under a search area, in the frame of a localisation problem.

Exists apart from ``problem`` so that what looks up a height need not know what a problem is.
Rule: it knows a grid and nothing of files or datums; outside the grid its edge goes on, and
what nobody measured is marked so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.domain.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class GroundHeights:
    """Heights of the ground at the nodes of a regular grid, linear between them; its edge goes on outside."""

    west_m: float
    """East coordinate of the first column, metres."""
    south_m: float
    """North coordinate of the first row, metres."""
    step_m: float
    """Distance of neighbouring nodes, metres."""
    up_m: NDArray[np.float64]
    """(rows from the south, columns from the west) height of the ground in the ENU frame, metres."""
    known: NDArray[np.bool_]
    """Of the same shape: whether somebody measured it; False: it is taken for the ground's height."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "up_m", np.asarray(self.up_m, dtype=np.float64))
        object.__setattr__(self, "known", np.asarray(self.known, dtype=bool))
        if self.up_m.ndim != 2 or min(self.up_m.shape) < 2 or self.known.shape != self.up_m.shape:
            raise InputError(
                f"ground heights have shape {self.up_m.shape}, known ones {self.known.shape};"
                " the same two by two or more are needed"
            )
        if not (np.isfinite(self.up_m).all() and math.isfinite(self.step_m) and self.step_m > 0.0):
            raise InputError("ground heights must be finite, their nodes a positive distance apart")

    def at(self, east_m: NDArray[np.float64], north_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height of the ground under places, metres ENU."""
        rows, columns = self.up_m.shape
        x = np.clip((np.asarray(east_m) - self.west_m) / self.step_m, 0.0, columns - 1.0)
        y = np.clip((np.asarray(north_m) - self.south_m) / self.step_m, 0.0, rows - 1.0)
        column = np.minimum(x.astype(np.int64), columns - 2)
        row = np.minimum(y.astype(np.int64), rows - 2)
        x, y = x - column, y - row
        up = self.up_m
        south = (1.0 - x) * up[row, column] + x * up[row, column + 1]
        north = (1.0 - x) * up[row + 1, column] + x * up[row + 1, column + 1]
        result: NDArray[np.float64] = (1.0 - y) * south + y * north
        return result

    def is_known(self, east_m: float, north_m: float) -> bool:
        """Whether the ground under a place was measured, by the node nearest to it."""
        rows, columns = self.up_m.shape
        column = round((east_m - self.west_m) / self.step_m)
        row = round((north_m - self.south_m) / self.step_m)
        return 0 <= column < columns and 0 <= row < rows and bool(self.known[row, column])
