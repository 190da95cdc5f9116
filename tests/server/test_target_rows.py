"""Beacons to wire: what is not a number becomes null, big integers become strings."""

from __future__ import annotations

import math
from typing import Any

from groundstation.domain.target import Contribution, TargetExplanation, TargetJoined
from groundstation.server import target_rows


def test_nothing_that_json_cannot_carry_leaves(make: Any) -> None:
    broken = target_rows.target_row(make.target(radius_90_m=math.nan, covariance_enu_m2=(math.nan,) * 6))
    assert (broken.radius_90_m, broken.covariance_enu_m2) == (None, None)


def test_integers_beyond_2_53_are_decimal_strings(make: Any) -> None:
    row = target_rows.target_row(make.target(beacon_id=2**64 - 1, time_ns=1_795_312_345_678_901_234))
    assert row.beacon_id == "18446744073709551615"
    assert row.time_ns == "1795312345678901234"


def test_each_number_of_an_explanation_keeps_its_name() -> None:
    own = Contribution(
        vehicle_id=1,
        weight=0.4,
        area_factor=2.5,
        windows=30,
        redundant=2,
        outliers=1,
        power_residual_db=6.1,
        power_score=1.2,
        azimuth_residual_deg=-8.5,
        azimuth_score=-2.25,
        elevation_residual_deg=3.5,
        elevation_score=0.75,
        los_probability=0.9,
    )
    row = target_rows.explanation_row(TargetExplanation(2**64 - 1, 2_000, 3, (own,)))
    assert (row.beacon_id, row.time_ns, row.sequence) == ("18446744073709551615", "2000", 3)
    assert [link.model_dump() for link in row.contributions] == [
        {field: getattr(own, field) for field in Contribution.__dataclass_fields__}
    ]


def test_each_number_of_a_past_belief_keeps_its_name(make: Any) -> None:
    (point,) = target_rows.history([make.target(time_ns=77, radius_90_m=8.5, windows=30, links=4)])
    assert point.model_dump() == {
        "time_ns": "77",
        "latitude_deg": make.place.latitude_deg,
        "longitude_deg": make.place.longitude_deg,
        "altitude_amsl_m": make.place.altitude_amsl_m,
        "radius_90_m": 8.5,
        "windows": 30,
        "links": 4,
    }
    (endless,) = target_rows.history([make.target(radius_90_m=math.inf)])
    assert endless.radius_90_m is None


def test_an_id_that_is_another_one_s_says_whose_and_when_it_was_heard(make: Any) -> None:
    row = target_rows.target_row(TargetJoined(9, 500, 100, 400, 2**64 - 1))
    assert (row.beacon_id, row.state, row.joined_into) == ("9", "joined", "18446744073709551615")
    assert (row.time_ns, row.first_heard_ns, row.last_heard_ns) == ("500", "100", "400")
    assert (row.position, row.radius_90_m, row.joined_beacon_ids) == (None, None, [])
    into = target_rows.target_row(make.target(2**64 - 1, joined_beacon_ids=(9, 12)))
    assert (into.state, into.joined_into, into.joined_beacon_ids) == ("located", None, ["9", "12"])
