"""What is known of a beacon to wire rows: estimate, regions, explanation, map, history. Pure.

Rule: as in ``rows``; a beacon always has one target row, whatever is known of it, so that
a page never asks which kind of row it got.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from typing import Literal

from groundstation.domain.target import (
    Environment,
    SearchMap,
    TargetExplanation,
    TargetJoined,
    TargetState,
    TargetWaiting,
)
from groundstation.server import rest, wire
from groundstation.server.regions import polygons
from groundstation.server.rows import finite, place

_ENVIRONMENTS: dict[Environment, Literal["unknown", "los", "mixed", "nlos"]] = {
    Environment.UNKNOWN: "unknown",
    Environment.LOS: "los",
    Environment.MIXED: "mixed",
    Environment.NLOS: "nlos",
}


def target_row(state: TargetState | TargetWaiting | TargetJoined) -> wire.TargetRow:
    """Row of a beacon: located, heard but not located, or another one's id."""
    if isinstance(state, TargetState):
        return _located_row(state)
    return _joined_row(state) if isinstance(state, TargetJoined) else _waiting_row(state)


def _located_row(state: TargetState) -> wire.TargetRow:
    snapshot = state.snapshot
    return wire.TargetRow(
        beacon_id=str(state.beacon_id),
        state="located",
        joined_into=None,
        joined_beacon_ids=[str(other) for other in state.joined_beacon_ids],
        walking_probability=finite(state.walking_probability),
        time_ns=str(state.time_ns),
        first_heard_ns=str(state.first_heard_ns),
        last_heard_ns=str(state.last_heard_ns),
        links=state.links,
        los_links=state.los_links,
        needed="",
        position=place(state.position),
        covariance_enu_m2=(
            [float(value) for value in state.covariance_enu_m2]
            if all(math.isfinite(value) for value in state.covariance_enu_m2)
            else None
        ),
        radius_90_m=finite(state.radius_90_m),
        environment=_ENVIRONMENTS[state.environment],
        method=state.method,
        windows=state.windows,
        height_reference=state.height_reference,
        sequence=state.sequence,
        snapshot_position=place(snapshot.position) if snapshot else None,
        snapshot_method=snapshot.method if snapshot else None,
        snapshot_status=snapshot.status if snapshot else None,
    )


def _waiting_row(waiting: TargetWaiting) -> wire.TargetRow:
    row = _without_estimate(waiting.beacon_id, waiting.time_ns, waiting.first_heard_ns)
    return row.model_copy(
        update={
            "last_heard_ns": str(waiting.time_ns),
            "links": waiting.links,
            "needed": waiting.needed,
        }
    )


def _joined_row(joined: TargetJoined) -> wire.TargetRow:
    row = _without_estimate(joined.beacon_id, joined.time_ns, joined.first_heard_ns)
    return row.model_copy(
        update={
            "state": "joined",
            "last_heard_ns": str(joined.last_heard_ns),
            "joined_into": str(joined.into_beacon_id),
        }
    )


def _without_estimate(beacon_id: int, time_ns: int, first_heard_ns: int) -> wire.TargetRow:
    return wire.TargetRow(
        beacon_id=str(beacon_id),
        state="waiting",
        joined_into=None,
        joined_beacon_ids=[],
        walking_probability=None,
        time_ns=str(time_ns),
        first_heard_ns=str(first_heard_ns),
        last_heard_ns=str(time_ns),
        links=0,
        los_links=None,
        needed="",
        position=None,
        covariance_enu_m2=None,
        radius_90_m=None,
        environment="unknown",
        method="",
        windows=0,
        height_reference="unknown",
        sequence=0,
        snapshot_position=None,
        snapshot_method=None,
        snapshot_status=None,
    )


def regions_row(state: TargetState) -> wire.RegionsRow:
    """Row of the areas where a beacon could be."""
    return wire.RegionsRow(
        beacon_id=str(state.beacon_id),
        time_ns=str(state.time_ns),
        regions=[
            wire.RegionRow(share=float(share), polygons_deg=polygons(rings))
            for share, rings in sorted(state.regions)
        ],
    )


def explanation_row(told: TargetExplanation) -> wire.ExplanationRow:
    """Row of what each vehicle contributed."""
    return wire.ExplanationRow(
        beacon_id=str(told.beacon_id),
        time_ns=str(told.time_ns),
        sequence=told.sequence,
        contributions=[
            wire.ContributionRow(
                vehicle_id=link.vehicle_id,
                weight=float(link.weight),
                area_factor=float(link.area_factor),
                windows=link.windows,
                redundant=link.redundant,
                outliers=link.outliers,
                power_residual_db=finite(link.power_residual_db),
                power_score=finite(link.power_score),
                azimuth_residual_deg=finite(link.azimuth_residual_deg),
                azimuth_score=finite(link.azimuth_score),
                elevation_residual_deg=finite(link.elevation_residual_deg),
                elevation_score=finite(link.elevation_score),
                los_probability=finite(link.los_probability),
            )
            for link in told.contributions
        ],
    )


def search_map(found: SearchMap, server_time_ns: int) -> rest.SearchMap:
    """A raster for the page: plain numbers, row by row."""
    corners = [[longitude, latitude] for latitude, longitude in found.corners]
    return rest.SearchMap(
        schema_version=wire.SCHEMA_VERSION,
        server_time_ns=str(server_time_ns),
        beacon_id=str(found.beacon_id),
        time_ns=str(found.time_ns),
        north_west_latitude_deg=corners[0][1],
        north_west_longitude_deg=corners[0][0],
        south_east_latitude_deg=corners[2][1],
        south_east_longitude_deg=corners[2][0],
        corners_deg=corners,
        origin_latitude_deg=float(found.origin.latitude_deg),
        origin_longitude_deg=float(found.origin.longitude_deg),
        west_m=found.west_m,
        north_m=found.north_m,
        cell_size_m=found.cell_m,
        rows=found.rows,
        columns=found.columns,
        # 32 bits hold seven digits; what they look like in 64 is noise on the wire.
        probability=[round(value, 7) for (value,) in struct.iter_unpack("<f", found.share)],
        containment=[value / 10_000 for (value,) in struct.iter_unpack("<H", found.containment)],
    )


def history(states: Iterable[TargetState]) -> list[rest.HistoryPoint]:
    """Points of a beacon's past."""
    return [
        rest.HistoryPoint(
            time_ns=str(state.time_ns),
            latitude_deg=float(state.position.latitude_deg),
            longitude_deg=float(state.position.longitude_deg),
            altitude_amsl_m=float(state.position.altitude_amsl_m),
            radius_90_m=finite(state.radius_90_m),
            windows=state.windows,
            links=state.links,
        )
        for state in states
    ]
