"""The estimator's state as trees of plain values, and back.

Exists because a restart must go on bit for bit. Rule: what one function writes the next one
reads, side by side, and nothing else knows the trees.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from groundstation.domain.geometry import Geodetic
from groundstation.domain.mission import Area, LastKnownPlace, Mission, Terrain
from groundstation.engine.estimator_beacon import Beacon
from groundstation.engine.estimator_output import (
    HEARD_FIELDS,
    Heard,
    heard_row,
    snapshot_from_state,
    snapshot_state,
)
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.localization import SearchArea
from groundstation.tracking import Tracker
from groundstation.tracking.detection import SilenceField
from groundstation.tracking.silence import Silence

_UNKNOWN_DM = -(2**31)


def beacon_state(beacon: Beacon) -> dict[str, Any]:
    """All of a beacon."""
    return {
        "beacon_id": beacon.beacon_id,
        "first_heard_ns": beacon.first_heard_ns,
        "last_heard_ns": beacon.last_heard_ns,
        "pending": [heard_row(heard) for heard in beacon.pending],
        "newest": [heard_row(heard) for heard in beacon.newest.values()],
        "belief": None if beacon.belief is None else beacon.belief.state(),
        "sequence": beacon.sequence,
        "windows": beacon.windows,
        "updated_ns": beacon.updated_ns,
        "snapshot_ns": beacon.snapshot_ns,
        "regions_ns": beacon.regions_ns,
        "snapshot": None if beacon.snapshot is None else snapshot_state(beacon.snapshot),
        "failed": beacon.failed,
        "explained": [beacon.explained_ns, beacon.explained_sequence],
        "silence": None if beacon.silence is None else beacon.silence.state(),
        "silence_field": None if beacon.silence_field is None else beacon.silence_field.state(),
        "silence_ns": beacon.silence_ns,
    }


def beacon_from(tree: dict[str, Any], area: SearchArea | None, settings: EstimatorSettings) -> Beacon:
    """The reverse; the belief's settings are not part of the tree."""
    beacon = Beacon(int(tree["beacon_id"]), int(tree["first_heard_ns"]), int(tree["last_heard_ns"]))
    beacon.pending = [_heard(row) for row in tree["pending"]]
    for heard in (_heard(row) for row in tree["newest"]):
        beacon.newest[heard.vehicle_id] = heard
    if tree["belief"] is not None and area is not None:
        beacon.belief = Tracker.restore(
            tree["belief"], area, settings.localization.model, settings.tracking, beacon.beacon_id
        )
    beacon.sequence, beacon.windows = int(tree["sequence"]), int(tree["windows"])
    beacon.updated_ns, beacon.snapshot_ns = tree["updated_ns"], tree["snapshot_ns"]
    beacon.regions_ns, beacon.failed = tree["regions_ns"], bool(tree["failed"])
    beacon.explained_ns, beacon.explained_sequence = tree["explained"]
    if tree["silence"] is not None:
        beacon.silence = Silence(settings.tracking)
        beacon.silence.restore(tree["silence"])
    if tree["silence_field"] is not None:
        beacon.silence_field = SilenceField.restore(tree["silence_field"])
        if beacon.belief is not None:
            beacon.belief.set_field("silence", beacon.silence_field)
    beacon.silence_ns = tree["silence_ns"]
    if tree["snapshot"] is not None:
        beacon.snapshot = snapshot_from_state(tree["snapshot"])
    return beacon


def _heard(row: list[Any]) -> Heard:
    # Rows kept by an earlier version are shorter.
    return Heard(**dict(zip(HEARD_FIELDS, row, strict=False)))


def place_state(place: Geodetic) -> list[float]:
    """Degrees, degrees, metres."""
    return [place.latitude_deg, place.longitude_deg, place.altitude_amsl_m]


def place_from(values: Any) -> Geodetic:
    """The reverse."""
    return Geodetic(float(values[0]), float(values[1]), float(values[2]))


def mission_state(mission: Mission) -> dict[str, Any]:
    """What the estimator uses of a mission; the mission's own records bring the rest."""
    area = mission.search_area
    return {
        "revision": mission.revision,
        "origin": None if mission.origin is None else place_state(mission.origin),
        "search_area": None
        if area is None
        else [[[list(corner) for corner in ring] for ring in polygon] for polygon in area.polygons],
        "search_area_name": "" if area is None else area.name,
        "target_height_min_m": mission.target_height_min_m,
        "target_height_max_m": mission.target_height_max_m,
        "ground_amsl_m": mission.ground_amsl_m,
        "height_reference": mission.height_reference,
        "last_known": [
            [place.latitude_deg, place.longitude_deg, place.radius_m, place.name, place.beacon_id]
            for place in mission.last_known
        ],
        "terrain": None if mission.terrain is None else _terrain_state(mission.terrain),
    }


def mission_from(tree: dict[str, Any]) -> Mission:
    """The reverse."""
    area = None
    if tree["search_area"] is not None:
        polygons = tuple(
            tuple(tuple((float(lat), float(lon)) for lat, lon in ring) for ring in polygon)
            for polygon in tree["search_area"]
        )
        area = Area(polygons, str(tree["search_area_name"]))
    return Mission(
        revision=int(tree["revision"]),
        origin=None if tree["origin"] is None else place_from(tree["origin"]),
        search_area=area,
        target_height_min_m=float(tree["target_height_min_m"]),
        target_height_max_m=float(tree["target_height_max_m"]),
        ground_amsl_m=None if tree["ground_amsl_m"] is None else float(tree["ground_amsl_m"]),
        height_reference=str(tree["height_reference"]),
        last_known=tuple(
            LastKnownPlace(float(lat), float(lon), float(radius), str(name), beacon_id)
            for lat, lon, radius, name, beacon_id in tree["last_known"]
        ),
        terrain=None if tree["terrain"] is None else _terrain_from(tree["terrain"]),
    )


def _terrain_state(terrain: Terrain) -> dict[str, Any]:
    grid = [terrain.south_deg, terrain.west_deg, terrain.latitude_step_deg, terrain.longitude_step_deg]
    altitude = [_UNKNOWN_DM if value is None else value for value in terrain.altitude_dm]
    return {
        "grid": grid,
        "columns": terrain.columns,
        "altitude_dm": np.array(altitude, dtype=np.int32),
        "source": terrain.source,
    }


def _terrain_from(tree: dict[str, Any]) -> Terrain:
    altitude = np.asarray(tree["altitude_dm"]).tolist()
    south, west, latitude_step, longitude_step = (float(value) for value in tree["grid"])
    return Terrain(
        south_deg=south,
        west_deg=west,
        latitude_step_deg=latitude_step,
        longitude_step_deg=longitude_step,
        columns=int(tree["columns"]),
        altitude_dm=tuple(None if value == _UNKNOWN_DM else int(value) for value in altitude),
        source=str(tree["source"]),
    )
