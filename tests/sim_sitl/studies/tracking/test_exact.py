"""The exact filter against plain sums over everything, and that finer sums do not move it."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from groundstation.localization.problem import FloatArray
from sim_sitl.studies.tracking.cases import LOS, MIXED, NLOS
from sim_sitl.studies.tracking.exact import ExactFilter, Resolution
from sim_sitl.studies.tracking.paths import Path, Shape
from sim_sitl.studies.tracking.world import Run, World, draw_run

TICKS = np.array([0, 6])
NODES = 24
TWO = Path(Shape.ORBIT, vehicles=2)
PLACES = np.array([[0.0, 0.0, 10.0], [30.0, -20.0, 5.0], [-60.0, 40.0, 15.0]])


def plain(run: Run, world: World, place: FloatArray, last: int) -> float:
    """Log likelihood by summing over exponent, power and every bias, with the full covariance."""
    vehicles = len(world.line_of_sight)
    count = last + 1
    paths = run.position_enu_m[:count]
    middle = (np.arange(NODES) + 0.5) / NODES
    power = world.power_dbm[0] + (world.power_dbm[1] - world.power_dbm[0]) * middle
    exponent = world.nlos_exponent[0] + (world.nlos_exponent[1] - world.nlos_exponent[0]) * middle
    bias = world.bias_max_db * (np.arange(60) + 0.5) / 60
    total = np.zeros((NODES, NODES))
    for k in range(vehicles):
        gap = np.linalg.norm(paths[:, None, k] - paths[None, :, k], axis=-1)
        covariance = world.shadowing_db**2 * np.exp(-gap / world.correlation_m)
        loss = 10.0 * np.log10(np.linalg.norm(place - paths[:, k], axis=-1))
        normal = multivariate_normal(np.zeros(count), covariance)
        for (i, b), (j, p) in product(enumerate(exponent), enumerate(power)):
            if world.line_of_sight[k]:
                total[i, j] += normal.logpdf(run.rss_dbm[:count, k] - p + world.los_exponent * loss)
            else:
                residual = run.rss_dbm[:count, k] - p + b * loss + bias[:, None]
                total[i, j] += np.log(np.exp(np.atleast_1d(normal.logpdf(residual))).mean())
        if world.line_of_sight[k]:
            east, north, up = (place - paths[:, k]).T
            turn = run.azimuth_rad[:count, k] - np.arctan2(north, east)
            turn = np.remainder(turn + np.pi, 2.0 * np.pi) - np.pi
            lift = run.elevation_rad[:count, k] - np.arctan2(up, np.hypot(east, north))
            spread = world.angle_white_rad**2 * np.eye(count) + world.angle_constant_rad**2
            total += multivariate_normal(np.zeros(count), spread).logpdf(np.stack([turn, lift])).sum()
    top = total.max()
    return float(top + np.log(np.exp(total - top).mean()))


@pytest.mark.parametrize("world", [NLOS, MIXED], ids=["nlos", "mixed"])
def test_the_likelihood_is_that_of_plain_sums(world: World) -> None:
    small = replace(world, line_of_sight=world.line_of_sight[:2])
    if small.line_of_sight[0]:
        # Wide angles: else all but one place are out of the question.
        small = replace(small, angle_white_rad=0.2, angle_constant_rad=0.3)
    run = draw_run(small, TWO, np.arange(7.0), 2, 0)
    exact = ExactFilter(run, small, TICKS, Resolution(exponents=32, powers=12))
    found = exact.log_likelihood(PLACES, TICKS)
    for row, tick in enumerate(TICKS):
        wanted = np.array([plain(run, small, place, int(tick)) for place in PLACES])
        kept = wanted > wanted.max() - 15.0
        np.testing.assert_allclose(
            (found[row] - found[row, 0])[kept], (wanted - wanted[0])[kept], atol=0.02, rtol=0.0
        )


@pytest.mark.parametrize(
    ("world", "finer"), [(NLOS, Resolution(2.8, 5, 24, 10)), (MIXED, Resolution(places=8192))]
)
def test_finer_sums_do_not_move_the_answer(world: World, finer: Resolution) -> None:
    ticks = np.array([0, 40])
    run = draw_run(world, Path(Shape.ORBIT), np.arange(41.0), 1, 1)
    coarse, fine = (ExactFilter(run, world, ticks, r).answers() for r in (Resolution(), finer))
    spread = np.sqrt(fine.area_m2[:, 0])
    moved = np.linalg.norm(coarse.mean_enu_m - fine.mean_enu_m, axis=-1)
    assert (moved < 0.02 * spread).all()
    np.testing.assert_allclose(coarse.level, fine.level, atol=0.05)
    np.testing.assert_allclose(coarse.area_m2, fine.area_m2, rtol=0.1)


def test_one_pass_gives_what_each_time_alone_would() -> None:
    run = draw_run(NLOS, Path(Shape.CONTRACTING), np.arange(31.0), 1, 3)
    ticks = np.array([5, 30])
    both = ExactFilter(run, NLOS, ticks, Resolution(8.0)).answers()
    for row, tick in enumerate(ticks):
        alone = ExactFilter(run, NLOS, ticks[row : row + 1], Resolution(8.0)).answers()
        np.testing.assert_allclose(alone.mean_enu_m[0], both.mean_enu_m[row])
        assert int(tick) in ticks


def test_its_regions_are_honest_where_its_model_is_the_world() -> None:
    # Snapshots: cheap, and the shadowing is then exactly Gaussian.
    level = []
    for number in range(60):
        run = draw_run(NLOS, Path(Shape.ORBIT), np.zeros(1), 11, number)
        level.append(ExactFilter(run, NLOS, [0], Resolution(10.0, 2, 12, 6)).answers().level[0])
    share = (np.array(level)[:, None] <= [0.5, 0.9]).mean(axis=0)
    assert 0.3 < share[0] < 0.7
    assert share[1] > 0.8
    assert np.max(level) > 0.6


def test_in_line_of_sight_it_finds_what_the_angles_say() -> None:
    run = draw_run(replace(LOS, angle_constant_rad=0.0), Path(Shape.ORBIT), np.arange(21.0), 1, 0)
    answers = ExactFilter(run, replace(LOS, angle_constant_rad=0.0), [20], Resolution()).answers()
    assert np.linalg.norm(answers.mean_enu_m[0] - run.truth_enu_m[0]) < 1.5
    assert answers.area_m2[0, 1] < 8.0
