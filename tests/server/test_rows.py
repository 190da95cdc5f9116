"""Domain to wire: what is not a number or not a place becomes null, big integers become strings."""

from __future__ import annotations

import math
from typing import Any

import pytest

from groundstation.domain.geometry import Geodetic
from groundstation.server import rows


@pytest.mark.parametrize("degrees", [0.0, 90.0, 180.0, 270.0, 359.0])
def test_heading_is_the_yaw_of_the_attitude(degrees: float) -> None:
    half = math.radians(degrees) / 2
    heading = rows.heading_deg((math.cos(half), 0.0, 0.0, math.sin(half)))
    assert heading == pytest.approx(degrees, abs=1e-9)


def test_speeds_come_from_the_velocity(make: Any) -> None:
    row = rows.vehicle_row(make.vehicle())
    assert (row.ground_speed_m_s, row.climb_rate_m_s) == (5.0, 1.0)


def test_nothing_that_json_cannot_carry_leaves(make: Any) -> None:
    row = rows.vehicle_row(
        make.vehicle(battery_percent=math.nan, height_above_home_m=math.inf, position=Geodetic(0.0, 0.0, 0.0))
    )
    assert (row.battery_percent, row.height_above_home_m, row.position) == (None, None, None)
    broken = rows.target_row(make.target(radius_90_m=math.nan, covariance_enu_m2=(math.nan,) * 6))
    assert (broken.radius_90_m, broken.covariance_enu_m2) == (None, None)


def test_integers_beyond_2_53_are_decimal_strings(make: Any) -> None:
    row = rows.target_row(make.target(beacon_id=2**64 - 1, time_ns=1_795_312_345_678_901_234))
    assert row.beacon_id == "18446744073709551615"
    assert row.time_ns == "1795312345678901234"
