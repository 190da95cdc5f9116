"""Line of sight is geometry: lengths against closed forms, and flips as vehicles move."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import LineString, Polygon

from sim_sitl.scenario import BeaconSpec, Obstacle
from sim_sitl.scenario_file import load_scenario
from sim_sitl.world import World, obstructed_length_m

BOX = Obstacle("box", ((10, -10), (20, -10), (20, 10), (10, 10)), 0.0, 20.0, 0.5, 4.0)


def beacon(east: float, north: float, up: float, buried: float = 0.0) -> BeaconSpec:
    return BeaconSpec(1, (east, north, up), 15.0, 1.0, 867_500_000, buried)


def test_a_vehicle_that_flies_behind_a_building_loses_line_of_sight_and_gets_it_back() -> None:
    world = World((BOX,))
    states = [
        world.obstruction(beacon(0, 0, 1), (100 * math.cos(a), 100 * math.sin(a), 30.0)).line_of_sight
        for a in (-math.pi / 2, -0.3, 0.0, 0.3, math.pi / 2)
    ]
    assert states == [True, False, False, False, True]
    # Over the roof: from high enough the line passes above the box.
    assert not world.obstruction(beacon(0, 0, 1), (30, 0, 25)).line_of_sight
    assert world.obstruction(beacon(0, 0, 1), (30, 0, 90)).line_of_sight


def test_obstructed_length_and_loss() -> None:
    obstruction = World((BOX,)).obstruction(beacon(0, 0, 5), (40, 0, 5))
    assert obstruction.length_m == pytest.approx(10.0)
    assert obstruction.loss_db == pytest.approx(4.0 + 0.5 * 10.0)
    assert obstruction.names == ("box",)
    slanted = obstructed_length_m(BOX, (0, 0, 0), (30, 0, 30))
    assert slanted == pytest.approx(10 * math.sqrt(2))
    # Leaves through the roof at 20 m.
    assert obstructed_length_m(BOX, (15, 0, 5), (15, 0, 50)) == pytest.approx(15.0)
    assert obstructed_length_m(BOX, (15, 0, 25), (15, 5, 25)) == 0.0


def test_a_beacon_inside_is_obstructed_from_everywhere() -> None:
    world = World((BOX,))
    for angle in range(0, 360, 15):
        vehicle = (15 + 100 * math.cos(math.radians(angle)), 100 * math.sin(math.radians(angle)), 50.0)
        assert not world.obstruction(beacon(15, 0, 2), vehicle).line_of_sight


def test_a_buried_beacon_is_obstructed_more_the_lower_it_is_seen() -> None:
    world = World(())
    above = world.obstruction(beacon(0, 0, 0, buried=2.0), (0, 0, 50))
    aside = world.obstruction(beacon(0, 0, 0, buried=2.0), (100, 0, 50))
    assert above.length_m == pytest.approx(2.0)
    assert aside.length_m == pytest.approx(2.0 * math.hypot(100, 50) / 50)
    assert aside.loss_db > above.loss_db
    assert above.buried


@given(
    st.tuples(*[st.floats(-60, 60)] * 2),
    st.tuples(*[st.floats(-60, 60)] * 2),
)
def test_horizontal_lengths_agree_with_shapely_on_a_concave_prism(
    start: tuple[float, float], end: tuple[float, float]
) -> None:
    ring = ((-30.0, -20.0), (30.0, -20.0), (30.0, 25.0), (5.0, -5.0), (-30.0, 25.0))
    obstacle = Obstacle("concave", ring, 0.0, 10.0, 1.0, 0.0)
    expected = LineString([start, end]).intersection(Polygon(ring)).length if start != end else 0.0
    assert obstructed_length_m(obstacle, (*start, 5.0), (*end, 5.0)) == pytest.approx(expected, abs=1e-4)


def test_links_of_the_city_block_turn_both_ways_along_the_ring() -> None:
    scenario = load_scenario("city-block")
    world = World(scenario.obstacles)
    radius, height = scenario.vehicles.ring_radius_m, scenario.vehicles.altitude_m
    shares = []
    for spec in scenario.beacons:
        states = [
            world.obstruction(spec, (radius * math.cos(a), radius * math.sin(a), height)).line_of_sight
            for a in (2 * math.pi * i / 180 for i in range(180))
        ]
        shares.append(sum(states) / len(states))
    assert any(0.1 < share < 0.9 for share in shares)
    assert min(shares) == 0.0, "one beacon is inside a house"
