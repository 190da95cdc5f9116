"""The lone surveyor's flights: the same again, near their area, with a receiver that loses lock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_sitl.surveyor import draw, fly


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
