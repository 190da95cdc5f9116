"""The gate: may this vehicle fly straight to that place, now?

It is asked when a plan is made and again, with fresh poses, when the command leaves. It
answers with every reason against, not only the first, in the operator's words. It knows
nothing of who asks: no fence, no flight, whoever wants it.

The way is checked without assuming when the autopilot climbs: its whole horizontal track
is taken to be flown at every height between both ends, and ways of different vehicles are
kept apart whenever they are flown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pymap3d
import shapely
from shapely.geometry import LineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from groundstation.domain.geometry import Enu, Geodetic, LocalFrame
from groundstation.domain.mission import Area, Mission, Ring
from groundstation.domain.vehicle import VehicleState
from groundstation.safety.modes import COMMANDABLE_MODES
from groundstation.safety.settings import SafetySettings


@dataclass(frozen=True, slots=True)
class Refusal:
    """One reason against."""

    code: str
    """Stable, for machines and tests."""
    text: str
    """One line, for people: what was seen and what is needed."""


@dataclass(frozen=True, slots=True)
class Airspace:
    """All that the gate looks at, at one instant."""

    time_ns: int
    mission: Mission
    vehicles: Mapping[int, VehicleState]
    going_to: Mapping[int, Geodetic]
    """Where vehicles have been commanded, or are proposed to go, and may still be flying to."""


@dataclass(frozen=True, slots=True)
class _Track:
    """A straight way: its horizontal line in metres and the altitudes (AMSL) flown on it."""

    line: LineString
    low_m: float
    high_m: float


def leg_refusals(
    vehicle_id: int, target: Geodetic, airspace: Airspace, settings: SafetySettings
) -> list[Refusal]:
    """Every reason why the vehicle must not fly straight from where it is to ``target``."""
    refusals = vehicle_refusals(vehicle_id, airspace, settings)
    state = airspace.vehicles.get(vehicle_id)
    mission = airspace.mission
    if not target.is_valid():
        return [*refusals, Refusal("invalid_target", "the target's coordinates are not a place on Earth")]
    if mission.fence is None or not mission.fence.polygons:
        refusals.append(Refusal("no_fence", "there is no fence; set one before commanding anything"))
    if state is None or state.position is None or not state.position.is_valid():
        return refusals
    start = state.position
    frame = LocalFrame(_corner(mission.fence) or Geodetic(start.latitude_deg, start.longitude_deg, 0.0))
    way = _track(_metric(frame, start), _metric(frame, target))
    if mission.fence is not None and mission.fence.polygons:
        refusals += _fence_refusals(way, mission.fence, mission.limits.fence_margin_m)
    refusals += _height_refusals(state, target, mission, settings)
    leg_m = math.hypot(way.line.length, way.high_m - way.low_m)
    if not leg_m <= mission.limits.max_leg_m:
        refusals.append(
            Refusal("leg_too_long", f"{leg_m:.0f} m to fly; the limit is {mission.limits.max_leg_m:.0f} m")
        )
    for other_id in sorted(airspace.vehicles):
        if other_id != vehicle_id:
            refusals += _separation_refusals(way, airspace.vehicles[other_id], airspace, frame, settings)
    return refusals


def vehicle_refusals(vehicle_id: int, airspace: Airspace, settings: SafetySettings) -> list[Refusal]:
    """Reasons that lie in the vehicle itself, whatever its target."""
    state = airspace.vehicles.get(vehicle_id)
    if state is None:
        return [Refusal("unknown_vehicle", f"vehicle {vehicle_id} has never been heard")]
    name = f"vehicle {vehicle_id}"
    refusals: list[Refusal] = []
    if state.lost:
        refusals.append(Refusal("vehicle_lost", f"{name} is lost: no heartbeat"))
    if not state.armed:
        refusals.append(Refusal("not_armed", f"{name} is not armed"))
    if not state.ready:
        refusals.append(Refusal("not_ready", f"{name} is not ready: no valid position, or a failed check"))
    if state.mode not in COMMANDABLE_MODES[state.autopilot]:
        refusals.append(
            Refusal("mode_not_ours", f"{name} is in mode {state.mode}, from which it is not taken over")
        )
    if state.position is None or state.position_time_ns is None or not state.position.is_valid():
        refusals.append(Refusal("no_position", f"{name} has no valid position"))
    else:
        age_s = (airspace.time_ns - state.position_time_ns) * 1e-9
        if not abs(age_s) <= airspace.mission.limits.stale_pose_s:
            refusals.append(Refusal("stale_pose", f"the position of {name} is {age_s:.1f} s old"))
    height_m = state.height_above_home_m
    if height_m is not None and not height_m >= settings.min_flying_height_m:
        refusals.append(Refusal("on_ground", f"{name} is on the ground ({height_m:.0f} m above home)"))
    if state.home is None or height_m is None or not state.home.is_valid():
        refusals.append(
            Refusal("height_datum_unknown", f"{name} has not said where its home is: heights are unknown")
        )
    elif state.position is not None:
        # A home moved by arming again shows here before the new one has been heard.
        difference_m = state.position.altitude_amsl_m - state.home.altitude_amsl_m - height_m
        if not abs(difference_m) <= settings.datum_tolerance_m:
            refusals.append(
                Refusal(
                    "height_datum_inconsistent",
                    f"{name}: height above home and altitude disagree by {difference_m:.0f} m",
                )
            )
    return refusals


def _height_refusals(
    state: VehicleState, target: Geodetic, mission: Mission, settings: SafetySettings
) -> list[Refusal]:
    if state.home is None or state.height_above_home_m is None:
        return []
    limits, allowance_m = mission.limits, settings.height_tolerance_m
    floor_m, ceiling_m = limits.floor_m, limits.ceiling_m
    refusals = []
    height_m = target.altitude_amsl_m - state.home.altitude_amsl_m
    # A millimetre for the rounding of altitudes on the wire.
    if not height_m >= floor_m - 1e-3:
        text = f"{height_m:.0f} m above home is below the floor of {floor_m:.0f} m"
        refusals.append(Refusal("below_floor", text))
    if not height_m <= ceiling_m + 1e-3:
        text = f"{height_m:.0f} m above home is above the ceiling of {ceiling_m:.0f} m"
        refusals.append(Refusal("above_ceiling", text))
    now_m = state.height_above_home_m
    if not floor_m - allowance_m <= now_m <= ceiling_m + allowance_m:
        text = f"the way begins {now_m:.0f} m above home, outside {floor_m:.0f}–{ceiling_m:.0f} m"
        refusals.append(Refusal("way_outside_heights", text))
    return refusals


def _fence_refusals(way: _Track, fence: Area, margin_m: float) -> list[Refusal]:
    allowed = fence_geometry(fence)
    if not allowed.is_valid:
        return [Refusal("fence_invalid", f"the fence cannot be used: {shapely.is_valid_reason(allowed)}")]
    refusals = []
    start, target = (shapely.Point(corner) for corner in (way.line.coords[0], way.line.coords[-1]))
    border = allowed.boundary
    if not (allowed.covers(target) and border.distance(target) >= margin_m):
        refusals.append(
            Refusal("target_outside_fence", f"the target is not at least {margin_m:.0f} m inside the fence")
        )
    if not (allowed.covers(start) and border.distance(start) >= margin_m):
        refusals.append(
            Refusal("start_outside_fence", f"the vehicle is not at least {margin_m:.0f} m inside the fence")
        )
    if not refusals and not (allowed.covers(way.line) and border.distance(way.line) >= margin_m):
        refusals.append(
            Refusal("way_outside_fence", f"the straight way comes closer than {margin_m:.0f} m to the fence")
        )
    return refusals


def _separation_refusals(
    way: _Track, other: VehicleState, airspace: Airspace, frame: LocalFrame, settings: SafetySettings
) -> list[Refusal]:
    name = f"vehicle {other.vehicle_id}"
    if other.position is None or other.position_time_ns is None or not other.position.is_valid():
        if other.armed:
            return [Refusal("separation_unknown", f"{name} is armed and where it is is not known")]
        return []
    limits = airspace.mission.limits
    refusals = []
    age_s = (airspace.time_ns - other.position_time_ns) * 1e-9
    if other.armed and not other.lost and not abs(age_s) <= limits.stale_pose_s:
        refusals.append(Refusal("separation_stale", f"the position of {name} is {age_s:.1f} s old"))
    here = _metric(frame, other.position)
    ends = [airspace.going_to.get(other.vehicle_id), other.position_target]
    if other.lost:
        # A vehicle without a link flies home, at a height that only it knows.
        ends.append(other.home)
    tracks = [_track(here, _metric(frame, end)) for end in ends if end is not None and end.is_valid()]
    tracks.append(_track(here, _drifted(here, other, settings.look_ahead_s)))
    for track in tracks:
        apart_m = float(way.line.distance(track.line))
        above_m = 0.0 if other.lost else max(0.0, way.low_m - track.high_m, track.low_m - way.high_m)
        if not math.hypot(apart_m, above_m) >= limits.separation_m:
            refusals.append(
                Refusal(
                    "separation",
                    f"comes within {math.hypot(apart_m, above_m):.0f} m of {name} or its way; "
                    f"{limits.separation_m:.0f} m are needed",
                )
            )
            break
    return refusals


def _drifted(here: Enu, state: VehicleState, seconds: float) -> Enu:
    """Where the vehicle is after going on at its velocity."""
    north, east, down = state.velocity_ned_m_s or (0.0, 0.0, 0.0)
    return here[0] + east * seconds, here[1] + north * seconds, here[2] - down * seconds


def _metric(frame: LocalFrame, place: Geodetic) -> Enu:
    """Metres east and north in the fence's plane, and the altitude above mean sea level."""
    east, north, _ = frame.to_enu(Geodetic(place.latitude_deg, place.longitude_deg, 0.0))
    return east, north, place.altitude_amsl_m


def _track(start: Enu, end: Enu) -> _Track:
    low, high = sorted((start[2], end[2]))
    return _Track(LineString([start[:2], end[:2]]), low, high)


def _corner(fence: Area | None) -> Geodetic | None:
    if fence is None or not fence.polygons or not fence.polygons[0]:
        return None
    latitude_deg, longitude_deg = fence.polygons[0][0][0]
    return Geodetic(latitude_deg, longitude_deg, 0.0)


@lru_cache(maxsize=8)
def fence_geometry(fence: Area) -> BaseGeometry:
    """The area in horizontal metres east and north of its first corner."""
    corner = _corner(fence)
    assert corner is not None
    metric = [[_metres(ring, corner) for ring in rings] for rings in fence.polygons]
    polygons = [Polygon(rings[0], rings[1:]) for rings in metric]
    # Not unary_union: it would mend a self-crossing ring in silence.
    return polygons[0] if len(polygons) == 1 else MultiPolygon(polygons)


def _metres(ring: Ring, corner: Geodetic) -> list[tuple[float, float]]:
    latitudes, longitudes = np.array(ring).T
    east, north, _ = pymap3d.geodetic2enu(
        latitudes, longitudes, 0.0, corner.latitude_deg, corner.longitude_deg, 0.0
    )
    return [(float(e), float(n)) for e, n in zip(east, north, strict=True)]
