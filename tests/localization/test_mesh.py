from __future__ import annotations

import numpy as np
import shapely

from groundstation.localization.mesh import MeshSettings, base_mesh, masses, moments, refine, split
from groundstation.localization.problem import SearchArea

DISC = SearchArea(np.zeros(2), 100.0, 0.0, 20.0)
SETTINGS = MeshSettings()


def test_volumes_add_up() -> None:
    square = SearchArea.of_polygon(shapely.box(-30, -50, 70, 20), 0.0, 20.0)
    for area, expected in ((DISC, np.pi * 1e4 * 20), (square, 7000.0 * 20)):
        mesh = base_mesh(area, SETTINGS)
        assert abs(np.exp(mesh.log_volume).sum() / expected - 1) < 0.03
        assert abs(np.exp(split(mesh, area).log_volume).sum() / expected - 1) < 0.01


def test_finds_a_narrow_gaussian() -> None:
    """σ = 1.5 m in a disc of 100 m: mean to 0.1 m, spread to 15 % (never under)."""
    truth, std = np.array([31.7, -44.1, 7.3]), 1.5

    def evaluate(mesh: object) -> np.ndarray:
        spread = std**2 + mesh.half_m[:, [0, 0, 1]] ** 2 / 3.0
        offset = mesh.center_enu_m - truth
        return -0.5 * (offset**2 / spread).sum(axis=1) - 0.5 * np.log(spread).sum(axis=1)

    fine = MeshSettings(split_mass=0.001)
    mesh, value, _ = refine(DISC, evaluate, fine)
    mean, covariance = moments(mesh, masses(value, mesh))
    assert np.abs(mean - truth).max() < 0.1
    ratio = np.sqrt(np.diag(covariance)) / std
    assert ratio.min() > 0.97
    assert ratio.max() < 1.15
    assert mesh.count <= fine.maximum_cells


def test_flat_belief_is_the_area() -> None:
    mesh, value, _ = refine(DISC, lambda m: np.zeros(m.count), SETTINGS)
    mean, covariance = moments(mesh, masses(value, mesh))
    assert np.abs(mean - [0, 0, 10]).max() < 0.5
    assert abs(covariance[0, 0] / 2500 - 1) < 0.03
    assert abs(covariance[2, 2] / (400 / 12) - 1) < 0.03


def test_number_of_boxes_is_bounded() -> None:
    small = MeshSettings(base_cells=10, maximum_cells=200, split_mass=1e-6)
    mesh, _, _ = refine(DISC, lambda m: np.zeros(m.count), small)
    assert mesh.count <= 200 + 7


def test_refine_says_where_each_box_was_evaluated() -> None:
    """What ``evaluate`` worked out for a box is found again by the box's place among all it was given."""
    centers: list[np.ndarray] = []

    def evaluate(mesh):  # type: ignore[no-untyped-def]
        centers.append(mesh.center_enu_m)
        return -np.square(mesh.center_enu_m[:, 0] - 20.0) / 50.0

    mesh, value, place = refine(DISC, evaluate, SETTINGS)
    assert len(centers) > 1
    assert (np.concatenate(centers)[place] == mesh.center_enu_m).all()
    assert (value == -np.square(mesh.center_enu_m[:, 0] - 20.0) / 50.0).all()
