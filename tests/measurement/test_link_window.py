"""Windows: when they close, and that their averages are the right ones."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.domain.radio import CirCapture, CloseReason
from groundstation.measurement.angles import Bearing
from groundstation.measurement.link_window import LinkWindows, Taken
from groundstation.measurement.pose_history import Pose
from groundstation.measurement.settings import MeasurementSettings

S = 1_000_000_000
MS = 1_000_000
LEVEL = (1.0, 0.0, 0.0, 0.0)
HERE = Pose(47.0, 8.0, 500.0, LEVEL)


def north(metres):
    return Pose(47.0 + math.degrees(metres / 6_378_137.0), 8.0, 500.0, LEVEL)


def make(**changes):
    return LinkWindows(dataclasses.replace(MeasurementSettings(), **changes), 3, 77)


def rss(windows, time_ns, closed, pose=HERE, level=-80.0):
    return windows.add_rss(time_ns, pose, level, -100.0, 868_000_000, closed)


def aoa(windows, time_ns, closed, azimuth=0.5, elevation=-0.4, std=0.02):
    return windows.add_aoa(time_ns, HERE, Bearing(azimuth, elevation, std, std), closed)


def capture(time_ns, capture_id=0):
    return CirCapture(time_ns, capture_id, np.ones(64, np.float32), 1.0, None, 0)


def test_pairs_of_level_and_bearing_close_when_both_have_m():
    windows, closed = make(), []
    for i in range(16):
        rss(windows, i * 100 * MS, closed)
        assert closed == []
        aoa(windows, i * 100 * MS, closed)
    (window,) = closed
    assert window.close_reason is CloseReason.FULL
    assert (window.rss_count, window.aoa_count) == (16, 16)
    assert (window.start_ns, window.end_ns) == (0, 1500 * MS)
    assert (window.vehicle_id, window.beacon_id) == (3, 77)
    assert not windows.is_open


def test_levels_alone_close_with_the_sample_after_the_last():
    windows, closed = make(), []
    for i in range(17):
        rss(windows, i * 100 * MS, closed)
    (window,) = closed
    assert (window.rss_count, window.aoa_count, window.close_reason) == (16, 0, CloseReason.FULL)
    assert window.azimuth_rad is None
    assert window.elevation_std_error_rad is None
    assert windows.is_open


def test_a_lost_bearing_does_not_hold_the_window_open():
    windows, closed = make(), []
    for i in range(17):
        rss(windows, i * 100 * MS, closed)
        if i != 7:
            aoa(windows, i * 100 * MS, closed)
    assert [(w.rss_count, w.aoa_count) for w in closed] == [(16, 15)]


def test_age_closes_on_the_next_sample_or_on_a_tick():
    windows, closed = make(window_age_s=2.0, window_settle_s=1.0), []
    rss(windows, 0, closed)
    rss(windows, 1900 * MS, closed)
    rss(windows, 2000 * MS, closed)
    assert [(w.rss_count, w.close_reason) for w in closed] == [(2, CloseReason.AGE)]
    windows.tick(4999 * MS, closed)
    assert len(closed) == 1
    windows.tick(5000 * MS, closed)
    assert [(w.rss_count, w.close_reason) for w in closed[1:]] == [(1, CloseReason.AGE)]


def test_distance_flown_closes_before_the_sample_that_would_be_too_far():
    windows, closed = make(window_distance_m=20.0, window_age_s=100.0), []
    for i in range(8):
        rss(windows, i * 100 * MS, closed, pose=north(i * 6.0))
    (window,) = closed[:1]
    assert window.close_reason is CloseReason.DISTANCE
    assert window.rss_count == 4
    assert window.path_length_m == pytest.approx(18.0, rel=1e-4)
    assert window.position.latitude_deg == pytest.approx(north(9.0).latitude_deg, abs=1e-10)


def test_there_and_back_is_distance_too():
    windows, closed = make(window_distance_m=20.0, window_age_s=100.0), []
    for i in range(4):
        rss(windows, i * 100 * MS, closed, pose=north(9.0 * (i % 2)))
    assert [w.close_reason for w in closed] == [CloseReason.DISTANCE]


def test_late_samples_within_tolerance_join_older_ones_are_named():
    windows, closed = make(late_tolerance_s=0.5), []
    rss(windows, 10 * S, closed)
    assert rss(windows, 9600 * MS, closed) is Taken.KEPT
    # The tolerance counts from the window's start, which has moved back.
    assert rss(windows, 9 * S, closed) is Taken.LATE
    windows.end(closed)
    (window,) = closed
    assert (window.start_ns, window.end_ns, window.rss_count) == (9600 * MS, 10 * S, 2)
    assert window.path_length_m == 0.0
    assert rss(windows, 9400 * MS, closed) is Taken.LATE
    assert rss(windows, 9600 * MS, closed) is Taken.KEPT


def test_captures_join_in_time_order_and_are_bounded():
    windows, closed = make(window_captures=3), []
    rss(windows, S, closed)
    for offset, number in ((300, 3), (100, 1), (200, 2)):
        item = capture(S + offset * MS, number)
        assert windows.add_capture(HERE, item, closed) is Taken.KEPT
    assert windows.add_capture(HERE, capture(S + 400 * MS, 4), closed) is Taken.CROWDED
    windows.end(closed)
    assert [c.capture_id for c in closed[0].captures] == [2, 3, 4]
    assert closed[0].close_reason is CloseReason.END


def test_the_newest_link_state_is_kept_and_ages():
    windows, closed = make(link_state_max_age_s=10.0), []
    assert windows.note_link_state(5 * S, 0.8)
    assert not windows.note_link_state(4 * S, 0.1)
    rss(windows, 6 * S, closed)
    windows.end(closed)
    rss(windows, 16 * S, closed)
    windows.end(closed)
    assert [w.sensor_los_probability for w in closed] == [0.8, None]


def test_missed_packets_are_the_windows_and_never_negative():
    windows, closed = make(), []
    windows.note_missed(5)
    windows.note_missed(-2)
    rss(windows, 0, closed)
    windows.end(closed)
    windows.note_missed(-1)
    rss(windows, S, closed)
    windows.end(closed)
    assert [w.missed_count for w in closed] == [3, 0]


def test_attitude_is_that_of_the_middle():
    windows, closed = make(), []
    for i in range(5):
        turned = (math.cos(i * 0.1), 0.0, 0.0, math.sin(i * 0.1))
        rss(windows, i * 100 * MS, closed, pose=HERE._replace(attitude=turned))
    windows.end(closed)
    assert closed[0].attitude == (math.cos(0.2), 0.0, 0.0, math.sin(0.2))


def test_forget_drops_the_open_window():
    windows, closed = make(), []
    rss(windows, 10 * S, closed)
    windows.forget()
    assert not windows.is_open
    assert rss(windows, S, closed) is Taken.KEPT


@given(cut=st.integers(0, 60))
def test_state_and_restore_continue_exactly(cut):
    def step(windows, i, closed):
        t = i * 100 * MS
        rss(windows, t, closed, pose=north(i * 1.7), level=-80.0 - (i * 7 % 11))
        if i % 3:
            aoa(windows, t, closed, azimuth=0.3 + 0.01 * i)
        if i % 8 == 0:
            windows.add_capture(north(i * 1.7), capture(t, i), closed)
        windows.tick(t, closed)

    whole, first, expected, got = make(), make(), [], []
    for i in range(60):
        step(whole, i, expected)
    for i in range(cut):
        step(first, i, got)
    second = make()
    second.restore(first.state())
    for i in range(cut, 60):
        step(second, i, got)

    def plain(window):
        return [
            getattr(window, f.name) if f.name != "captures" else [c.capture_id for c in window.captures]
            for f in dataclasses.fields(window)
        ]

    assert [plain(w) for w in got] == [plain(w) for w in expected]
    assert len(got) > 3
