import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.measurement.pose_history import Pose, PoseHistory, PoseOutcome, flown_m
from groundstation.measurement.settings import MeasurementSettings

S = 1_000_000_000
MS = 1_000_000


def yaw(angle_rad):
    return math.cos(angle_rad / 2), 0.0, 0.0, math.sin(angle_rad / 2)


@pytest.fixture
def history(settings):
    """Ten seconds of a straight flight north-east, climbing, turning at 0.2 rad/s."""
    made = PoseHistory(settings)
    for i in range(51):
        made.add_position(i * 200 * MS, 47.0 + i * 2e-5, 8.0 + i * 1e-5, 500.0 + i)
    for i in range(101):
        made.add_attitude(i * 100 * MS, yaw(0.02 * i))
    return made


@given(time_ms=st.integers(0, 10_000))
def test_between_poses_position_is_linear_and_attitude_on_the_great_circle(time_ms):
    made = PoseHistory(MeasurementSettings())
    for i in range(51):
        made.add_position(i * 200 * MS, 47.0 + i * 2e-5, 8.0 + i * 1e-5, 500.0 + i)
    for i in range(101):
        made.add_attitude(i * 100 * MS, yaw(0.02 * i))
    pose = made.at(time_ms * MS)
    assert isinstance(pose, Pose)
    steps = time_ms / 200
    assert pose.latitude_deg == pytest.approx(47.0 + steps * 2e-5, abs=1e-11)
    assert pose.longitude_deg == pytest.approx(8.0 + steps * 1e-5, abs=1e-11)
    assert pose.altitude_amsl_m == pytest.approx(500.0 + steps, abs=1e-9)
    assert pose.attitude == pytest.approx(yaw(0.2 * time_ms / 1000), abs=1e-9)


def test_newer_than_the_newest_waits_and_is_carried_on_only_a_little(history):
    assert history.at(10_050 * MS) is PoseOutcome.NOT_YET
    carried = history.at(10_200 * MS, final=True)
    assert isinstance(carried, Pose)
    assert carried.altitude_amsl_m == pytest.approx(551.0)
    assert carried.attitude == pytest.approx(yaw(2.0))
    assert history.at(10_301 * MS, final=True) is PoseOutcome.TOO_OLD


def test_older_than_the_oldest_is_named(history):
    assert history.at(-S) is PoseOutcome.TOO_OLD
    assert history.at(-S, final=True) is PoseOutcome.TOO_OLD


def test_nothing_is_interpolated_across_a_gap(settings):
    made = PoseHistory(settings)
    for second in (0, 1, 2, 8, 9):
        made.add_position(second * S, 47.0, 8.0, 500.0)
        made.add_attitude(second * S, yaw(0.0))
    assert made.at(5 * S) is PoseOutcome.GAP
    assert made.at(5 * S, final=True) is PoseOutcome.GAP
    assert isinstance(made.at(2 * S), Pose)


def test_a_missing_attitude_makes_the_sample_wait_then_leaves_the_position(settings):
    made = PoseHistory(settings)
    made.add_position(0, 47.0, 8.0, 500.0)
    made.add_position(S, 47.0, 8.0, 500.0)
    assert made.covered_ns() is None
    assert made.at(S // 2) is PoseOutcome.NOT_YET
    pose = made.at(S // 2, final=True)
    assert isinstance(pose, Pose)
    assert pose.attitude is None


def test_no_position_at_all_is_missing(settings):
    made = PoseHistory(settings)
    made.add_attitude(0, yaw(0.0))
    assert made.at(0, final=True) is PoseOutcome.MISSING


def test_poses_out_of_order_are_sorted_in_and_doubles_refused(settings):
    made = PoseHistory(settings)
    for second in (0, 2, 1):
        assert made.add_position(second * S, 47.0, 8.0, 500.0 + second)
        assert made.add_attitude(second * S, yaw(0.0))
    assert not made.add_position(S, 1.0, 1.0, 1.0)
    assert not made.add_attitude(S, yaw(1.0))
    pose = made.at(1500 * MS)
    assert isinstance(pose, Pose)
    assert pose.altitude_amsl_m == pytest.approx(501.5)


def test_covered_is_the_older_of_both_streams(history):
    history.add_attitude(10_100 * MS, yaw(0.0))
    assert history.covered_ns() == 10_000 * MS


def test_the_history_is_bounded():
    made = PoseHistory(MeasurementSettings(pose_history=50))
    for i in range(1000):
        made.add_position(i * 200 * MS, 47.0, 8.0, 500.0)
        made.add_attitude(i * 200 * MS, yaw(0.0))
    kept = made.state()["positions"]["times"]
    assert 50 <= len(kept) <= 100
    assert made.at(0) is PoseOutcome.TOO_OLD
    assert isinstance(made.at(999 * 200 * MS), Pose)


def test_the_date_line_is_crossed_the_short_way(settings):
    made = PoseHistory(settings)
    made.add_position(0, 0.0, 179.9999, 0.0)
    made.add_position(S, 0.0, -179.9999, 0.0)
    for t in (0, S):
        made.add_attitude(t, yaw(0.0))
    pose = made.at(S * 3 // 4)
    assert isinstance(pose, Pose)
    assert pose.longitude_deg == pytest.approx(-179.99995)


def test_flown_distance_matches_the_ellipsoid_within_a_percent():
    import pymap3d

    a, b = Pose(-35.3625, 149.1654, 600.0, None), Pose(-35.3623, 149.1657, 610.0, None)
    expected = math.hypot(*pymap3d.geodetic2enu(*b[:3], *a[:3]))
    assert flown_m(a, b) == pytest.approx(expected, rel=0.01)


def test_clear_forgets(history):
    history.clear()
    assert history.at(S) is PoseOutcome.MISSING


def test_state_and_restore(history, settings):
    other = PoseHistory(settings)
    other.restore(history.state())
    assert other.at(1234 * MS) == history.at(1234 * MS)
    assert other.state() == history.state()
