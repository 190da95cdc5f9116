"""The estimator's state as trees of plain values, and back.

Exists because a restart must go on bit for bit. Rule: what one function writes the next one
reads, side by side, and nothing else knows the trees.
"""

from __future__ import annotations

from typing import Any

from groundstation.domain.geometry import Geodetic
from groundstation.domain.mission import Area, Mission
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
from groundstation.tracking import Belief


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
    }


def beacon_from(tree: dict[str, Any], area: SearchArea | None, settings: EstimatorSettings) -> Beacon:
    """The reverse; the belief's settings are not part of the tree."""
    beacon = Beacon(int(tree["beacon_id"]), int(tree["first_heard_ns"]), int(tree["last_heard_ns"]))
    beacon.pending = [_heard(row) for row in tree["pending"]]
    for heard in (_heard(row) for row in tree["newest"]):
        beacon.newest[heard.vehicle_id] = heard
    if tree["belief"] is not None and area is not None:
        beacon.belief = Belief.restore(tree["belief"], area, settings.localization.model, settings.tracking)
    beacon.sequence, beacon.windows = int(tree["sequence"]), int(tree["windows"])
    beacon.updated_ns, beacon.snapshot_ns = tree["updated_ns"], tree["snapshot_ns"]
    beacon.regions_ns, beacon.failed = tree["regions_ns"], bool(tree["failed"])
    if tree["snapshot"] is not None:
        beacon.snapshot = snapshot_from_state(tree["snapshot"])
    return beacon


def _heard(row: list[Any]) -> Heard:
    return Heard(**dict(zip(HEARD_FIELDS, row, strict=True)))


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
    )
