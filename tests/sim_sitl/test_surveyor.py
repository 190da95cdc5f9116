"""The lone surveyor's world: what makes a search by power alone hard is really in it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.mavlink.decode import decode
from groundstation.mavlink.framing import frame_of
from groundstation.mavlink.messages import GlobalPosition, RssSample
from groundstation.mavlink.tlog import read_tlog
from sim_sitl.surveyor import BEACON_ID, Radio, draw, fly, write_area, write_tlog

CALM = replace(
    draw(1),
    target_enu_m=(0.0, 0.0, 1.5),
    shadowing_std_db=0.0,
    airframe_std_db=0.0,
    transmitter_tilt_rad=0.0,
    clutter_db_per_m=0.0,
    roughness_m=1.0,
    height_m=40.0,
)
"""Two upright dipoles over ground so rough that nothing is reflected."""


def level_db(survey, horizontal_m: float, roll_rad: float = 0.0) -> float:
    place, attitude = np.array([[horizontal_m, 0.0, 40.0]]), np.array([[roll_rad, 0.0, 0.0]])
    return float(Radio(survey).mean_power_db(place, attitude)[0])


def test_the_strongest_places_are_a_ring() -> None:
    levels = [level_db(CALM, metres) for metres in (0.0, 10.0, 45.0, 150.0)]
    assert levels[0] < levels[1] < levels[2] > levels[3]
    assert levels[2] - levels[0] > 15.0


def test_far_away_power_falls_as_in_free_space() -> None:
    assert level_db(CALM, 1000.0) - level_db(CALM, 2000.0) == pytest.approx(6.02, abs=0.1)


def test_leaning_moves_the_null() -> None:
    assert abs(level_db(CALM, 3.0, math.radians(20.0)) - level_db(CALM, 3.0)) > 3.0


def test_smooth_ground_makes_lobes() -> None:
    smooth = replace(CALM, roughness_m=0.0)
    ripple = [level_db(smooth, x) - level_db(CALM, x) for x in np.arange(200.0, 400.0, 2.0)]
    assert max(ripple) - min(ripple) > 3.0


def test_shadowing_has_its_size_and_forgets_itself() -> None:
    rng = np.random.default_rng(5)
    values, near, far = [], [], []
    for seed in range(60):
        survey = replace(CALM, seed=seed, shadowing_std_db=5.0, shadowing_m=20.0)
        places = np.array([[300.0, 0.0, 40.0], [302.0, 0.0, 40.0], [300.0, 120.0, 40.0]])
        shift = np.array([*rng.uniform(0.0, 500.0, 2), 0.0])
        calm = replace(survey, shadowing_std_db=0.0)
        field = Radio(survey).mean_power_db(places + shift, np.zeros((3, 3))) - Radio(calm).mean_power_db(
            places + shift, np.zeros((3, 3))
        )
        values.append(field[0])
        near.append(field[0] * field[1])
        far.append(field[0] * field[2])
    assert 3.5 < float(np.std(values)) < 6.5
    assert float(np.mean(near)) > 15.0
    assert abs(float(np.mean(far))) < 8.0


@pytest.mark.parametrize("plan", ["stops", "lanes"])
def test_a_flight_is_the_same_again_and_stays_near_its_area(plan: str) -> None:
    survey = replace(draw(3, plan), duration_s=240.0)
    first, again = fly(survey), fly(survey)
    assert np.array_equal(first.power_db, again.power_db)
    assert np.array_equal(first.position_enu_m, again.position_enu_m)
    assert np.abs(first.position_enu_m[:, :2]).max() < 1.1 * survey.half_width_m
    assert first.pose_s[-1] == pytest.approx(240.0, abs=2.0)


def test_decibels_may_have_any_zero() -> None:
    survey = replace(draw(4), duration_s=60.0)
    plain, moved = fly(replace(survey, unit_offset_db=0.0)), fly(replace(survey, unit_offset_db=45.0))
    assert np.allclose(moved.power_db - plain.power_db, 45.0)


def test_lost_lock_is_a_floor_or_nothing() -> None:
    deaf = replace(draw(5), margin_db=-60.0, duration_s=60.0, unit_offset_db=0.0)
    noisy, silent = fly(replace(deaf, unlocked="noise")), fly(replace(deaf, unlocked="nothing"))
    assert silent.power_db.size == 0
    assert noisy.power_db.size > 30
    assert -25.0 < float(np.median(noisy.power_db)) < -5.0


def test_the_recording_says_what_was_flown_and_heard(tmp_path: Path) -> None:
    survey = replace(draw(6), duration_s=40.0)
    flight = fly(survey)
    write_tlog(flight, tmp_path / "a.tlog")
    write_area(survey, tmp_path / "a.geojson")
    messages = [decode(frame_of(raw)) for _, raw in read_tlog(tmp_path / "a.tlog")]
    heard = [m for m in messages if isinstance(m, RssSample)]
    assert len(heard) == flight.power_db.size
    assert {m.beacon_id for m in heard} == {BEACON_ID}
    assert heard[3].rss_dbm == pytest.approx(float(flight.power_db[3]), abs=0.006)
    places = [m for m in messages if isinstance(m, GlobalPosition)]
    assert len(places) == flight.pose_s.size
    assert places[0].height_above_home_m == pytest.approx(survey.height_m, abs=1.0)
    area = json.loads((tmp_path / "a.geojson").read_text())
    assert len(area["geometry"]["coordinates"][0]) == 5
