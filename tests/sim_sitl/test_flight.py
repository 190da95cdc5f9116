"""Motion within its limits, attitude that fits it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_sitl.flight import (
    GRAVITY_M_S2,
    HORIZONTAL_ACCELERATION_M_S2,
    Descend,
    Flight,
    GoTo,
    Orbit,
    Stay,
    quaternion_from_euler,
    rotate_to_body,
)

DT = 0.02


def flight(up: float = 50.0) -> Flight:
    return Flight((0.0, 0.0, up), 0.0, np.random.default_rng(1))


def test_goes_there_within_its_limits_and_stops_without_overshoot() -> None:
    plane = flight()
    plane.set_goal(GoTo((120.0, 50.0, 60.0), 10.0))
    fastest, overshoot, before = 0.0, 0.0, [0.0, 0.0]
    for _ in range(int(30 / DT)):
        plane.step(DT)
        velocity = plane.velocity_m_s[:2]
        fastest = max(fastest, math.hypot(*velocity))
        assert math.dist(velocity, before) <= HORIZONTAL_ACCELERATION_M_S2 * DT + 1e-9
        before = list(velocity)
        overshoot = max(overshoot, math.hypot(*plane.position_m[:2]) - 130.0)
    assert fastest == pytest.approx(10.0, abs=0.2)
    assert overshoot < 0.5
    assert math.dist(plane.position_enu_m, (120.0, 50.0, 60.0)) < 0.5


def test_stay_stops_where_it_can_and_holds_against_gusts() -> None:
    plane = flight()
    plane.set_goal(GoTo((500.0, 0.0, 50.0), 10.0))
    for _ in range(500):
        plane.step(DT)
    plane.set_goal(Stay())
    for _ in range(500):
        plane.step(DT)
    stopped = plane.position_enu_m
    for _ in range(3000):
        plane.step(DT)
        assert math.dist(plane.position_enu_m, stopped) < 1.5


def test_leans_into_acceleration_and_turns() -> None:
    plane = flight()
    plane.set_goal(GoTo((0.0, 500.0, 50.0), 10.0))
    for _ in range(60):
        plane.step(DT)
    expected = -math.atan2(HORIZONTAL_ACCELERATION_M_S2, GRAVITY_M_S2)
    assert plane.pitch_rad == pytest.approx(expected, abs=0.1), "nose down, heading north"
    plane.set_goal(Orbit((0.0, 0.0), 40.0, 50.0, 8.0))
    for _ in range(3000):
        plane.step(DT)
    # Counter-clockwise is to the left: it leans left by the centripetal acceleration.
    assert plane.roll_rad == pytest.approx(-math.atan2(8.0**2 / 40.0, GRAVITY_M_S2), abs=0.04)
    east, north, _ = plane.velocity_m_s
    assert math.remainder(plane.yaw_rad - math.atan2(east, north), 2 * math.pi) == pytest.approx(0.0, abs=0.2)


def test_descends_slowly() -> None:
    plane = flight(20.0)
    plane.set_goal(Descend())
    for _ in range(100):
        plane.step(DT)
    assert -1.6 < plane.velocity_m_s[2] < -1.2


def test_quaternion_and_body_rotation_by_known_turns() -> None:
    # Heading east: north is to the left, east is ahead.
    heading_east = quaternion_from_euler(0.0, 0.0, math.pi / 2)
    assert rotate_to_body(heading_east, (0.0, 1.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0), abs=1e-12)
    assert rotate_to_body(heading_east, (1.0, 0.0, 0.0)) == pytest.approx((0.0, -1.0, 0.0), abs=1e-12)
    # Nose up by 90°: what is down is behind.
    nose_up = quaternion_from_euler(0.0, math.pi / 2, 0.0)
    assert rotate_to_body(nose_up, (0.0, 0.0, 1.0)) == pytest.approx((-1.0, 0.0, 0.0), abs=1e-12)
    # Rolled right by 90°: what is down is to the right.
    rolled = quaternion_from_euler(math.pi / 2, 0.0, 0.0)
    assert rotate_to_body(rolled, (0.0, 0.0, 1.0)) == pytest.approx((0.0, 1.0, 0.0), abs=1e-12)
