"""The terrain of a mission as heights in the estimator's frame.

Exists because a file's heights are altitudes on WGS84 and candidates are metres east, north and
up. Rule: where the file knows nothing the mission's ground is taken, marked as such, never 0.

A vehicle's altitude is off by metres from mean sea level (its GPS when it was switched on, its
geoid), and so is a file's. What matters is the height between vehicle and target: where the
mission's ground is the vehicles' home, the terrain is shifted to meet home there.
"""

from __future__ import annotations

import numpy as np
import pymap3d

from groundstation.domain.geometry import LocalFrame
from groundstation.domain.mission import Mission, Terrain
from groundstation.localization import SearchArea
from groundstation.localization.ground import GroundHeights
from groundstation.localization.problem import BoolArray, FloatArray

MOST_TIED_M = 30.0
"""Further apart than this home and terrain are not the same ground; nothing is shifted."""
_NODES = 192
"""Across the area; with 500 m of radius one every 5 m."""
_BEYOND = 1.02


def ground_heights(
    mission: Mission, frame: LocalFrame, area: SearchArea, ground_up_m: float
) -> tuple[GroundHeights, float | None]:
    """Heights under ``area`` (``ground_up_m`` where the terrain knows none), and how far home lies
    above the terrain there, metres; None where home is not known or not on the terrain."""
    terrain, origin = mission.terrain, frame.origin
    assert terrain is not None
    reach = _BEYOND * area.radius_m
    step = 2.0 * reach / (_NODES - 1)
    west, south = float(area.center_enu_m[0]) - reach, float(area.center_enu_m[1]) - reach
    along = step * np.arange(_NODES)
    east, north = np.meshgrid(west + along, south + along)
    latitude, longitude, _ = pymap3d.enu2geodetic(
        east, north, np.zeros_like(east), origin.latitude_deg, origin.longitude_deg, origin.altitude_amsl_m
    )
    altitude, known = altitude_amsl_m(terrain, latitude, longitude)
    above_m: float | None = None
    home = mission.origin
    if mission.height_reference == "home" and home is not None:
        under, there = altitude_amsl_m(terrain, np.array(home.latitude_deg), np.array(home.longitude_deg))
        if bool(there):
            above_m = home.altitude_amsl_m - float(under)
            if abs(above_m) <= MOST_TIED_M:
                altitude = altitude + above_m
    _, _, up = pymap3d.geodetic2enu(
        latitude,
        longitude,
        np.where(known, altitude, 0.0),
        origin.latitude_deg,
        origin.longitude_deg,
        origin.altitude_amsl_m,
    )
    return GroundHeights(west, south, step, np.where(known, up, ground_up_m), known), above_m


def altitude_amsl_m(
    terrain: Terrain, latitude_deg: FloatArray, longitude_deg: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Altitude of the ground at places, linear between nodes, and where it is known (all four nodes are)."""
    grid = np.array(
        [np.nan if value is None else 0.1 * value for value in terrain.altitude_dm], dtype=np.float64
    ).reshape(terrain.rows, terrain.columns)
    x = (np.asarray(longitude_deg) - terrain.west_deg) / terrain.longitude_step_deg
    y = (np.asarray(latitude_deg) - terrain.south_deg) / terrain.latitude_step_deg
    inside = (x >= 0.0) & (x <= terrain.columns - 1) & (y >= 0.0) & (y <= terrain.rows - 1)
    column = np.clip(x.astype(np.int64), 0, terrain.columns - 2)
    row = np.clip(y.astype(np.int64), 0, terrain.rows - 2)
    x, y = x - column, y - row
    altitude = (1.0 - y) * ((1.0 - x) * grid[row, column] + x * grid[row, column + 1]) + y * (
        (1.0 - x) * grid[row + 1, column] + x * grid[row + 1, column + 1]
    )
    known: BoolArray = inside & np.isfinite(altitude)
    return np.where(known, altitude, 0.0), known
