"""Domain to wire: what is not a number or not a place becomes null."""

from __future__ import annotations

import math
from typing import Any

import pytest

from groundstation.domain.geometry import Geodetic
from groundstation.domain.mission import LastKnownPlace, Mission
from groundstation.domain.vehicle import PlaceAccuracy
from groundstation.server import rows


@pytest.mark.parametrize("degrees", [0.0, 90.0, 180.0, 270.0, 359.0])
def test_heading_is_the_yaw_of_the_attitude(degrees: float) -> None:
    half = math.radians(degrees) / 2
    heading = rows.heading_deg((math.cos(half), 0.0, 0.0, math.sin(half)))
    assert heading == pytest.approx(degrees, abs=1e-9)


def test_speeds_come_from_the_velocity(make: Any) -> None:
    row = rows.vehicle_row(make.vehicle())
    assert (row.ground_speed_m_s, row.climb_rate_m_s) == (5.0, 1.0)


def test_a_clock_s_uncertainty_is_told_in_seconds_and_only_where_it_is_known(make: Any) -> None:
    assert rows.vehicle_row(make.vehicle(clock_uncertainty_ns=2_500_000)).clock_uncertainty_s == 0.0025
    assert rows.vehicle_row(make.vehicle(clock_uncertainty_ns=0)).clock_uncertainty_s == 0.0
    assert rows.vehicle_row(make.vehicle(clock_uncertainty_ns=None)).clock_uncertainty_s is None


def test_a_place_s_accuracy_is_told_only_where_the_vehicle_says_it(make: Any) -> None:
    assert rows.vehicle_row(make.vehicle()).position_accuracy_m is None
    said = make.vehicle(place_accuracy=PlaceAccuracy(6.2, 9.0, False))
    assert rows.vehicle_row(said).position_accuracy_m == 6.2


def test_nothing_that_json_cannot_carry_leaves(make: Any) -> None:
    row = rows.vehicle_row(
        make.vehicle(battery_percent=math.nan, height_above_home_m=math.inf, position=Geodetic(0.0, 0.0, 0.0))
    )
    assert (row.battery_percent, row.height_above_home_m, row.position) == (None, None, None)


def test_last_known_places_ride_with_the_mission() -> None:
    places = (LastKnownPlace(47.0, 8.5, 80.0, "hut", 2**64 - 1), LastKnownPlace(47.1, 8.6, 250.5))
    row = rows.mission_row(Mission(last_known=places))
    assert [place.model_dump() for place in row.last_known] == [
        {
            "latitude_deg": 47.0,
            "longitude_deg": 8.5,
            "radius_m": 80.0,
            "name": "hut",
            "beacon_id": "18446744073709551615",
        },
        {"latitude_deg": 47.1, "longitude_deg": 8.6, "radius_m": 250.5, "name": "", "beacon_id": None},
    ]
    assert rows.mission_row(Mission()).last_known == []
