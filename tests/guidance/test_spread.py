"""Spreading: equal sides, inside the fence, apart; and when it is not worth a proposal."""

from __future__ import annotations

import itertools
import math
import pickle
import re
from dataclasses import replace

import pytest

from groundstation.domain.mission import Area, FlightLimits
from groundstation.domain.target import Environment, TargetState
from groundstation.guidance import GuidanceSettings, PlanRequest, propose
from groundstation.guidance.spread import standoff_m
from groundstation.safety.gate import Airspace, leg_refusals
from groundstation.safety.settings import SafetySettings

SETTINGS = GuidanceSettings()
SAFETY = SafetySettings()
SECOND = 10**9


@pytest.fixture
def belief(place, now_ns):
    def build(beacon_id=7, east=20.0, north=10.0, radius=60.0, **changes):
        state = TargetState(
            beacon_id=beacon_id,
            time_ns=now_ns,
            first_heard_ns=now_ns - 30 * SECOND,
            last_heard_ns=now_ns,
            position=place(east, north, 2.0),
            covariance_enu_m2=(900.0, 0.0, 0.0, 900.0, 0.0, 25.0),
            radius_90_m=radius,
            environment=Environment.MIXED,
            los_links=2,
            links=4,
            windows=20,
            method="adaptive",
            height_reference="home",
            sequence=5,
            snapshot=None,
        )
        return replace(state, **changes)

    return build


@pytest.fixture
def request_of(mission, now_ns):
    def build(vehicles, targets, **changes):
        request = PlanRequest(now_ns, mission, tuple(vehicles), tuple(targets))
        return replace(request, **changes)

    return build


@pytest.fixture
def cluster(vehicle):
    return [vehicle(i, (-60 + 25 * i, -60, 50)) for i in range(1, 5)]


def places_after(plan, vehicles):
    """Where each vehicle is when all of the plan has been flown."""
    flown = {p.vehicle_id: p.position for p in plan.proposals}
    return {state.vehicle_id: flown.get(state.vehicle_id, state.position) for state in vehicles}


def widest_gap(places, target, frame):
    center = frame.to_enu(target.position)
    enu = [frame.to_enu(p) for p in places]
    angles = sorted(math.atan2(north - center[1], east - center[0]) for east, north, _ in enu)
    return max((b - a) % (2 * math.pi) for a, b in zip(angles, [*angles[1:], angles[0]], strict=True))


def test_vehicles_in_a_cluster_are_spread_round_the_estimate(request_of, cluster, belief, frame):
    target = belief()
    plan = propose(request_of(cluster, [target]), SETTINGS, SAFETY)
    assert len(plan.proposals) >= 3
    # Nudges to keep the ways apart may turn a place, never leave one side empty.
    before = widest_gap([state.position for state in cluster], target, frame)
    assert before > math.radians(270)
    assert widest_gap(places_after(plan, cluster).values(), target, frame) <= math.radians(150)
    assert all(p.mission_revision == 3 and p.target_sequence == 5 for p in plan.proposals)
    # What changes while the vehicle flies on is not in it: the page counts the way from where it is.
    reason = re.compile(r"beacon 7 is known to within 60 m: listen from \d+ m [a-z-]+ of the estimate")
    assert all(reason.fullmatch(p.reason) for p in plan.proposals)


@pytest.mark.parametrize("south_m", [-200.0, -10.0, 0.0, 10.0, 20.0])
def test_every_proposal_passes_the_gate_with_all_the_others_flown(
    request_of, vehicle, belief, mission, now_ns, ring, south_m
):
    """Where the fence cuts the ring, places are moved towards each other: they must not meet."""
    corners = [(-200, south_m), (200, south_m), (200, 200), (-200, 200)]
    mission = replace(mission, fence=Area(((ring(corners),),)))
    cluster = [vehicle(i, (-60 + 25 * i, 30, 50)) for i in range(1, 6)]
    plan = propose(request_of(cluster, [belief(north=0.0, radius=50.0)], mission=mission), SETTINGS, SAFETY)
    assert len(plan.proposals) >= 2
    vehicles = {state.vehicle_id: state for state in cluster}
    for proposal in plan.proposals:
        earlier = {p.vehicle_id: p.position for p in plan.proposals if p.vehicle_id < proposal.vehicle_id}
        space = Airspace(now_ns, mission, vehicles, earlier)
        assert leg_refusals(proposal.vehicle_id, proposal.position, space, SAFETY) == []


def test_places_stay_inside_a_fence_that_cuts_the_ring(request_of, cluster, belief, mission, ring, frame):
    strip = ring([(-120, -90), (120, -90), (120, 45), (-120, 45)])
    fenced = replace(mission, fence=Area(((strip,),)))
    plan = propose(request_of(cluster, [belief(radius=80.0)], mission=fenced), SETTINGS, SAFETY)
    assert plan.proposals
    for proposal in plan.proposals:
        east, north, _ = frame.to_enu(proposal.position)
        assert -115.1 <= east <= 115.1
        assert -85.1 <= north <= 40.1


def test_after_flying_the_plan_nobody_is_sent_again(request_of, cluster, belief, frame, vehicle):
    target = belief()
    plan = propose(request_of(cluster, [target]), SETTINGS, SAFETY)
    arrived = []
    for vehicle_id, there in places_after(plan, cluster).items():
        east, north, _ = frame.to_enu(there)
        arrived.append(vehicle(vehicle_id, (east, north, there.altitude_amsl_m - 584.0)))
    again = propose(request_of(arrived, [replace(target, sequence=6)]), SETTINGS, SAFETY)
    assert len(again.proposals) <= 1


def test_a_standing_proposal_that_says_the_same_is_not_repeated(request_of, cluster, belief, now_ns):
    first = propose(request_of(cluster, [belief()]), SETTINGS, SAFETY)
    moved = belief(east=22.0, sequence=6)
    again = propose(
        request_of(cluster, [moved], outstanding=first.proposals, time_ns=now_ns + SECOND), SETTINGS, SAFETY
    )
    assert not {p.vehicle_id for p in again.proposals} & {p.vehicle_id for p in first.proposals}
    later = now_ns + 91 * SECOND
    fresh = [replace(state, position_time_ns=later, last_heartbeat_ns=later) for state in cluster]
    heard = replace(moved, last_heard_ns=later)
    expired = propose(
        request_of(fresh, [heard], outstanding=first.proposals, time_ns=later), SETTINGS, SAFETY
    )
    assert len(expired.proposals) >= len(first.proposals)


def test_two_beacons_share_the_vehicles_by_uncertainty(request_of, vehicle, belief):
    fleet = [vehicle(i, (-150 + 30 * i, -120, 50)) for i in range(1, 9)]
    near, far = belief(1, -90.0, 60.0, 40.0), belief(2, 90.0, 60.0, 90.0)
    plan = propose(request_of(fleet, [near, far]), SETTINGS, SAFETY)
    by_beacon = {b: [p.vehicle_id for p in plan.proposals if p.beacon_id == b] for b in (1, 2)}
    assert len(by_beacon[1]) <= 3
    assert len(by_beacon[2]) >= 3


def test_places_of_one_plan_keep_their_distance(request_of, cluster, belief, frame):
    plan = propose(request_of(cluster, [belief()]), SETTINGS, SAFETY)
    for a, b in itertools.combinations(plan.proposals, 2):
        assert math.dist(frame.to_enu(a.position), frame.to_enu(b.position)) >= 14.9


def test_no_vehicle_is_sent_for_what_it_cannot_make_better(request_of, cluster, belief):
    """5 m of 90 % radius, of which the vehicles' own places, known to 2 m, are 4.3 m: found within 3 m."""
    target = belief(radius=5.0)
    assert propose(request_of(cluster, [target]), SETTINGS, SAFETY).proposals
    vague = replace(target, vehicle_position_std_m=2.0)
    assert vague.least_radius_90_m == pytest.approx(2.0 * 2.146, abs=1e-3)
    plan = propose(request_of(cluster, [vague]), SETTINGS, SAFETY)
    assert plan.proposals == ()
    assert any("nothing to gain" in note for note in plan.notes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"radius": 2.0}, "nothing to gain"),
        ({"last_heard_ns": 0}, "not heard for"),
    ],
)
def test_a_beacon_that_needs_nobody_says_so(request_of, cluster, belief, changes, words):
    plan = propose(request_of(cluster, [belief(**changes)]), SETTINGS, SAFETY)
    assert plan.proposals == ()
    assert any(words in note for note in plan.notes)


def test_without_a_fence_there_is_a_note_and_nothing_else(request_of, cluster, belief, mission):
    plan = propose(request_of(cluster, [belief()], mission=replace(mission, fence=None)), SETTINGS, SAFETY)
    assert plan.proposals == ()
    assert "no fence" in plan.notes[0]


def test_a_vehicle_that_cannot_go_has_its_reason_in_the_notes(request_of, cluster, belief):
    fleet = [replace(cluster[0], lost=True), replace(cluster[1], home=None), *cluster[2:]]
    plan = propose(request_of(fleet, [belief()]), SETTINGS, SAFETY)
    assert {p.vehicle_id for p in plan.proposals} <= {3, 4}
    assert any(note.startswith("vehicle 1 ") and "no heartbeat" in note for note in plan.notes)
    assert any(note.startswith("vehicle 2 ") and "home" in note for note in plan.notes)


def test_a_fence_too_small_for_any_place_is_said(request_of, vehicle, belief, mission, ring):
    tiny = ring([(-12, -12), (12, -12), (12, 12), (-12, 12)])
    plan = propose(
        request_of([vehicle(1, (0, 0, 50))], [belief()], mission=replace(mission, fence=Area(((tiny,),)))),
        SETTINGS,
        SAFETY,
    )
    assert plan.proposals == ()
    assert any("no place near beacon 7" in note and "fence" in note for note in plan.notes)


def test_heights_keep_off_floor_and_ceiling(request_of, vehicle, belief, mission):
    limited = replace(mission, limits=FlightLimits(floor_m=49.0, ceiling_m=60.0))
    plan = propose(request_of([vehicle(1, (0, -60, 50))], [belief()], mission=limited), SETTINGS, SAFETY)
    assert [51.0 <= p.height_above_home_m <= 58.0 for p in plan.proposals] == [True]


def test_the_distance_follows_doubt_and_height(belief):
    assert standoff_m(belief(radius=500.0), 50.0, SETTINGS) == SETTINGS.standoff_max_m
    assert standoff_m(belief(radius=80.0), 50.0, SETTINGS) == 80.0
    assert standoff_m(belief(radius=5.0), 50.0, SETTINGS) == 40.0
    assert standoff_m(belief(radius=5.0), 10.0, SETTINGS) == SETTINGS.standoff_min_m


def test_the_same_request_gives_the_same_plan_in_another_process_too(request_of, cluster, belief):
    request = request_of(cluster, [belief()])
    plan = propose(request, SETTINGS, SAFETY)
    copy = pickle.loads(pickle.dumps(request))
    assert propose(copy, SETTINGS, SAFETY) == plan
    assert len({p.proposal_id for p in plan.proposals}) == len(plan.proposals)
