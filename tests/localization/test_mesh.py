from __future__ import annotations

import numpy as np
import shapely

from groundstation.localization.mesh import (
    MeshSettings,
    base_mesh,
    masses,
    moments,
    refine,
    smooth_moments,
    split,
)
from groundstation.localization.problem import GroundHeights, SearchArea

DISC = SearchArea(np.zeros(2), 100.0, 0.0, 20.0)
SETTINGS = MeshSettings()


def test_volumes_add_up() -> None:
    square = SearchArea.of_polygon(shapely.box(-30, -50, 70, 20), 0.0, 20.0)
    for area, expected in ((DISC, np.pi * 1e4 * 20), (square, 7000.0 * 20)):
        mesh = base_mesh(area, SETTINGS)
        assert abs(np.exp(mesh.log_volume).sum() / expected - 1) < 0.03
        assert abs(np.exp(split(mesh, area)[0].log_volume).sum() / expected - 1) < 0.01


def test_finds_a_narrow_gaussian() -> None:
    """σ = 1.5 m in a disc of 100 m: mean to 0.1 m, spread to 15 % (never under)."""
    truth, std = np.array([31.7, -44.1, 7.3]), 1.5

    def evaluate(mesh: object, _: object) -> tuple[np.ndarray, float]:
        spread = std**2 + mesh.half_m[:, [0, 0, 1]] ** 2 / 3.0
        offset = mesh.center_enu_m - truth
        return (-0.5 * (offset**2 / spread).sum(axis=1) - 0.5 * np.log(spread).sum(axis=1)), 1.0

    fine = MeshSettings(split_mass=0.001)
    found = refine(DISC, evaluate, fine)
    mesh = found.mesh
    mean, covariance = moments(mesh, masses(found.log_likelihood, mesh))
    assert np.abs(mean - truth).max() < 0.1
    ratio = np.sqrt(np.diag(covariance)) / std
    assert ratio.min() > 0.97
    assert ratio.max() < 1.15
    assert mesh.count <= fine.maximum_cells


def test_flat_belief_is_the_area() -> None:
    found = refine(DISC, lambda m, _: (np.zeros(m.count), 1.0), SETTINGS)
    mesh = found.mesh
    mean, covariance = moments(mesh, masses(found.log_likelihood, mesh))
    assert np.abs(mean - [0, 0, 10]).max() < 0.5
    assert abs(covariance[0, 0] / 2500 - 1) < 0.03
    assert abs(covariance[2, 2] / (400 / 12) - 1) < 0.03


def test_number_of_boxes_is_bounded() -> None:
    small = MeshSettings(base_cells=10, maximum_cells=200, split_mass=1e-6)
    found = refine(DISC, lambda m, _: (np.zeros(m.count), 1.0), small)
    assert found.mesh.count <= 200 + 7


def test_refine_says_where_each_box_was_evaluated() -> None:
    """What ``evaluate`` worked out for a box is found again by the box's place among all it was given."""
    centers: list[np.ndarray] = []

    def evaluate(mesh, _):  # type: ignore[no-untyped-def]
        centers.append(mesh.center_enu_m)
        return (-np.square(mesh.center_enu_m[:, 0] - 20.0) / 50.0), 1.0

    found = refine(DISC, evaluate, SETTINGS)
    assert len(centers) > 1
    assert (np.concatenate(centers)[found.place] == found.mesh.center_enu_m).all()
    assert (found.log_likelihood == -np.square(found.mesh.center_enu_m[:, 0] - 20.0) / 50.0).all()


def test_a_corridor_of_two_metres_keeps_its_volume() -> None:
    """Narrower than the samples that measure a box's share: cut exactly."""
    corridor = SearchArea.of_polygon(shapely.box(-200, -1, 200, 1), 0.0, 20.0)
    mesh = base_mesh(corridor, SETTINGS)
    assert abs(np.exp(mesh.log_volume).sum() / (800.0 * 20.0) - 1.0) < 1e-9
    assert abs(np.exp(split(mesh, corridor, 3)[0].log_volume).sum() / (800.0 * 20.0) - 1.0) < 1e-9


def test_parts_name_the_box_they_come_from() -> None:
    mesh = base_mesh(DISC, SETTINGS)
    for pieces in (2, 3, 4):
        finer, parent = split(mesh, DISC, pieces)
        gap = np.abs(finer.center_enu_m - mesh.center_enu_m[parent])
        assert (gap <= mesh.half_m[parent][:, [0, 0, 1]]).all()
        assert np.allclose(finer.half_m[:, 0] * pieces, mesh.half_m[parent, 0])


def peak(truth: np.ndarray, std: float):  # type: ignore[no-untyped-def]
    def evaluate(mesh: object, _: object) -> tuple[np.ndarray, float]:
        return -0.5 * np.square(mesh.center_enu_m - truth).sum(axis=1) / std**2, 1.0

    return evaluate


def test_problems_side_by_side_are_refined_as_alone() -> None:
    truths = np.array([[20.0, 5.0, 9.0], [-60.0, 10.0, 3.0], [0.0, 0.0, 15.0]])
    settings = MeshSettings(base_cells=12, split_mass=0.02, pieces=3, maximum_cells=900)

    def evaluate(mesh: object, problem: np.ndarray) -> tuple[np.ndarray, float]:
        return -0.5 * np.square(mesh.center_enu_m - truths[problem]).sum(axis=1) / 9.0, 1.0

    together = refine(DISC, evaluate, settings, 3)
    mass = masses(together.log_likelihood, together.mesh, together.problem)
    for number, truth in enumerate(truths):
        alone = refine(DISC, peak(truth, 3.0), settings)
        mine = together.problem == number
        assert mine.sum() == alone.mesh.count
        mean, _ = moments(together.mesh.keep(mine), mass[mine])
        assert np.allclose(mean, moments(alone.mesh, masses(alone.log_likelihood, alone.mesh))[0])


def test_a_peak_far_narrower_than_a_box_is_found_wherever_it_lies() -> None:
    """σ = 0.3 m in boxes of 16.7 m weighed at their centres only: also across a box's edge or corner."""
    settings = MeshSettings(base_cells=12, split_mass=0.02, minimum_half_m=0.02, pieces=3, maximum_rounds=7)
    rng = np.random.default_rng(2)
    for _ in range(20):
        truth = rng.uniform([-60, -60, 3], [60, 60, 17])
        found = refine(DISC, peak(truth, 0.3), settings)
        mean, covariance = smooth_moments(found.mesh, masses(found.log_likelihood, found.mesh), DISC)
        assert np.abs(mean - truth).max() < 0.05
        assert np.abs(np.sqrt(np.diag(covariance)) / 0.3 - 1.0).max() < 0.1


def test_what_counts_more_is_split_sooner() -> None:
    def evaluate(mesh: object, _: object) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(mesh.count), np.where(mesh.center_enu_m[:, 0] > 0.0, 10.0, 1.0)

    found = refine(DISC, evaluate, MeshSettings(base_cells=10, split_mass=0.03, maximum_rounds=1))
    east = found.mesh.center_enu_m[:, 0] > 0.0
    assert east.sum() > 3 * (~east).sum()


def test_smooth_moments_are_those_of_a_gaussian_and_of_a_slab() -> None:
    settings = MeshSettings(split_mass=0.03, pieces=3)
    found = refine(DISC, peak(np.array([10.0, -20.0, 10.0]), 2.0), settings)
    _, covariance = smooth_moments(found.mesh, masses(found.log_likelihood, found.mesh), DISC)
    assert np.allclose(covariance, 4.0 * np.eye(3), atol=0.12)
    flat = base_mesh(DISC, SETTINGS)
    _, covariance = smooth_moments(flat, masses(np.zeros(flat.count), flat), DISC)
    assert abs(covariance[2, 2] / (400.0 / 12.0) - 1.0) < 0.01


def hill(east: np.ndarray, north: np.ndarray) -> np.ndarray:
    return 0.4 * east - 0.2 * north + 30.0


def over_the_hill() -> SearchArea:
    along = np.linspace(-120.0, 120.0, 25)
    east, north = np.meshgrid(along, along)
    ground = GroundHeights(-120.0, -120.0, 10.0, hill(east, north), np.ones(east.shape, dtype=bool))
    return DISC.over(ground, 1.0, 15.0)


def test_boxes_follow_the_ground_through_every_split() -> None:
    area = over_the_hill()
    mesh = base_mesh(area, SETTINGS)
    for _ in range(3):
        ground = hill(mesh.center_enu_m[:, 0], mesh.center_enu_m[:, 1])
        low = mesh.center_enu_m[:, 2] - mesh.half_m[:, 1] - ground
        high = mesh.center_enu_m[:, 2] + mesh.half_m[:, 1] - ground
        assert low.min() > 1.0 - 1e-9
        assert high.max() < 15.0 + 1e-9
        assert abs(np.exp(mesh.log_volume).sum() / (np.pi * 1e4 * 14.0) - 1.0) < 0.03
        mesh, _ = split(mesh, area)


def test_over_level_ground_nothing_is_different() -> None:
    ground = GroundHeights(-150.0, -150.0, 300.0, np.full((2, 2), 7.0), np.ones((2, 2), dtype=bool))
    level, plain = DISC.over(ground, 0.0, 20.0), SearchArea(np.zeros(2), 100.0, 7.0, 27.0)
    for one, other in ((base_mesh(level, SETTINGS), base_mesh(plain, SETTINGS)),):
        for _ in range(2):
            assert np.allclose(one.center_enu_m, other.center_enu_m, atol=1e-9)
            assert np.array_equal(one.log_volume, other.log_volume)
            one, other = split(one, level)[0], split(other, plain)[0]
    mass = np.full(one.count, 1.0 / one.count)
    for a, b in zip(smooth_moments(one, mass, level), smooth_moments(other, mass, plain), strict=True):
        assert np.allclose(a, b, atol=1e-6)
