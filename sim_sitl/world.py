"""Obstacles between a beacon and a vehicle: what the straight line passes through, and for how long.

Keeps the rule that line of sight is geometry and nothing else: no probability says whether a
link is obstructed, so it changes exactly when a vehicle flies behind something.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from groundstation.domain.geometry import Enu, distance_m
from sim_sitl.scenario import BeaconSpec, Obstacle, point_in_ring

MIN_ELEVATION_SINE = 0.05
"""Below this elevation a buried beacon's cover counts as if it were seen at about 3°."""


@dataclass(frozen=True, slots=True)
class Obstruction:
    """What lies on the straight line of one link."""

    distance_m: float
    length_m: float
    """Metres of the line within obstacles and cover."""
    loss_db: float
    """Attenuation along them plus the loss of entering each."""
    buried: bool
    """Whether the beacon itself lies under rubble."""
    names: tuple[str, ...]
    """The obstacles passed, in the scenario's order."""

    @property
    def line_of_sight(self) -> bool:
        """Whether nothing lies on the line."""
        return self.length_m == 0.0 and not self.names


class World:
    """The scenario's obstacles, asked about one link at a time."""

    def __init__(self, obstacles: tuple[Obstacle, ...], cover_attenuation_db_per_m: float = 1.5) -> None:
        self._obstacles = obstacles
        self._cover_attenuation_db_per_m = cover_attenuation_db_per_m
        self._bounds = [_bounds(obstacle) for obstacle in obstacles]

    def obstruction(self, beacon: BeaconSpec, vehicle_enu_m: Enu) -> Obstruction:
        """What the line from ``beacon`` to a vehicle (ENU, metres) passes through."""
        start = beacon.position_enu_m
        distance = max(distance_m(start, vehicle_enu_m), 0.1)
        length = loss = 0.0
        names: list[str] = []
        low = [min(a, b) for a, b in zip(start, vehicle_enu_m, strict=True)]
        high = [max(a, b) for a, b in zip(start, vehicle_enu_m, strict=True)]
        for obstacle, (least, greatest) in zip(self._obstacles, self._bounds, strict=True):
            if any(high[i] < least[i] or low[i] > greatest[i] for i in range(3)):
                continue
            inside = obstructed_length_m(obstacle, start, vehicle_enu_m)
            if inside > 0.0:
                names.append(obstacle.name)
                length += inside
                loss += obstacle.entry_loss_db + obstacle.attenuation_db_per_m * inside
        buried = beacon.buried_depth_m > 0.0
        if buried:
            sine = max((vehicle_enu_m[2] - start[2]) / distance, MIN_ELEVATION_SINE)
            cover = min(beacon.buried_depth_m / sine, distance)
            names.append("cover")
            length += cover
            loss += self._cover_attenuation_db_per_m * cover
        return Obstruction(distance, min(length, distance), loss, buried, tuple(names))


def obstructed_length_m(obstacle: Obstacle, start_enu_m: Enu, end_enu_m: Enu) -> float:
    """Metres of a straight segment that lie inside a prism (ENU, metres)."""
    east, north, up = start_enu_m
    d_east, d_north, d_up = (b - a for a, b in zip(start_enu_m, end_enu_m, strict=True))
    # The part of the segment between the prism's lower and upper face.
    first, last = 0.0, 1.0
    if d_up == 0.0:
        if not obstacle.base_m <= up <= obstacle.top_m:
            return 0.0
    else:
        at_base, at_top = (obstacle.base_m - up) / d_up, (obstacle.top_m - up) / d_up
        first, last = max(first, min(at_base, at_top)), min(last, max(at_base, at_top))
    if first >= last:
        return 0.0
    # Where it crosses the walls; between crossings it is inside or outside as its middle is.
    cuts = [first, last]
    ring = obstacle.corners_m
    a_east, a_north = ring[-1]
    for b_east, b_north in ring:
        edge_east, edge_north = b_east - a_east, b_north - a_north
        determinant = d_east * edge_north - d_north * edge_east
        if determinant != 0.0:
            to_east, to_north = a_east - east, a_north - north
            along = (to_east * edge_north - to_north * edge_east) / determinant
            on_edge = (to_east * d_north - to_north * d_east) / determinant
            if first < along < last and 0.0 <= on_edge <= 1.0:
                cuts.append(along)
        a_east, a_north = b_east, b_north
    cuts.sort()
    share = 0.0
    for one, other in pairwise(cuts):
        middle = (one + other) / 2
        if point_in_ring(ring, east + middle * d_east, north + middle * d_north):
            share += other - one
    return share * math.hypot(d_east, d_north, d_up)


def _bounds(obstacle: Obstacle) -> tuple[Enu, Enu]:
    east = [corner[0] for corner in obstacle.corners_m]
    north = [corner[1] for corner in obstacle.corners_m]
    return (min(east), min(north), obstacle.base_m), (max(east), max(north), obstacle.top_m)
