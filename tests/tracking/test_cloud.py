from __future__ import annotations

import numpy as np
import pytest
import shapely

from groundstation.localization import SearchArea
from groundstation.localization.mesh import moments
from groundstation.tracking.cloud import Cloud

AREA = SearchArea(np.zeros(2), 100.0, 1.0, 20.0)


def points(count: int = 500) -> np.ndarray:
    rng = np.random.default_rng(3)
    return np.column_stack(
        [rng.normal(20.0, 6.0, count), rng.normal(-30.0, 9.0, count), rng.uniform(1.0, 20.0, count)]
    )


def test_boxes_hold_the_cloud() -> None:
    cloud = Cloud.of(points(), AREA, 0.3)
    mesh, mass = cloud.boxes()
    assert mass.sum() == pytest.approx(1.0)
    mean, covariance = moments(mesh, mass)
    np.testing.assert_allclose(mean, points().mean(axis=0), atol=0.7)
    # Smoothed, never narrower: Silverman's kernel adds an eighth of the narrower variance or so.
    for axis in (0, 1):
        assert 1.0 < covariance[axis, axis] / points()[:, axis].var() < 1.35


def test_nothing_lies_outside_the_area() -> None:
    square = SearchArea.of_polygon(shapely.box(15.0, -100.0, 60.0, 60.0), 1.0, 20.0)
    inside = points()[points()[:, 0] > 15.0]
    mesh, mass = Cloud.of(inside, square, 0.3).boxes()
    assert (mesh.center_enu_m[:, 0] > 15.0).all()
    assert mass.sum() == pytest.approx(1.0)


def test_density_is_that_of_the_boxes_whatever_the_size_asked_for() -> None:
    cloud = Cloud.of(points(), AREA, 0.3)
    for width in (2.0, 11.0, 40.0):
        steps = np.arange(-100.0 + width / 2, 100.0, width)
        east, north = np.meshgrid(steps, steps)
        center = np.column_stack([east.ravel(), north.ravel(), np.full(east.size, 10.0)])
        half = np.full((east.size, 2), width / 2)
        density = np.exp(cloud.log_density(center, half, 0.0 + 1e-12))
        assert density.sum() * width**2 == pytest.approx(1.0, abs=2e-3)
    far = cloud.log_density(np.array([[-90.0, 0.0, 5.0]]), np.ones((1, 2)), 1e-6)
    assert far == pytest.approx(np.log(1e-6))


def test_a_cloud_of_one_place_is_as_wide_as_the_smallest_box() -> None:
    mesh, mass = Cloud.of(np.tile([5.0, 5.0, 5.0], (50, 1)), AREA, 0.3).boxes()
    mean, covariance = moments(mesh, mass)
    np.testing.assert_allclose(mean[:2], 5.0, atol=0.4)
    assert covariance[0, 0] < 2.0


def test_state_and_back() -> None:
    cloud = Cloud.of(points(), AREA, 0.3)
    again = Cloud.restore(cloud.state())
    for one, other in zip(cloud.boxes(), again.boxes(), strict=True):
        np.testing.assert_array_equal(
            one.center_enu_m if hasattr(one, "center_enu_m") else one,
            other.center_enu_m if hasattr(other, "center_enu_m") else other,
        )
