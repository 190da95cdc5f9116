"""What a method answered in one run, and how honest its regions were.

Exists so that every method is scored by one yardstick, whatever it holds: boxes, particles, a
grid or a covariance. Rule: regions are highest-density and horizontal; the credible level of
the truth is the share of the belief that is denser than the belief is at the truth, so a 90 %
region holds the truth exactly where its level is at most 0.9.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from groundstation.localization.problem import FloatArray

SHARES = (0.5, 0.9, 0.95)
"""Contents of the regions."""
_CELLS = 72
_REACH = 4.5
_BANDWIDTH = 0.9
"""Of Silverman's: the belief's points need not be normal."""


@dataclass(frozen=True, slots=True, eq=False)
class Answers:
    """One method's answers in one run at R times."""

    mean_enu_m: FloatArray
    """(R, 3) metres; NaN: none."""
    level: FloatArray
    """(R,) credible level of the truth, horizontal; NaN: the method has no region."""
    area_m2: FloatArray
    """(R, 3) of the regions of ``SHARES``; NaN: none."""
    drawn: FloatArray
    """(R, 3) 1 where the drawn polygons of the region hold the truth, 0 where not; NaN: none are drawn."""
    walking: FloatArray
    """(R,) P(the person walks); NaN: the method does not ask."""
    cpu_s: float = 0.0
    """Processor time of the run."""

    @classmethod
    def none(cls, times: int) -> Answers:
        """Nothing yet, for so many times."""
        return cls(
            np.full((times, 3), math.nan), np.full(times, math.nan), np.full((times, len(SHARES)), math.nan),
            np.full((times, len(SHARES)), math.nan), np.full(times, math.nan),
        )  # fmt: skip


def level_and_areas(
    density: FloatArray, cell_m2: float, row: int, column: int, offset: float = 0.5
) -> tuple[float, FloatArray]:
    """Credible level of the cell (row, column) and the areas (3,) of ``SHARES``, from masses of equal cells.

    Of the cell's own mass the share ``offset`` counts. A cell outside: level 1.
    """
    mass = density / density.sum()
    ordered = np.sort(mass.ravel())[::-1]
    reached = np.cumsum(ordered)
    areas = cell_m2 * (1.0 + np.searchsorted(reached, SHARES).astype(np.float64))
    if not (0 <= row < mass.shape[0] and 0 <= column < mass.shape[1]):
        return 1.0, areas
    own = mass[row, column]
    level = float(mass[mass > own].sum() + offset * own)
    return min(level, 1.0), areas


def points_region(
    points_en_m: FloatArray, weight: FloatArray, truth_en_m: FloatArray
) -> tuple[float, FloatArray]:
    """The same of weighted points (C, 2): a kernel estimate on cells along the belief's own axes."""
    weight = weight / weight.sum()
    mean = weight @ points_en_m
    offset = points_en_m - mean
    covariance = (offset.T * weight) @ offset + 1e-12 * np.eye(2)
    factor = np.linalg.cholesky(covariance)
    place = np.linalg.solve(factor, offset.T)
    truth = np.linalg.solve(factor, truth_en_m - mean)
    step = 2.0 * _REACH / _CELLS
    column = np.floor((place + _REACH) / step).astype(np.int64)
    within = ((column >= 0) & (column < _CELLS)).all(axis=0)
    index = column[0, within] * _CELLS + column[1, within]
    counts = np.bincount(index, weights=weight[within], minlength=_CELLS**2).reshape(_CELLS, _CELLS)
    effective = 1.0 / float(np.square(weight).sum())
    kernel = _BANDWIDTH * effective ** (-1.0 / 6.0) / step
    smooth: FloatArray = np.asarray(gaussian_filter(counts, kernel, mode="constant"), dtype=np.float64)
    where = np.floor((truth + _REACH) / step).astype(np.int64)
    cell_m2 = step * step * float(np.prod(np.diag(factor)))
    return level_and_areas(smooth, cell_m2, int(where[0]), int(where[1]))
