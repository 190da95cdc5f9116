"""The peers find beacons too: a tracker that is ahead of a broken rival is ahead of nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_sitl.studies.tracking.cases import LOS, MIXED, NLOS, told_of
from sim_sitl.studies.tracking.least_squares import _Problem, fit
from sim_sitl.studies.tracking.particles import track_particles
from sim_sitl.studies.tracking.paths import Path, Shape
from sim_sitl.studies.tracking.world import World, draw_run

QUIET = {"shadowing_db": 0.5, "angle_white_rad": 0.003, "angle_constant_rad": 0.002}
ORBIT = Path(Shape.ORBIT)


@pytest.mark.parametrize("world", [NLOS, MIXED, LOS], ids=["nlos", "mixed", "los"])
def test_slopes_of_least_squares_are_the_residuals_own(world: World) -> None:
    run = draw_run(world, ORBIT, np.arange(9.0), 1, 0)
    problem = _Problem(run, 8, told_of(world))
    at = problem._center + 0.1 * problem._spread
    found = problem.slopes(at)
    for column, spread in enumerate(problem._spread):
        step = np.zeros(at.size)
        step[column] = 1e-5 * spread
        wanted = (problem.residuals(at + step) - problem.residuals(at - step)) / (2e-5 * spread)
        np.testing.assert_allclose(found[:, column], wanted, atol=1e-5 * np.abs(found).max())


@pytest.mark.parametrize("world", [NLOS, MIXED], ids=["nlos", "mixed"])
def test_least_squares_finds_a_loud_beacon(world: World) -> None:
    quiet = replace(world, **QUIET)
    run = draw_run(quiet, ORBIT, np.arange(61.0), 1, 1)
    answers = fit(run, [0, 60], told_of(quiet))
    error = np.linalg.norm(answers.mean_enu_m - run.truth_enu_m[0], axis=-1)
    assert error[1] < 0.3 * error[0]
    assert answers.area_m2[1, 1] < 0.2 * answers.area_m2[0, 1]


def test_least_squares_knows_that_windows_of_one_place_resemble_each_other() -> None:
    run = draw_run(NLOS, ORBIT, np.arange(31.0), 1, 2)
    told = told_of(NLOS)
    independent = replace(told, settings=replace(told.settings, correlation_m=0.01))
    near, far = fit(run, [30], told), fit(run, [30], independent)
    assert near.area_m2[0, 1] > 1.3 * far.area_m2[0, 1]


def test_particles_find_a_beacon_and_are_the_same_twice() -> None:
    told, ticks = told_of(NLOS), [0, 40]
    errors = []
    for number in range(4):
        run = draw_run(NLOS, Path(Shape.CONTRACTING), np.arange(41.0), 1, number)
        first = track_particles(run, ticks, told, number, 1500)
        errors.append(np.linalg.norm(first.mean_enu_m - run.truth_enu_m[0], axis=-1))
        assert first.area_m2[1, 1] < first.area_m2[0, 1]
    root = np.sqrt(np.mean(np.square(errors), axis=0))
    assert root[1] < 0.75 * root[0]
    again = track_particles(run, ticks, told, 3, 1500)
    np.testing.assert_array_equal(first.mean_enu_m, again.mean_enu_m)


def test_particles_leave_numpys_own_generator_alone() -> None:
    before = np.random.get_state()[1].copy()
    run = draw_run(NLOS, ORBIT, np.arange(6.0), 1, 0)
    track_particles(run, [5], told_of(NLOS), 1, 500)
    np.testing.assert_array_equal(before, np.random.get_state()[1])


def test_particles_use_the_bearings_of_a_line_of_sight() -> None:
    wide = replace(MIXED, angle_white_rad=0.05, angle_constant_rad=0.02)
    error = {}
    for world in (wide, NLOS):
        found = []
        for number in range(3):
            run = draw_run(world, ORBIT, np.arange(16.0), 2, number)
            answers = track_particles(run, [15], told_of(world), number, 3000)
            found.append(np.linalg.norm(answers.mean_enu_m[0] - run.truth_enu_m[0]))
        error[world.name] = np.sqrt(np.mean(np.square(found)))
    assert error["tracking mixed"] < 0.5 * error["tracking nlos"]
