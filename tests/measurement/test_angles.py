"""Rotations against closed forms, numpy and brute-force propagation."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.measurement.angles import (
    IDENTITY,
    body_bearing,
    earth_bearing,
    known_std,
    rotate,
    slerp,
    usable_angles,
)

angle = st.floats(-math.pi, math.pi)
elevation = st.floats(-1.5, 1.5)
quaternions = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .filter(lambda q: math.hypot(*q) > 0.1)
    .map(lambda q: tuple(x / math.hypot(*q) for x in q))
)


def matrix(q):
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def enu(bearing):
    c = math.cos(bearing.elevation_rad)
    return np.array(
        [
            c * math.cos(bearing.azimuth_rad),
            c * math.sin(bearing.azimuth_rad),
            math.sin(bearing.elevation_rad),
        ]
    )


@given(q=quaternions, v=st.tuples(*[st.floats(-10, 10)] * 3))
def test_rotation_is_the_rotation_matrix(q, v):
    np.testing.assert_allclose(rotate(q, v), matrix(q) @ v, atol=1e-12)


@pytest.mark.parametrize(
    ("azimuth_ned", "expected_enu"),
    [(0.0, (0, 1, 0)), (math.pi / 2, (1, 0, 0)), (math.pi, (0, -1, 0)), (-math.pi / 2, (-1, 0, 0))],
)
def test_earth_frame_azimuth_from_north_clockwise_to_east_counter_clockwise(azimuth_ned, expected_enu):
    np.testing.assert_allclose(enu(earth_bearing(azimuth_ned, 0.0, None, None)), expected_enu, atol=1e-12)


def test_elevation_is_positive_up():
    assert enu(earth_bearing(0.3, -0.7, None, None))[2] < 0
    assert enu(body_bearing(0.3, -0.7, None, None, IDENTITY))[2] < 0


@given(az=angle, el=elevation, q=quaternions)
def test_body_frame_bearing_is_the_rotated_unit_vector(az, el, q):
    body = np.array([math.cos(el) * math.cos(az), math.cos(el) * math.sin(az), -math.sin(el)])
    north, east, down = matrix(q) @ body
    np.testing.assert_allclose(enu(body_bearing(az, el, None, None, q)), [east, north, -down], atol=1e-9)


@given(az=angle, el=elevation)
def test_level_and_facing_north_both_frames_agree(az, el):
    earth, body = earth_bearing(az, el, 0.03, 0.05), body_bearing(az, el, 0.03, 0.05, IDENTITY)
    np.testing.assert_allclose(enu(earth), enu(body), atol=1e-12)
    assert body.azimuth_std_rad == pytest.approx(0.03, rel=1e-6)
    assert body.elevation_std_rad == pytest.approx(0.05, rel=1e-6)


def test_banked_by_90_degrees_the_errors_change_places():
    """Rolled right: the airframe's right points down; dead ahead, σ of azimuth becomes elevation's."""
    roll = (math.cos(math.pi / 4), math.sin(math.pi / 4), 0.0, 0.0)
    bearing = body_bearing(0.0, 0.0, 0.01, 0.04, roll)
    assert bearing.azimuth_std_rad == pytest.approx(0.04)
    assert bearing.elevation_std_rad == pytest.approx(0.01)


@pytest.mark.parametrize("seed", range(5))
def test_errors_match_brute_force(seed):
    rng = np.random.default_rng(seed)
    q = rng.normal(size=4)
    q = tuple(float(x) for x in q / np.linalg.norm(q))
    az, el, s_az, s_el = rng.uniform(-3, 3), rng.uniform(-1, 1), 0.004, 0.002
    centre = body_bearing(az, el, s_az, s_el, q)
    if abs(centre.elevation_rad) > 1.3:
        pytest.skip("too near the vertical for a linear law")
    drawn = [
        body_bearing(a, e, None, None, q)
        for a, e in zip(rng.normal(az, s_az, 4000), rng.normal(el, s_el, 4000), strict=True)
    ]
    azimuths = [math.remainder(b.azimuth_rad - centre.azimuth_rad, 2 * math.pi) for b in drawn]
    assert centre.azimuth_std_rad == pytest.approx(np.std(azimuths), rel=0.06)
    assert centre.elevation_std_rad == pytest.approx(np.std([b.elevation_rad for b in drawn]), rel=0.06)


def test_where_a_tilted_airframe_sees_straight_down_the_azimuth_means_nothing():
    tilt = 0.3
    pitch = (math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0)
    bearing = body_bearing(math.pi, -math.pi / 2 + tilt, 0.05, 0.05, pitch)
    assert bearing.elevation_rad == pytest.approx(-math.pi / 2, abs=1e-7)
    assert bearing.azimuth_std_rad == math.pi
    assert bearing.elevation_std_rad is not None
    assert 0.05 * math.sin(tilt) <= bearing.elevation_std_rad <= 0.05 + 1e-12


def test_straight_down_from_a_level_airframe_the_sensor_keeps_its_word():
    bearing = body_bearing(0.0, -math.pi / 2, 0.05, 0.04, IDENTITY)
    assert bearing.elevation_rad == pytest.approx(-math.pi / 2)
    assert bearing.azimuth_std_rad == pytest.approx(0.05)
    assert bearing.elevation_std_rad == pytest.approx(0.04)


@pytest.mark.parametrize(
    ("az", "el", "usable"),
    [
        (0.0, 0.0, True),
        (3.0, -math.pi / 2, True),
        (math.nan, 0.0, False),
        (0.0, math.nan, False),
        (math.inf, 0.0, False),
        (0.0, math.inf, False),
        (0.0, 1.7, False),
    ],
)
def test_what_is_no_direction(az, el, usable):
    assert usable_angles(az, el) is usable


@pytest.mark.parametrize("std", [math.nan, math.inf, 0.0, -0.1])
def test_a_standard_error_that_says_nothing(std):
    assert known_std(std) is None


@given(a=quaternions, b=quaternions, f=st.floats(0, 1))
def test_slerp_turns_at_a_constant_rate_the_short_way(a, b, f):
    def turn(p, q):
        return 2 * math.acos(min(1.0, abs(sum(x * y for x, y in zip(p, q, strict=True)))))

    mid = slerp(a, b, f)
    assert math.hypot(*mid) == pytest.approx(1.0)
    assert turn(a, mid) == pytest.approx(f * turn(a, b), abs=2e-6)
    assert turn(mid, b) == pytest.approx((1 - f) * turn(a, b), abs=2e-6)


def test_slerp_takes_q_and_minus_q_for_the_same_attitude():
    q = (math.cos(0.4), 0.0, 0.0, math.sin(0.4))
    minus = tuple(-x for x in q)
    assert slerp(q, minus, 0.5) == pytest.approx(q)
