"""Domain values to wire rows. Pure; a number that is not finite becomes null here.

Rule: the only place that knows both vocabularies, so that neither the engines nor the
page ever see the other's.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from groundstation.domain.command import CommandStatus, Proposal
from groundstation.domain.events import Counter, Event
from groundstation.domain.geometry import Geodetic, Quaternion
from groundstation.domain.inputs import ConnectionInput
from groundstation.domain.mission import Area, Mission
from groundstation.domain.radio import LinkActivity
from groundstation.domain.target import (
    Environment,
    LinkVerdict,
    SearchMap,
    TargetExplanation,
    TargetJoined,
    TargetState,
    TargetWaiting,
)
from groundstation.domain.vehicle import VehicleState
from groundstation.server import rest, wire
from groundstation.server.regions import polygons

_ENVIRONMENTS: dict[Environment, Literal["unknown", "los", "mixed", "nlos"]] = {
    Environment.UNKNOWN: "unknown",
    Environment.LOS: "los",
    Environment.MIXED: "mixed",
    Environment.NLOS: "nlos",
}


@dataclass(frozen=True, slots=True)
class ForwardStatus:
    """Another ground station on ``--forward``; one that may command is shown to the operator."""

    url: str
    commanding: bool
    connected: bool


@dataclass(frozen=True, slots=True)
class StationStatus:
    """What does not belong to a vehicle or a beacon."""

    version: str
    title: str
    """What runs: the session's name, the file being replayed."""
    source: Literal["live", "replay", "demo"]
    commands_enabled: bool
    commands_reason: str
    """Why nothing can be commanded; empty when it can."""


def finite(value: float | None) -> float | None:
    """``value``, or None where it is not a finite number."""
    return float(value) if value is not None and math.isfinite(value) else None


def place(position: Geodetic | None) -> wire.Place | None:
    """A valid place, else None."""
    if position is None or not position.is_valid():
        return None
    return wire.Place(
        latitude_deg=float(position.latitude_deg),
        longitude_deg=float(position.longitude_deg),
        altitude_amsl_m=float(position.altitude_amsl_m),
    )


def heading_deg(attitude: Quaternion | None) -> float | None:
    """Yaw of the airframe, degrees clockwise from north in [0, 360)."""
    if attitude is None:
        return None
    w, x, y, z = attitude
    yaw = math.degrees(math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    return finite(yaw % 360.0)


def vehicle_row(state: VehicleState) -> wire.VehicleRow:
    """Row of a vehicle."""
    velocity = state.velocity_ned_m_s
    return wire.VehicleRow(
        vehicle_id=state.vehicle_id,
        time_ns=str(state.time_ns),
        connections=list(state.connections),
        autopilot=state.autopilot.value,
        mode=state.mode,
        armed=state.armed,
        ready=state.ready,
        lost=state.lost,
        last_heartbeat_ns=str(state.last_heartbeat_ns),
        position=place(state.position),
        position_time_ns=None if state.position_time_ns is None else str(state.position_time_ns),
        height_above_home_m=finite(state.height_above_home_m),
        home=place(state.home),
        heading_deg=heading_deg(state.attitude),
        ground_speed_m_s=None if velocity is None else finite(math.hypot(velocity[0], velocity[1])),
        climb_rate_m_s=None if velocity is None else finite(-velocity[2]),
        battery_percent=finite(state.battery_percent),
        battery_voltage_v=finite(state.battery_voltage_v),
        gps_fix_type=state.gps_fix_type,
        satellites=state.satellites,
        position_target=place(state.position_target),
        sensor_heard_ns=None if state.sensor_heard_ns is None else str(state.sensor_heard_ns),
        packet_loss_percent=finite(state.packet_loss_percent),
        clock_offset_known=state.clock_offset_known,
    )


def link_row(
    vehicle_id: int, beacon_id: int, activity: LinkActivity | None, verdict: LinkVerdict | None
) -> wire.LinkRow:
    """Row of a link from its newest activity and its newest verdict."""
    times = [value.time_ns for value in (activity, verdict) if value is not None]
    rss = activity.rss_dbm if activity else verdict.rss_dbm if verdict else None
    return wire.LinkRow(
        vehicle_id=vehicle_id,
        beacon_id=str(beacon_id),
        last_heard_ns=str(max(times)),
        rss_dbm=finite(rss),
        noise_dbm=finite(activity.noise_dbm) if activity else None,
        samples_total=activity.samples_total if activity else 0,
        captures_total=activity.captures_total if activity else 0,
        captures_incomplete_total=activity.captures_incomplete_total if activity else 0,
        los_probability=finite(verdict.los_probability) if verdict else None,
        los_source=verdict.source.value if verdict else None,
        los_reason=verdict.reason if verdict else "",
        verdict_time_ns=str(verdict.time_ns) if verdict else None,
        azimuth_rad=finite(verdict.azimuth_rad) if verdict else None,
        elevation_rad=finite(verdict.elevation_rad) if verdict else None,
    )


def target_row(state: TargetState) -> wire.TargetRow:
    """Row of a located beacon."""
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


def waiting_row(waiting: TargetWaiting) -> wire.TargetRow:
    """Row of a beacon that is heard but not located."""
    row = _without_estimate(waiting.beacon_id, waiting.time_ns, waiting.first_heard_ns)
    return row.model_copy(
        update={
            "last_heard_ns": str(waiting.time_ns),
            "links": waiting.links,
            "needed": waiting.needed,
        }
    )


def joined_row(joined: TargetJoined) -> wire.TargetRow:
    """Row of a beacon that is another one's id."""
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


def sure_place(position: Geodetic) -> wire.Place:
    """A place that the engines vouch for."""
    return wire.Place(
        latitude_deg=float(position.latitude_deg),
        longitude_deg=float(position.longitude_deg),
        altitude_amsl_m=float(position.altitude_amsl_m),
    )


def proposal_row(proposal: Proposal) -> wire.ProposalRow:
    """Row of an open proposal."""
    return wire.ProposalRow(
        proposal_id=proposal.proposal_id,
        vehicle_id=proposal.vehicle_id,
        beacon_id=str(proposal.beacon_id),
        position=sure_place(proposal.position),
        height_above_home_m=float(proposal.height_above_home_m),
        reason=proposal.reason,
        created_ns=str(proposal.created_ns),
        expires_ns=str(proposal.expires_ns),
        mission_revision=proposal.mission_revision,
        target_sequence=proposal.target_sequence,
    )


def command_row(status: CommandStatus) -> wire.CommandRow:
    """Row of a command's newest step."""
    return wire.CommandRow(
        command_id=status.command_id,
        vehicle_id=status.vehicle_id,
        kind=status.kind.value,
        phase=status.phase.value,
        time_ns=str(status.time_ns),
        detail=status.detail,
        target=place(status.target),
        proposal_id=status.proposal_id,
        attempts=status.attempts,
    )


def connection_row(change: ConnectionInput, time_ns: int) -> wire.ConnectionRow:
    """Row of a connection."""
    return wire.ConnectionRow(
        connection=change.connection, state=change.state, detail=change.detail, time_ns=str(time_ns)
    )


def counter_row(counter: Counter) -> wire.CounterRow:
    """Row of a total."""
    return wire.CounterRow(name=counter.name, labels=dict(counter.labels), value_count=counter.value)


def event_row(event: Event, number: int) -> wire.EventRow:
    """Row of an event; ``number`` counts the session's events from 1."""
    return wire.EventRow(
        number=number,
        time_ns=str(event.time_ns),
        code=event.code,
        severity=event.severity.value,
        text=event.text,
        vehicle_id=event.vehicle_id,
        beacon_id=None if event.beacon_id is None else str(event.beacon_id),
    )


def _area_row(area: Area | None) -> wire.AreaRow | None:
    if area is None:
        return None
    return wire.AreaRow(
        name=area.name,
        polygons_deg=[
            [[[float(longitude), float(latitude)] for latitude, longitude in ring] for ring in polygon]
            for polygon in area.polygons
        ],
    )


def mission_row(mission: Mission) -> wire.MissionRow:
    """Row of the mission."""
    limits = mission.limits
    return wire.MissionRow(
        revision=mission.revision,
        origin=place(mission.origin),
        search_area=_area_row(mission.search_area),
        fence=_area_row(mission.fence),
        target_height_min_m=float(mission.target_height_min_m),
        target_height_max_m=float(mission.target_height_max_m),
        ground_amsl_m=finite(mission.ground_amsl_m),
        height_reference=mission.height_reference,
        limits=wire.LimitsRow(
            floor_m=float(limits.floor_m),
            ceiling_m=float(limits.ceiling_m),
            separation_m=float(limits.separation_m),
            fence_margin_m=float(limits.fence_margin_m),
            stale_pose_s=float(limits.stale_pose_s),
            max_leg_m=float(limits.max_leg_m),
        ),
    )


def forward_row(status: ForwardStatus) -> wire.ForwardRow:
    """Row of another ground station."""
    return wire.ForwardRow(url=status.url, commanding=status.commanding, connected=status.connected)


def station_row(status: StationStatus) -> wire.StationRow:
    """Row of the station itself."""
    return wire.StationRow(
        version=status.version,
        title=status.title,
        source=status.source,
        commands_enabled=status.commands_enabled,
        commands_reason=status.commands_reason,
    )
