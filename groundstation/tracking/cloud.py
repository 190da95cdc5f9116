"""A cloud of points as boxes and as a density, so that nothing else need know of particles.

Exists because everything behind the tracker reads boxes with a share of the belief each, and because
a walker who stops hands his whereabouts to a belief of boxes. Rule: a cloud of some hundred
points says nothing of its own grain: it is smoothed (a Gaussian kernel, Silverman's width) before
it is told, or its regions would be too small.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from groundstation.localization.mesh import Mesh
from groundstation.localization.problem import FloatArray, SearchArea

_LEVELS = 3
_CELLS = 48
_KERNEL_CELLS = 1.25
_NEGLIGIBLE = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Smoothed counts on equal boxes inside the search area."""

    corner_enu_m: FloatArray
    """(3,) the lowest corner, metres."""
    half_m: float
    """Half the width of a box."""
    half_height_m: float
    mass: FloatArray
    """(east, north, up) share of the belief in each box."""

    @classmethod
    def of(cls, points_enu_m: FloatArray, area: SearchArea, minimum_half_m: float) -> Cloud:
        """Of N equally likely points (N, 3)."""
        flat = points_enu_m[:, :2]
        # Of the narrower side: a belief may be a ray, and one that points anywhere.
        spread = float(np.sqrt(np.linalg.eigvalsh(np.cov(flat.T))[0].clip(0.0)))
        kernel = spread * len(flat) ** (-1.0 / 6.0)
        low, high = flat.min(axis=0), flat.max(axis=0)
        half = max(0.5 * kernel / _KERNEL_CELLS, 0.5 * float((high - low).max()) / _CELLS, minimum_half_m)
        count = np.ceil((high - low) / (2.0 * half) + 8.0 * _KERNEL_CELLS).astype(int)
        height = max(area.height_max_m - area.height_min_m, 2.0 * minimum_half_m)
        half_z = 0.5 * height / _LEVELS
        start = np.array(
            [*(0.5 * (low + high) - count * half), 0.5 * (area.height_min_m + area.height_max_m - height)]
        )
        width = 2.0 * np.array([half, half, half_z])
        index = np.floor((points_enu_m - start) / width).astype(np.int64)
        shape = (int(count[0]), int(count[1]), _LEVELS)
        index = np.clip(index, 0, np.array(shape) - 1)
        number = (index[:, 0] * shape[1] + index[:, 1]) * shape[2] + index[:, 2]
        counts = np.bincount(number, minlength=shape[0] * shape[1] * shape[2]).reshape(shape).astype(float)
        mass = gaussian_filter(counts, (_KERNEL_CELLS, _KERNEL_CELLS, 0.0), mode="constant")
        middle = start + width * (np.argwhere(np.ones(shape)) + 0.5)
        mass *= area.contains(middle[:, 0], middle[:, 1]).reshape(shape)
        return cls(start, half, half_z, mass / mass.sum())

    def boxes(self) -> tuple[Mesh, FloatArray]:
        """The boxes that hold anything, and the share (C,) of the belief in each."""
        used = np.argwhere(self.mass > _NEGLIGIBLE * self.mass.max())
        half = np.array([self.half_m, self.half_m, self.half_height_m])
        center = self.corner_enu_m + half * (2.0 * used + 1.0)
        share = self.mass[tuple(used.T)]
        volume = np.full(len(used), np.log(8.0 * half.prod()))
        return Mesh(center, np.tile(half[1:], (len(used), 1)), volume), share / share.sum()

    def log_density(self, center_enu_m: FloatArray, half_m: FloatArray, floor_per_m2: float) -> FloatArray:
        """(C,) log of the density per m², averaged over boxes (C, 3), half (C, 2), plus a floor."""
        flat = np.pad(self.mass.sum(axis=2), ((1, 0), (1, 0)))
        reached = flat.cumsum(axis=0).cumsum(axis=1)

        def up_to(east_m: FloatArray, north_m: FloatArray) -> FloatArray:
            where = np.stack([east_m, north_m]) - self.corner_enu_m[:2, None]
            return np.asarray(
                map_coordinates(reached, where / (2.0 * self.half_m), order=1, mode="nearest"),
                dtype=np.float64,
            )

        half = half_m[:, 0]
        west, east = center_enu_m[:, 0] - half, center_enu_m[:, 0] + half
        south, north = center_enu_m[:, 1] - half, center_enu_m[:, 1] + half
        inside = up_to(east, north) - up_to(west, north) - up_to(east, south) + up_to(west, south)
        result: FloatArray = np.log(np.maximum(inside, 0.0) / (4.0 * half * half) + floor_per_m2)
        return result

    def state(self) -> dict[str, Any]:
        """As arrays and plain values."""
        return {
            "corner_enu_m": self.corner_enu_m.copy(),
            "half_m": self.half_m,
            "half_height_m": self.half_height_m,
            "mass": self.mass.copy(),
        }

    @classmethod
    def restore(cls, tree: dict[str, Any]) -> Cloud:
        """The reverse."""
        mass = np.array(tree["mass"], dtype=np.float64)
        corner = np.array(tree["corner_enu_m"], dtype=np.float64)
        return cls(corner, float(tree["half_m"]), float(tree["half_height_m"]), mass)
