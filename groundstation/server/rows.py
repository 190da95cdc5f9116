"""Domain values to wire rows: vehicles, links, mission, station. Pure.

Rule: this and ``target_rows`` (beacons) are the only places that know both vocabularies, so
that neither the engines nor the page ever see the other's. A number that is not finite
becomes null here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from groundstation.domain.command import CommandStatus, Proposal
from groundstation.domain.events import Counter, Event
from groundstation.domain.geometry import Geodetic, Quaternion
from groundstation.domain.inputs import ConnectionInput
from groundstation.domain.mission import Area, Mission
from groundstation.domain.radio import LinkActivity
from groundstation.domain.target import LinkVerdict
from groundstation.domain.vehicle import VehicleState
from groundstation.server import wire


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


def sure_place(position: Geodetic) -> wire.Place:
    """A place that the engines vouch for."""
    return wire.Place(
        latitude_deg=float(position.latitude_deg),
        longitude_deg=float(position.longitude_deg),
        altitude_amsl_m=float(position.altitude_amsl_m),
    )


def place(position: Geodetic | None) -> wire.Place | None:
    """A valid place, else None."""
    return sure_place(position) if position is not None and position.is_valid() else None


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
        position_accuracy_m=None
        if state.place_accuracy is None
        else finite(state.place_accuracy.horizontal_m),
        position_target=place(state.position_target),
        sensor_heard_ns=None if state.sensor_heard_ns is None else str(state.sensor_heard_ns),
        packet_loss_percent=finite(state.packet_loss_percent),
        clock_offset_known=state.clock_offset_known,
        clock_uncertainty_s=None if state.clock_uncertainty_ns is None else state.clock_uncertainty_ns / 1e9,
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
        last_known=[
            wire.LastKnownRow(
                latitude_deg=float(known.latitude_deg),
                longitude_deg=float(known.longitude_deg),
                radius_m=float(known.radius_m),
                name=known.name,
                beacon_id=None if known.beacon_id is None else str(known.beacon_id),
            )
            for known in mission.last_known
        ],
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
