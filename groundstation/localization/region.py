"""The search area as constraints of a convex program, in units of its own size.

Exists so that every convex program keeps to the same heights and outline. Rules: lengths count
in radii of the area from its centre, so that programs meet numbers near one; of a polygon that
is not convex the hull is taken, and the answer is clipped into the area afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from groundstation.localization.interior import Constraints
from groundstation.localization.problem import FloatArray, SearchArea

_FLAT = 1e-6
_PULL_IN = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """A convex search area in scaled coordinates (east, north, up)."""

    center_m: FloatArray
    """(3,) metres: where scaled coordinates begin, inside the area."""
    scale_m: float
    """Metres a unit."""
    half_height: float
    """Half of the span of heights, scaled; never quite zero."""
    faces: FloatArray
    """(f, 3): n_east, n_north, offset with n·x ≤ offset; no rows for a disc of radius 1."""

    @classmethod
    def of(cls, area: SearchArea) -> Region:
        """The disc, or the polygon's convex hull, between the height limits."""
        middle = 0.5 * (area.height_min_m + area.height_max_m)
        flat = np.array(area.center_enu_m[:2], dtype=np.float64)
        scale, faces = area.radius_m, np.zeros((0, 3))
        if area.polygon_en_m is not None:
            hull = shapely.convex_hull(area.polygon_en_m)
            flat = np.array([hull.centroid.x, hull.centroid.y])
            corners = shapely.get_coordinates(shapely.normalize(hull).reverse())
            scale = float(np.hypot(*(corners - flat).T).max())
            corners = (corners - flat) / scale
            edge = np.diff(corners, axis=0)
            normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            faces = np.column_stack([normal, (normal * corners[:-1]).sum(axis=1)])
        half = max(0.5 * (area.height_max_m - area.height_min_m) / scale, _FLAT)
        return cls(np.array([flat[0], flat[1], middle]), scale, half, faces)

    def scaled(self, position_enu_m: FloatArray) -> FloatArray:
        """Metres → scaled, (…, 3)."""
        result: FloatArray = (position_enu_m - self.center_m) / self.scale_m
        return result

    def metres(self, scaled: FloatArray) -> FloatArray:
        """Scaled → metres, (…, 3)."""
        result: FloatArray = self.center_m + self.scale_m * scaled
        return result

    def constraints(self, unknowns: int = 3) -> Constraints:
        """Heights and outline over the first three of so many unknowns."""
        sides = len(self.faces) or 1
        offset = np.concatenate([[self.half_height] * 2, self.faces[:, 2] if len(self.faces) else [1.0]])
        slope, curvature = np.zeros((2 + sides, unknowns)), np.zeros((2 + sides, unknowns))
        slope[0, 2], slope[1, 2] = 1.0, -1.0
        if len(self.faces):
            slope[2:, :2] = -self.faces[:, :2]
        else:
            curvature[2, :2] = 2.0
        return Constraints(offset, slope, curvature, np.ones(2 + sides))

    def inside(self, position_enu_m: FloatArray) -> FloatArray:
        """Places (N, 3) in metres → scaled places strictly inside, each moved a little to the centre."""
        at = self.scaled(position_enu_m)
        most = (1.0 - _PULL_IN) * self.half_height
        height = np.clip(at[:, 2], -most, most)
        if len(self.faces):
            # How far out along its own ray from the centre each place lies: 1 is the outline.
            reach = (at[:, :2] @ self.faces[:, :2].T / self.faces[:, 2]).max(axis=1)
        else:
            reach = np.hypot(at[:, 0], at[:, 1])
        limited = np.minimum(reach, 1.0 - _PULL_IN) / np.maximum(reach, 1e-12)
        return np.column_stack([at[:, :2] * limited[:, None], height])
