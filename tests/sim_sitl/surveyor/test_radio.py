"""The lone surveyor's channel: what makes a search by power alone hard is really in it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sim_sitl.surveyor import Radio, draw

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
