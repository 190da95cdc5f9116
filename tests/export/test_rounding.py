"""Rounding, times and order."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from groundstation.domain.geometry import Geodetic
from groundstation.domain.target import TargetState
from groundstation.export.rounding import degrees, describe, iso_time, newest, number


def test_numbers() -> None:
    assert degrees(1.23456789012) == 1.2345679
    assert math.copysign(1.0, degrees(-1e-12)) == 1.0
    assert number(2.345678) == 2.35
    assert math.copysign(1.0, number(-0.001) or 1.0) == 1.0
    assert [number(value) for value in (None, math.nan, math.inf)] == [None, None, None]


@pytest.mark.parametrize(
    ("time_ns", "text"),
    [
        (1_795_311_900_250_000_000, "2026-11-22T01:45:00.250Z"),
        (0, "1970-01-01T00:00:00.000Z"),
        (1_999_999, "1970-01-01T00:00:00.001Z"),
        (10**30, ""),
    ],
)
def test_times(time_ns: int, text: str) -> None:
    assert iso_time(time_ns) == text


def test_the_newest_of_each_beacon_by_id(belief: Callable[..., TargetState]) -> None:
    old, new = belief(beacon_id=5, time_ns=1, sequence=1), belief(beacon_id=5, time_ns=2, sequence=2)
    other, nowhere = belief(beacon_id=3), belief(beacon_id=1, position=Geodetic(math.nan, 0.0, 0.0))
    assert newest([new, old, other, nowhere]) == [other, new]


def test_one_line_for_people(belief: Callable[..., TargetState]) -> None:
    line = describe(belief(beacon_id=7))
    assert line == "Beacon 7: within 8.5 m (90 %), MIXED, 2 of 4 links in line of sight, height from home"
    assert "uncertain" in describe(belief(radius_90_m=math.inf))
