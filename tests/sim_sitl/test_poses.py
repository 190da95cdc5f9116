"""Poses between those that were heard."""

from __future__ import annotations

import math

import pytest

from groundstation.domain.geometry import Geodetic, LocalFrame
from sim_sitl.flight import quaternion_from_euler
from sim_sitl.poses import LEVEL, PoseTrack

FRAME = LocalFrame(Geodetic(47.0, 8.0, 400.0))


def track() -> PoseTrack:
    poses = PoseTrack()
    for i in range(5):
        poses.add_position(0.2 * i, FRAME.to_geodetic((10.0 * i, 0.0, 50.0)))
    return poses


def test_positions_are_linear_between_and_a_little_beyond() -> None:
    at = track().at(0.3, FRAME)
    assert at is not None
    assert at[0] == pytest.approx((15.0, 0.0, 50.0), abs=0.01)
    beyond = track().at(1.0, FRAME)
    assert beyond is not None
    assert beyond[0][0] == pytest.approx(50.0, abs=0.01)
    assert at[1] == LEVEL


def test_no_pose_before_the_first_after_the_last_or_in_a_gap() -> None:
    poses = track()
    assert poses.at(-0.1, FRAME) is None
    assert poses.at(3.0, FRAME) is None
    poses.add_position(9.0, FRAME.to_geodetic((0.0, 0.0, 50.0)))
    assert poses.at(4.0, FRAME) is None
    assert PoseTrack().at(0.0, FRAME) is None


def test_attitude_turns_the_shorter_way() -> None:
    poses = track()
    poses.add_attitude(0.0, quaternion_from_euler(0.0, 0.0, math.radians(170)))
    poses.add_attitude(0.2, tuple(-x for x in quaternion_from_euler(0.0, 0.0, math.radians(176))))  # type: ignore[arg-type]
    at = poses.at(0.1, FRAME)
    assert at is not None
    expected = quaternion_from_euler(0.0, 0.0, math.radians(173))
    assert abs(sum(a * b for a, b in zip(at[1], expected, strict=True))) == pytest.approx(1.0, abs=1e-6)


def test_forgetting_keeps_what_is_needed() -> None:
    poses = PoseTrack()
    for i in range(1000):
        poses.add_position(0.2 * i, FRAME.to_geodetic((float(i), 0.0, 50.0)))
        poses.forget_before(0.2 * i - 10.0)
    assert len(poses.position_s) < 130
    assert poses.at(199.5, FRAME) is not None
