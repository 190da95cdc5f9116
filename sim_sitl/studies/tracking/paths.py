"""Where the vehicles fly: three paths at one speed.

Exists because movement is what makes a beacon in rubble findable, and how much depends on the
path. Rule: a path is a function of time alone, given its centre: constant speed, constant
height, positions in closed form. ENU, metres, centred on the search area.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from groundstation.localization.problem import FloatArray

_NEARLY_NO_CLIMB_M_S = 1e-9


class Shape(Enum):
    """What the vehicles do."""

    ORBIT = "orbit"
    """Stay on the circle R₀ round the area's centre."""
    CONTRACTING = "contracting"
    """The circle round the area's centre shrinks."""
    ORACLE = "oracle"
    """Each vehicle spirals from its place on the circle R₀ round the true target, which no method is told."""


@dataclass(frozen=True, slots=True)
class Path:
    """Vehicles that start evenly on the circle R₀."""

    shape: Shape
    """What they do."""
    vehicles: int = 4
    """K."""
    radius_m: float = 100.0
    """R₀: of the circle that they start on and of the search area."""
    height_m: float = 50.0
    """Of all vehicles, all the time."""
    speed_m_s: float = 8.0
    """Of each vehicle, all the time."""
    last_radius_m: float = 20.0
    """Distance from the spiral's centre at its end (not of ``ORBIT``)."""
    spiral_s: float = 120.0
    """How long the spiral takes."""

    def positions(self, time_s: FloatArray, target_enu_m: FloatArray) -> FloatArray:
        """(T, K, 3) at ``time_s`` (T,), 0 at the start; ``target_enu_m`` (3,) is used by ``ORACLE`` alone."""
        start_rad = 2.0 * math.pi * np.arange(self.vehicles) / self.vehicles
        start = self.radius_m * np.stack([np.cos(start_rad), np.sin(start_rad)], axis=-1)
        center = target_enu_m[:2] if self.shape is Shape.ORACLE else np.zeros(2)
        positions = np.empty((time_s.size, self.vehicles, 3))
        positions[..., 2] = self.height_m
        for vehicle in range(self.vehicles):
            positions[:, vehicle, :2] = center + self._spiral(time_s, start[vehicle] - center)
        return positions

    def _spiral(self, time_s: FloatArray, start_en_m: FloatArray) -> FloatArray:
        """(T, 2) from the centre: the distance changes evenly, the rest of the speed goes round."""
        first = max(float(np.hypot(*start_en_m)), 1.0)
        angle = math.atan2(start_en_m[1], start_en_m[0])
        last = first if self.shape is Shape.ORBIT else self.last_radius_m
        outward_m_s = (last - first) / self.spiral_s
        around_m_s = math.sqrt(self.speed_m_s**2 - outward_m_s**2)
        distance = first + outward_m_s * time_s
        if abs(outward_m_s) < _NEARLY_NO_CLIMB_M_S:
            turn = around_m_s * time_s / first
        else:
            # The integral of v/r over time.
            turn = around_m_s / outward_m_s * np.log(distance / first)
        return np.stack([distance * np.cos(angle + turn), distance * np.sin(angle + turn)], axis=-1)
