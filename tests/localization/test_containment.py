from __future__ import annotations

import numpy as np
import pytest
import shapely

from groundstation.localization.containment import Raster, containment, raster, region_rings, smooth_raster
from groundstation.localization.mesh import Mesh, MeshSettings, masses, refine
from groundstation.localization.problem import SearchArea

AREA = SearchArea(np.zeros(2), 100.0, 0.0, 20.0)


def gaussian(std: float, *centers: tuple[float, float]):
    def evaluate(mesh: object, _: object) -> tuple[np.ndarray, float]:
        spread = std**2 + mesh.half_m[:, 0] ** 2 / 3
        parts = [
            -0.5 * np.square(mesh.center_enu_m[:, :2] - np.array(center)).sum(axis=1) / spread
            for center in centers
        ]
        return (np.logaddexp.reduce(parts, axis=0) - np.log(spread)), 1.0

    found = refine(AREA, evaluate, MeshSettings(split_mass=0.002, maximum_cells=4000))
    return found.mesh, masses(found.log_likelihood, found.mesh)


@pytest.mark.parametrize("std", [2.0, 12.0])
def test_radius_of_a_gaussian(std: float) -> None:
    """R₉₀ = σ √(−2 ln 0.1) = 2.146 σ, to 8 %, and not below."""
    said = containment(*gaussian(std, (10.0, -20.0)))
    assert 0.99 < said.radius_90_m / (2.146 * std) < 1.08
    assert np.allclose(said.position_enu_m, [10, -20, 10], atol=0.3)


@pytest.mark.parametrize(("std", "off"), [(2.0, 0.02), (2.0, 1.5), (2.0, 6.0), (0.1, 2.0)])
def test_what_moves_all_vehicles_places_widens_the_answer(std: float, off: float) -> None:
    """A Gaussian moved by a Gaussian: variances add, in radius, covariance and regions."""
    mesh, mass = gaussian(std, (10.0, -20.0))
    whole = np.hypot(std, off)
    plain, said = containment(mesh, mass), containment(mesh, mass, shift=(off**2, 9.0))
    assert 0.99 < said.radius_90_m / (2.146 * whole) < 1.08
    np.testing.assert_allclose(
        said.covariance_m2 - plain.covariance_m2, np.diag([off**2, off**2, 9.0]), atol=1e-9
    )
    np.testing.assert_array_equal(said.position_enu_m, plain.position_enu_m)
    truth = np.array([10.0, -20.0]) + whole * np.random.default_rng(4).standard_normal((20000, 2))
    for share, rings in region_rings(mesh, mass, picture=smooth_raster(mesh, mass, shift=(off**2, 0.0))):
        held = shapely.contains_xy(even_odd_area(rings)[1], truth[:, 0], truth[:, 1]).mean()
        assert abs(held - share) < 0.05


def test_a_ring_moved_by_a_little_is_not_taken_for_a_gaussian() -> None:
    """Places on a circle of 10 m, moved by 5 m: the radius that 200,000 draws give, to 2 %."""
    turn = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    center = np.column_stack([10.0 * np.cos(turn), 10.0 * np.sin(turn), np.zeros(400)])
    mesh = Mesh(center, np.full((400, 2), 0.05), np.zeros(400))
    said = containment(mesh, np.full(400, 1.0 / 400), shift=(25.0, 0.0))
    rng = np.random.default_rng(1)
    drawn = center[rng.integers(0, 400, 200_000), :2] + 5.0 * rng.standard_normal((200_000, 2))
    assert said.radius_90_m == pytest.approx(np.quantile(np.hypot(*drawn.T), 0.9), rel=0.02)


def even_odd_area(rings: tuple) -> tuple[float, object]:
    shape = shapely.Polygon()
    for ring in rings:
        shape = shape.symmetric_difference(shapely.Polygon(ring))
    return shape.area, shape


def test_regions_are_nested_and_hold_their_share() -> None:
    std = 10.0
    mesh, mass = gaussian(std, (0.0, 30.0))
    rng = np.random.default_rng(0)
    points = np.array([0.0, 30.0]) + std * rng.standard_normal((20000, 2))
    shapes = []
    for share, rings in region_rings(mesh, mass):
        area, shape = even_odd_area(rings)
        held = shapely.contains_xy(shape, points[:, 0], points[:, 1]).mean()
        assert abs(held - share) < 0.05
        assert area == pytest.approx(-2 * np.log(1 - share) * np.pi * std**2, rel=0.2)
        assert all(ring[0] == ring[-1] for ring in rings)
        shapes.append(shape)
    assert shapes[1].buffer(2.0).contains(shapes[0])
    assert shapes[2].buffer(2.0).contains(shapes[1])


def test_two_modes_are_two_rings() -> None:
    rings = dict(region_rings(*gaussian(6.0, (-50.0, 0.0), (50.0, 0.0))))[0.5]
    assert len(rings) == 2


def test_raster_keeps_the_mass() -> None:
    mesh, mass = gaussian(10.0, (0.0, 0.0))
    picture = raster(mesh, mass)
    assert 0.998 < picture.mass.sum() <= 1.0 + 1e-12
    columns = picture.west_m + (np.arange(picture.mass.shape[1]) + 0.5) * picture.cell_m
    assert abs(picture.mass.sum(axis=0) @ columns) < 0.5


@pytest.mark.parametrize("shift", [0.0, 0.3, 0.5])
def test_a_belief_hardly_wider_than_its_boxes_does_not_end_where_they_do(shift: float) -> None:
    """Boxes of 1.6 σ: truths drawn from the belief lie in its 90 % region about nine times in ten."""
    steps = 1.6 * (np.arange(-6, 7) + shift)
    east, north = (axis.ravel() for axis in np.meshgrid(steps, steps, indexing="ij"))
    center = np.column_stack([east, north, np.full(east.size, 1.0)])
    mesh = Mesh(center, np.full((east.size, 2), 0.8), np.zeros(east.size))
    mass = np.exp(-0.5 * (east**2 + north**2))
    mass /= mass.sum()
    truth = np.random.default_rng(3).standard_normal((4000, 2))

    def held(picture: Raster) -> float:
        order = np.argsort(-picture.mass.ravel(), kind="stable")
        inside = np.zeros(picture.mass.size, dtype=bool)
        inside[order[np.cumsum(picture.mass.ravel()[order]) <= 0.9 * picture.mass.sum()]] = True
        column = np.floor((truth[:, 0] - picture.west_m) / picture.cell_m).astype(int)
        row = np.floor((truth[:, 1] - picture.south_m) / picture.cell_m).astype(int)
        # Nothing outside the picture is in a region.
        padded = np.pad(inside.reshape(picture.mass.shape), 1)
        size = picture.mass.shape[0] + 1
        return float(padded[np.clip(row + 1, 0, size), np.clip(column + 1, 0, size)].mean())

    # Smoothing spreads a belief as narrow as this a little too far, and never too little.
    assert 0.89 < held(smooth_raster(mesh, mass)) < 0.97
    assert held(smooth_raster(mesh, mass)) > held(raster(mesh, mass)) + 0.01
