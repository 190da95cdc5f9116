"""One yardstick for regions: levels and areas of beliefs whose regions are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import chdtr, chdtri

from groundstation.localization.containment import Raster
from sim_sitl.studies.tracking.answers import SHARES, level_and_areas, points_region
from sim_sitl.studies.tracking.trackers import level_of


def normal_picture(std_m: float, cell_m: float, cells: int) -> Raster:
    steps = (np.arange(cells) + 0.5 - cells / 2) * cell_m
    flat = np.exp(-0.5 * (steps[:, None] ** 2 + steps**2) / std_m**2)
    return Raster(-cells * cell_m / 2, -cells * cell_m / 2, cell_m, flat / flat.sum())


@pytest.mark.parametrize("distance_m", [0.0, 6.0, 12.0, 25.0])
def test_level_of_a_normal_belief(distance_m: float) -> None:
    level, areas = level_of(normal_picture(10.0, 0.8, 128), np.array([distance_m, 0.0, 3.0]))
    assert level == pytest.approx(chdtr(2, (distance_m / 10.0) ** 2), abs=0.03)
    wanted = [math.pi * 100.0 * chdtri(2, 1.0 - share) for share in SHARES]
    np.testing.assert_allclose(areas, wanted, rtol=0.03)


def test_east_and_north_are_not_mixed_up() -> None:
    mass = np.zeros((4, 4))
    mass[0, 3] = 0.9
    mass[3, 0] = 0.1
    picture = Raster(0.0, 0.0, 1.0, np.kron(mass, np.ones((20, 20))) / 400.0)
    in_the_south_east, _ = level_of(picture, np.array([70.0, 10.0, 0.0]))
    in_the_north_west, _ = level_of(picture, np.array([10.0, 70.0, 0.0]))
    assert in_the_south_east < 0.6
    assert in_the_north_west > 0.85


def test_a_truth_outside_is_at_level_one() -> None:
    picture = normal_picture(10.0, 1.0, 64)
    assert level_of(picture, np.array([500.0, 0.0, 0.0]))[0] == 1.0
    assert level_and_areas(np.ones((3, 3)), 1.0, 0, 3)[0] == 1.0


def test_points_stand_for_the_belief_that_they_are_drawn_from() -> None:
    rng = np.random.default_rng(2)
    factor = np.array([[30.0, 0.0], [18.0, 2.0]])
    points = rng.standard_normal((20_000, 2)) @ factor.T + [5.0, -3.0]
    weight = rng.uniform(0.5, 1.5, 20_000)
    for sigmas in (0.5, 1.5, 2.4):
        truth = np.array([5.0, -3.0]) + factor @ [0.6 * sigmas, 0.8 * sigmas]
        level, areas = points_region(points, weight, truth)
        assert level == pytest.approx(chdtr(2, sigmas**2), abs=0.04)
    wanted = [math.pi * 60.0 * chdtri(2, 1.0 - share) for share in SHARES]
    np.testing.assert_allclose(areas, wanted, rtol=0.08)
    assert points_region(points, weight, np.array([5.0, 400.0]))[0] == 1.0
