"""Spreads the vehicles round the estimates: equal bearings, a distance that shrinks with doubt.

Bearings that cross at wide angles, and ranges from all sides, are what shrinks a radio
position's uncertainty most; how far out follows from how uncertain the position is (stay
outside what is not known) and from the height (from right above, azimuth says nothing).

Every proposal has passed the gate together with the others of its plan. A place that the
gate refuses is moved (nearer, farther, round, higher, lower) before it is given up, and
what is given up is said in a note.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from groundstation.domain.command import Proposal
from groundstation.domain.geometry import Enu, Geodetic, LocalFrame
from groundstation.domain.inputs import PlanInput
from groundstation.domain.mission import FlightLimits
from groundstation.domain.target import TargetState
from groundstation.domain.vehicle import VehicleState
from groundstation.guidance.allotment import assign, best_ring, seats
from groundstation.guidance.plan import PlanRequest
from groundstation.guidance.settings import GuidanceSettings
from groundstation.safety.gate import Airspace, Refusal, leg_refusals, vehicle_refusals
from groundstation.safety.settings import SafetySettings

_RADIUS_FACTORS = (1.0, 0.75, 1.3, 0.5, 1.7)
_TURNS_DEG = (0, 15, -15, 30, -30, 45, -45, 70, -70, 100, -100)
_PARTS_OF_WAY = (0.8, 0.6, 0.4, 0.25)
_POINTS = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")


def propose(request: PlanRequest, settings: GuidanceSettings, safety: SafetySettings) -> PlanInput:
    """Proposals for vehicles that would learn more elsewhere.

    They have passed the gate, at most one a vehicle; notes say why the others got none.
    """
    notes: list[str] = []
    vehicles = {state.vehicle_id: state for state in sorted(request.vehicles, key=lambda s: s.vehicle_id)}
    going_to = dict(request.going_to)
    airspace = Airspace(request.time_ns, request.mission, vehicles, going_to)
    free = _free_vehicles(airspace, safety, notes)
    beacons = _beacons_in_need(request, settings, notes)
    if not free or not beacons or request.mission.fence is None:
        if request.mission.fence is None:
            notes.insert(0, "no fence is set: no vehicle can be sent anywhere")
        return PlanInput(request.mission.revision, (), tuple(notes))
    frame = LocalFrame(request.mission.origin or beacons[0].position)
    places = {state.vehicle_id: frame.to_enu(state.position) for state in free if state.position is not None}
    proposals: list[Proposal] = []
    for target, group in _groups(beacons, free, frame, places, settings):
        if not group:
            notes.append(f"beacon {target.beacon_id}: all vehicles are with beacons that are less certain")
            continue
        proposals += _spread_group(
            request, airspace, going_to, target, group, frame, places, settings, safety, notes
        )
    return PlanInput(request.mission.revision, tuple(proposals), tuple(notes))


def _free_vehicles(airspace: Airspace, safety: SafetySettings, notes: list[str]) -> list[VehicleState]:
    free = []
    for vehicle_id, state in airspace.vehicles.items():
        refusals = vehicle_refusals(vehicle_id, airspace, safety)
        if refusals:
            notes.append(f"vehicle {vehicle_id} gets no proposal: {_words(refusals)}")
        else:
            free.append(state)
    return free


def _beacons_in_need(request: PlanRequest, settings: GuidanceSettings, notes: list[str]) -> list[TargetState]:
    needy = []
    for target in sorted(request.targets, key=lambda t: t.beacon_id):
        silent_s = (request.time_ns - target.last_heard_ns) * 1e-9
        if silent_s > settings.stale_target_s:
            notes.append(f"beacon {target.beacon_id}: not heard for {silent_s:.0f} s, no vehicle is sent")
        elif target.radius_90_m <= math.hypot(settings.found_radius_m, target.least_radius_90_m):
            # What the vehicles' own places bring is no reason to fly: no flight makes it less.
            known_m = target.radius_90_m
            notes.append(f"beacon {target.beacon_id}: known to within {known_m:.0f} m, nothing to gain")
        elif target.position.is_valid():
            needy.append(target)
    return needy


def _groups(
    beacons: list[TargetState],
    free: list[VehicleState],
    frame: LocalFrame,
    places: dict[int, Enu],
    settings: GuidanceSettings,
) -> list[tuple[TargetState, list[VehicleState]]]:
    """Splits the vehicles over the beacons: numbers by uncertainty, who by least way."""
    given = seats([target.radius_90_m for target in beacons], len(free), settings.vehicles_per_beacon)
    columns = [index for index, count in enumerate(given) for _ in range(count)]
    centers = [frame.to_enu(target.position)[:2] for target in beacons]
    cost = np.array(
        [[math.dist(places[state.vehicle_id][:2], centers[column]) for column in columns] for state in free]
    )
    groups: list[list[VehicleState]] = [[] for _ in beacons]
    for row, column in assign(cost):
        groups[columns[column]].append(free[row])
    return list(zip(beacons, groups, strict=True))


def standoff_m(target: TargetState, height_m: float, settings: GuidanceSettings) -> float:
    """Horizontal distance from the estimate at which to listen, from ``height_m`` above it."""
    lowest_m = max(settings.standoff_min_m, settings.standoff_of_height * height_m)
    wanted_m = max(settings.standoff_of_radius * target.radius_90_m, lowest_m)
    return min(wanted_m, max(settings.standoff_max_m, settings.standoff_min_m))


def _spread_group(
    request: PlanRequest,
    airspace: Airspace,
    going_to: dict[int, Geodetic],
    target: TargetState,
    group: list[VehicleState],
    frame: LocalFrame,
    places: dict[int, Enu],
    settings: GuidanceSettings,
    safety: SafetySettings,
    notes: list[str],
) -> list[Proposal]:
    center = frame.to_enu(target.position)
    heights = [places[state.vehicle_id][2] - center[2] for state in group]
    radius_m = standoff_m(target, max(0.0, sum(heights) / len(heights)), settings)
    slots = best_ring(
        [places[state.vehicle_id][:2] for state in group], center[:2], radius_m, settings.rotations
    )
    proposals = []
    stay_m = max(settings.move_min_m, settings.move_of_standoff * radius_m)
    for state, slot in zip(group, slots, strict=True):
        vehicle_id = state.vehicle_id
        heading_for = going_to.get(vehicle_id, state.position)
        if heading_for is not None and math.dist(frame.to_enu(heading_for)[:2], slot) < stay_m:
            continue
        standing = _standing(request, vehicle_id, frame, slot, stay_m)
        if standing is not None:
            going_to[vehicle_id] = standing.position
            continue
        place, refusals = _first_allowed(airspace, state, target, frame, slot, safety, settings)
        if place is None:
            notes.append(f"vehicle {vehicle_id}: no place near beacon {target.beacon_id}: {_words(refusals)}")
            continue
        there = frame.to_enu(place)[:2]
        at_hand = heading_for is not None and math.dist(frame.to_enu(heading_for)[:2], there) < stay_m
        if at_hand or _standing(request, vehicle_id, frame, there, stay_m) is not None:
            continue
        # Later ways of this plan keep apart from this one as if it were already flown.
        going_to[vehicle_id] = place
        proposals.append(_proposal(request, state, target, place, frame, settings))
    return proposals


def _standing(
    request: PlanRequest, vehicle_id: int, frame: LocalFrame, slot: tuple[float, float], stay_m: float
) -> Proposal | None:
    """A proposal that can still be confirmed and says nearly the same."""
    for proposal in request.outstanding:
        if (
            proposal.vehicle_id == vehicle_id
            and proposal.mission_revision == request.mission.revision
            and request.time_ns < proposal.expires_ns
            and math.dist(frame.to_enu(proposal.position)[:2], slot) < stay_m
        ):
            return proposal
    return None


def _first_allowed(
    airspace: Airspace,
    state: VehicleState,
    target: TargetState,
    frame: LocalFrame,
    slot: tuple[float, float],
    safety: SafetySettings,
    settings: GuidanceSettings,
) -> tuple[Geodetic | None, list[Refusal]]:
    """The first place near ``slot`` that the gate allows; else why the place itself was refused."""
    assert state.position is not None
    assert state.home is not None
    center = frame.to_enu(target.position)
    radius_m = math.dist(slot, center[:2])
    azimuth_rad = math.atan2(slot[1] - center[1], slot[0] - center[0])
    first_refusals: list[Refusal] = []
    places = [
        (
            center[0] + factor * radius_m * math.cos(azimuth_rad + math.radians(turn_deg)),
            center[1] + factor * radius_m * math.sin(azimuth_rad + math.radians(turn_deg)),
        )
        for turn_deg, factor in itertools.product(_TURNS_DEG, _RADIUS_FACTORS)
    ]
    # Where the fence ends before the ring begins: as far towards it as may be.
    here = frame.to_enu(state.position)
    places += [
        (here[0] + part * (slot[0] - here[0]), here[1] + part * (slot[1] - here[1])) for part in _PARTS_OF_WAY
    ]
    heights = _heights(state, airspace.mission.limits, settings)
    for height_m, (east, north) in itertools.product(heights, places):
        if math.dist((east, north), here[:2]) < settings.move_min_m:
            continue
        ground = frame.to_geodetic((east, north, center[2]))
        place = Geodetic(ground.latitude_deg, ground.longitude_deg, state.home.altitude_amsl_m + height_m)
        refusals = leg_refusals(state.vehicle_id, place, airspace, safety)
        if not refusals:
            return place, []
        first_refusals = first_refusals or refusals
    return None, first_refusals


def _heights(state: VehicleState, limits: FlightLimits, settings: GuidanceSettings) -> list[float]:
    """Heights above home to try: the present one first, then one separation up and down, and so on."""
    low = limits.floor_m + settings.height_margin_m
    high = limits.ceiling_m - settings.height_margin_m
    if low > high:
        low = high = (limits.floor_m + limits.ceiling_m) / 2.0
    present = min(max(state.height_above_home_m or low, low), high)
    step = limits.separation_m + 1.0
    tried = [present + step * count for count in (0, 1, -1, 2, -2, 3, -3)]
    return [height for height in tried if low <= height <= high]


def _proposal(
    request: PlanRequest,
    state: VehicleState,
    target: TargetState,
    place: Geodetic,
    frame: LocalFrame,
    settings: GuidanceSettings,
) -> Proposal:
    assert state.home is not None
    there, center = (frame.to_enu(p) for p in (place, target.position))
    azimuth_rad = math.atan2(there[1] - center[1], there[0] - center[0])
    side = _POINTS[round(azimuth_rad / (math.pi / 4.0)) % 8]
    away_m = math.dist(there[:2], center[:2])
    # No way to fly in it: the vehicle flies on meanwhile, and the page counts from where it is.
    reason = (
        f"beacon {target.beacon_id} is known to within {target.radius_90_m:.0f} m: "
        f"listen from {away_m:.0f} m {side} of the estimate"
    )
    return Proposal(
        # Unique: one plan at a time, one proposal a vehicle; and a replay gets it with the plan.
        proposal_id=f"{request.time_ns // 1_000_000:x}-{state.vehicle_id}",
        vehicle_id=state.vehicle_id,
        beacon_id=target.beacon_id,
        position=place,
        height_above_home_m=place.altitude_amsl_m - state.home.altitude_amsl_m,
        reason=reason,
        created_ns=request.time_ns,
        expires_ns=request.time_ns + round(settings.valid_s * 1e9),
        mission_revision=request.mission.revision,
        target_sequence=target.sequence,
    )


def _words(refusals: list[Refusal]) -> str:
    return "; ".join(refusal.text for refusal in refusals)
