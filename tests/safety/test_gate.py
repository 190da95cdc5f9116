"""The gate: every reason has a case that triggers it alone, and accepted legs keep every limit."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from groundstation.domain.geometry import Geodetic
from groundstation.domain.mission import Area, FlightLimits
from groundstation.domain.vehicle import Autopilot
from groundstation.safety.gate import leg_refusals, vehicle_refusals
from groundstation.safety.settings import SafetySettings

SETTINGS = SafetySettings()


def codes(vehicle_id, target, airspace):
    return [refusal.code for refusal in leg_refusals(vehicle_id, target, airspace, SETTINGS)]


def test_a_plain_leg_inside_the_fence_passes(airspace, vehicle, place):
    assert codes(1, place(100, 50, 60), airspace(vehicle(1, (0, 0, 50)))) == []


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"lost": True}, "vehicle_lost"),
        ({"armed": False}, "not_armed"),
        ({"ready": False}, "not_ready"),
        ({"mode": "RTL"}, "mode_not_ours"),
        ({"mode": "STABILIZE"}, "mode_not_ours"),
        ({"autopilot": Autopilot.UNKNOWN}, "mode_not_ours"),
        ({"home": None}, "height_datum_unknown"),
        ({"home": Geodetic(-35.3625, 149.1654, 600.0)}, "height_datum_inconsistent"),
    ],
)
def test_the_vehicle_itself_is_refused(airspace, vehicle, place, changes, code):
    assert codes(1, place(100, 50, 60), airspace(vehicle(1, (0, 0, 50), **changes))) == [code]


@pytest.mark.parametrize("age_s", [3.1, 60.0, -3.1])
def test_a_stale_pose_is_refused(airspace, vehicle, place, now_ns, age_s):
    state = vehicle(1, (0, 0, 50), position_time_ns=now_ns - round(age_s * 1e9))
    assert codes(1, place(100, 50, 60), airspace(state)) == ["stale_pose"]
    assert (
        codes(1, place(100, 50, 60), airspace(vehicle(1, (0, 0, 50), position_time_ns=now_ns - 10**9))) == []
    )


def test_no_fence_no_flight(airspace, vehicle, place, mission):
    for fence in (None, Area(())):
        space = airspace(vehicle(1, (0, 0, 50)), mission=replace(mission, fence=fence))
        assert codes(1, place(100, 50, 60), space) == ["no_fence"]


def test_a_search_area_is_not_a_fence(airspace, vehicle, place, mission):
    space = airspace(vehicle(1, (0, 0, 50)), mission=replace(mission, fence=None, search_area=mission.fence))
    assert codes(1, place(100, 50, 60), space) == ["no_fence"]


def test_a_vehicle_on_the_ground_is_refused_with_every_reason(airspace, vehicle, place):
    refused = codes(1, place(300, 0, 150), airspace(vehicle(1, (0, 0, 0.2), armed=False)))
    assert refused == [
        "not_armed",
        "on_ground",
        "target_outside_fence",
        "above_ceiling",
        "way_outside_heights",
    ]


@pytest.mark.parametrize(("height_m", "code"), [(19.0, "below_floor"), (121.0, "above_ceiling")])
def test_floor_and_ceiling_hold_for_the_target(airspace, vehicle, place, height_m, code):
    assert codes(1, place(50, 0, height_m), airspace(vehicle(1, (0, 0, 50)))) == [code]


@pytest.mark.parametrize("height_m", [20.0, 120.0])
def test_floor_and_ceiling_themselves_are_allowed(airspace, vehicle, place, height_m):
    assert codes(1, place(50, 0, height_m), airspace(vehicle(1, (0, 0, 50)))) == []


def test_heights_are_above_the_vehicles_home_not_the_origin(airspace, vehicle, place, frame, mission):
    low = replace(frame.origin, altitude_amsl_m=484.0)
    state = vehicle(1, (0, 0, -50), home=low, height_above_home_m=50.0)
    assert codes(1, place(50, 0, -40), airspace(state)) == []
    assert codes(1, place(50, 0, 40), airspace(state)) == ["above_ceiling"]


@pytest.mark.parametrize(("east_m", "allowed"), [(194.0, True), (196.0, False), (250.0, False)])
def test_the_margin_holds_at_the_target(airspace, vehicle, place, east_m, allowed):
    expected = [] if allowed else ["target_outside_fence"]
    assert codes(1, place(east_m, 0, 50), airspace(vehicle(1, (0, 0, 50)))) == expected


def test_a_vehicle_outside_the_fence_is_not_commanded(airspace, vehicle, place):
    assert codes(1, place(0, 0, 50), airspace(vehicle(1, (250, 0, 50)))) == ["start_outside_fence"]


def test_a_hole_in_the_fence_is_outside_and_the_way_must_go_round(airspace, vehicle, place, mission, ring):
    hole = ring([(40, -30), (60, -30), (60, 30), (40, 30)])
    outer = ring([(-200, -200), (200, -200), (200, 200), (-200, 200)])
    holed = replace(mission, fence=Area(((outer, hole),)))
    space = airspace(vehicle(1, (0, 0, 50)), mission=holed)
    assert codes(1, place(50, 0, 50), space) == ["target_outside_fence"]
    assert codes(1, place(100, 0, 50), space) == ["way_outside_fence"]
    assert codes(1, place(0, 100, 50), space) == []


@pytest.mark.parametrize(("away_m", "expected"), [(4.0, ["way_outside_fence"]), (6.0, [])])
def test_the_margin_holds_on_the_way(airspace, vehicle, place, mission, ring, away_m, expected):
    hole = ring([(40, away_m), (60, away_m), (60, 60), (40, 60)])
    outer = ring([(-200, -200), (200, -200), (200, 200), (-200, 200)])
    space = airspace(vehicle(1, (0, 0, 50)), mission=replace(mission, fence=Area(((outer, hole),))))
    assert codes(1, place(100, 0, 50), space) == expected


def test_a_way_between_two_fenced_polygons_leaves_both(airspace, vehicle, place, mission, ring):
    left = ring([(-100, -50), (20, -50), (20, 50), (-100, 50)])
    right = ring([(30, -50), (150, -50), (150, 50), (30, 50)])
    space = airspace(vehicle(1, (0, 0, 50)), mission=replace(mission, fence=Area(((left,), (right,)))))
    assert codes(1, place(100, 0, 50), space) == ["way_outside_fence"]


def test_a_fence_that_crosses_itself_is_not_mended_in_silence(airspace, vehicle, place, mission, ring):
    bow = ring([(-200, -200), (200, 200), (200, -200), (-200, 200)])
    space = airspace(vehicle(1, (0, 0, 50)), mission=replace(mission, fence=Area(((bow,),))))
    assert codes(1, place(100, 0, 50), space) == ["fence_invalid"]


def test_the_leg_has_a_longest_length(airspace, vehicle, place, mission):
    short = replace(mission, limits=FlightLimits(max_leg_m=80.0))
    assert codes(1, place(100, 0, 50), airspace(vehicle(1, (0, 0, 50)), mission=short)) == ["leg_too_long"]
    assert codes(1, place(60, 0, 50), airspace(vehicle(1, (0, 0, 50)), mission=short)) == []
    # Climbing counts.
    assert codes(1, place(60, 0, 110), airspace(vehicle(1, (0, 0, 50)), mission=short)) == ["leg_too_long"]


@pytest.mark.parametrize(
    "target",
    [
        Geodetic(91.0, 149.0, 600.0),
        Geodetic(0.0, 0.0, 600.0),
        Geodetic(math.nan, 149.0, 600.0),
        Geodetic(-35.0, math.inf, 600.0),
        Geodetic(-35.0, 149.0, math.nan),
    ],
)
def test_what_is_no_place_is_refused(airspace, vehicle, target):
    assert codes(1, target, airspace(vehicle(1, (0, 0, 50)))) == ["invalid_target"]


def test_an_unknown_vehicle_is_refused(airspace, place):
    assert codes(7, place(0, 0, 50), airspace()) == ["unknown_vehicle"]


class TestSeparation:
    def test_from_another_vehicle_on_the_way(self, airspace, vehicle, place):
        space = airspace(vehicle(1, (0, 0, 50)), vehicle(2, (50, 10, 50)))
        assert codes(1, place(100, 0, 50), space) == ["separation"]

    def test_height_counts_as_distance(self, airspace, vehicle, place):
        space = airspace(vehicle(1, (0, 0, 50)), vehicle(2, (50, 10, 66)))
        assert codes(1, place(100, 0, 50), space) == []

    def test_a_climb_is_flown_at_every_height_on_the_whole_way(self, airspace, vehicle, place):
        space = airspace(vehicle(1, (0, 0, 50)), vehicle(2, (50, 0, 75)))
        assert codes(1, place(100, 0, 50), space) == []
        assert codes(1, place(100, 0, 80), space) == ["separation"]

    def test_from_where_the_other_was_sent_and_its_way(self, airspace, vehicle, place):
        space = airspace(vehicle(1, (0, 0, 50)), vehicle(2, (50, 100, 50)))
        assert codes(1, place(100, 0, 50), space) == []
        crossing = replace(space, going_to={2: place(50, -100, 50)})
        assert codes(1, place(100, 0, 50), crossing) == ["separation"]

    def test_from_where_the_others_autopilot_says_it_goes(self, airspace, vehicle, place):
        other = vehicle(2, (50, 100, 50), position_target=place(50, -100, 50))
        assert codes(1, place(100, 0, 50), airspace(vehicle(1, (0, 0, 50)), other)) == ["separation"]

    def test_from_where_the_other_drifts(self, airspace, vehicle, place):
        other = vehicle(2, (50, 30, 50), velocity_ned_m_s=(-8.0, 0.0, 0.0))
        assert codes(1, place(100, 0, 50), airspace(vehicle(1, (0, 0, 50)), other)) == ["separation"]

    def test_an_armed_vehicle_somewhere_unknown(self, airspace, vehicle, place):
        other = vehicle(2, (0, 0, 50), position=None)
        assert codes(1, place(100, 0, 50), airspace(vehicle(1, (0, 0, 50)), other)) == ["separation_unknown"]
        parked = replace(other, armed=False)
        assert codes(1, place(100, 0, 50), airspace(vehicle(1, (0, 0, 50)), parked)) == []

    def test_an_old_pose_of_another(self, airspace, vehicle, place, now_ns):
        other = vehicle(2, (0, 150, 50), position_time_ns=now_ns - 4 * 10**9)
        assert codes(1, place(100, 0, 50), airspace(vehicle(1, (0, 0, 50)), other)) == ["separation_stale"]

    def test_a_lost_vehicle_flies_home_at_any_height(self, airspace, vehicle, place, now_ns):
        other = vehicle(2, (0, 150, 110), lost=True, position_time_ns=now_ns - 60 * 10**9)
        mine = vehicle(1, (-100, 75, 30))
        assert codes(1, place(100, 75, 30), airspace(mine, other)) == ["separation"]
        assert codes(1, place(-100, 100, 30), airspace(mine, other)) == []


@st.composite
def polygons(draw):
    """A star-shaped ring round home and a square hole, both simple."""
    count = draw(st.integers(4, 9))
    radii = draw(st.lists(st.floats(120, 400), min_size=count, max_size=count))
    hole = draw(st.tuples(st.floats(-60, 60), st.floats(-60, 60), st.floats(5, 25)))
    outer = [
        (r * math.cos(2 * math.pi * i / count), r * math.sin(2 * math.pi * i / count))
        for i, r in enumerate(radii)
    ]
    east, north, half = hole
    signs = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    square = [(east + half * x, north + half * y) for x, y in signs]
    return outer, square


def inside(point, corners):
    """Even-odd rule: a second opinion, not shapely's."""
    x, y = point
    crossings = False
    for (x1, y1), (x2, y2) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (y1 > y) != (y2 > y) and x < (x2 - x1) * (y - y1) / (y2 - y1) + x1:
            crossings = not crossings
    return crossings


coordinate = st.floats(-170, 170)
position = st.tuples(coordinate, coordinate, st.floats(15, 125))


@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.filter_too_much],
)
@given(shape=polygons(), start=position, end=position, other=position)
def test_whatever_passes_keeps_every_limit_all_the_way(
    airspace, vehicle, place, mission, ring, shape, start, end, other
):
    outer, hole = shape
    fenced = replace(mission, fence=Area(((ring(outer), ring(hole)),)))
    space = airspace(vehicle(1, start), vehicle(2, other), mission=fenced)
    target = place(*end)
    passed = codes(1, target, space) == []
    assume(passed)
    limits = fenced.limits
    for step in range(101):
        part = step / 100
        east, north, height = (a + part * (b - a) for a, b in zip(start, end, strict=True))
        assert inside((east, north), outer)
        assert not inside((east, north), hole)
        allowed_m = SETTINGS.height_tolerance_m
        assert limits.floor_m - allowed_m <= height <= limits.ceiling_m + allowed_m
        # Metres of the two planes differ by less than a part in a thousand.
        assert math.dist((east, north, height), other) >= limits.separation_m - 0.05
        for compass in range(8):
            angle = compass * math.pi / 4
            edge = (east + 4.9 * math.cos(angle), north + 4.9 * math.sin(angle))
            assert inside(edge, outer)
            assert not inside(edge, hole)
    assert limits.floor_m - 0.01 <= end[2] <= limits.ceiling_m + 0.01


def test_vehicle_refusals_are_part_of_the_legs(airspace, vehicle, place):
    space = airspace(vehicle(1, (0, 0, 50), lost=True, armed=False))
    own = vehicle_refusals(1, space, SETTINGS)
    assert [refusal.code for refusal in own] == ["vehicle_lost", "not_armed"]
    assert leg_refusals(1, place(0, 50, 50), space, SETTINGS)[: len(own)] == own
