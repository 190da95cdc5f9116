from __future__ import annotations

import numpy as np
import pytest
import shapely
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from groundstation.localization.bounded import bounded_minimum, within_heights
from groundstation.localization.problem import SearchArea

DISC = SearchArea(np.array([5.0, -3.0]), 30.0, 2.0, 14.0)
BENT = SearchArea.of_polygon(
    shapely.Polygon([(-30, -20), (30, -20), (30, 25), (10, -5), (-20, 30)]), 2.0, 14.0
)


def problems(size: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((size, 3, 3))
    normal = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(3)
    free = rng.normal(0.0, [40.0, 40.0, 12.0], (size, 3))
    return normal, np.einsum("nij,nj->ni", normal, free), free


def cost(normal: np.ndarray, vector: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...ij,...j->...", x, normal, x) - 2.0 * np.einsum("...i,...i->...", x, vector)


@pytest.mark.parametrize("area", [DISC, BENT], ids=["disc", "polygon"])
def test_answers_are_inside_and_free_ones_stay(area: SearchArea) -> None:
    normal, vector, free = problems(400, 1)
    before = free.copy()
    answer = bounded_minimum(normal, vector, free, area)
    assert np.array_equal(free, before)
    assert (answer[:, 2] >= 2.0).all()
    assert (answer[:, 2] <= 14.0).all()
    if area.polygon_en_m is None:
        assert np.hypot(answer[:, 0] - 5.0, answer[:, 1] + 3.0).max() <= 30.0 * (1 + 1e-9)
    else:
        assert shapely.distance(area.polygon_en_m, shapely.points(answer[:, :2])).max() < 1e-9
    inside = area.contains(free[:, 0], free[:, 1]) & (free[:, 2] >= 2.0) & (free[:, 2] <= 14.0)
    assert inside.sum() > 10
    assert np.array_equal(answer[inside], free[inside])


def test_disc_answers_cost_no_more_than_a_general_solvers() -> None:
    normal, vector, free = problems(30, 2)
    answer = bounded_minimum(normal, vector, free, DISC)
    within = {"type": "ineq", "fun": lambda x: 30.0**2 - (x[0] - 5.0) ** 2 - (x[1] + 3.0) ** 2}
    for row in range(30):
        best = minimize(
            lambda x, r=row: cost(normal[r], vector[r], x), [5.0, -3.0, 8.0], method="SLSQP",
            bounds=[(None, None), (None, None), (2.0, 14.0)], constraints=[within], options={"ftol": 1e-12},
        )  # fmt: skip
        ours = cost(normal[row], vector[row], answer[row])
        # One bound after the other is not always the joint optimum; it is within a percent of it.
        scale = best.fun - cost(normal[row], vector[row], free[row])
        assert ours <= best.fun + 0.01 * scale + 1e-6


def test_polygon_answers_are_the_nearest_in_the_problems_metric() -> None:
    normal, vector, free = problems(40, 3)
    answer = bounded_minimum(normal, vector, free, BENT)
    edge = shapely.line_interpolate_point(
        BENT.polygon_en_m.exterior, np.linspace(0, 1, 4001), normalized=True
    )
    points = shapely.get_coordinates(edge)
    for row in np.flatnonzero(~BENT.contains(free[:, 0], free[:, 1])):
        candidates = np.column_stack([points, np.full(len(points), answer[row, 2])])
        ours = cost(normal[row], vector[row], answer[row])
        assert ours <= cost(normal[row], vector[row], candidates).min() + 1e-6 * abs(ours)


@pytest.mark.parametrize("height", [-40.0, -3.0, 2.0, 6.0, 13.9, 20.0, 55.0])
def test_spread_within_heights_is_that_of_the_cut_normal(height: float) -> None:
    """Against numerical integration of the normal between the limits, about the clipped answer."""
    rng = np.random.default_rng(4)
    root = rng.standard_normal((3, 3))
    covariance = 20.0 * (root @ root.T + 0.2 * np.eye(3))
    free = np.array([1.0, 2.0, height])
    clipped = np.clip(height, 2.0, 14.0)
    slope = covariance[:, 2] / covariance[2, 2]
    answer = free + slope * (clipped - height)
    ours = within_heights(covariance[None], np.array([height]), np.array([clipped]), DISC)[0]
    z = np.linspace(2.0, 14.0, 20001)
    density = multivariate_normal(height, covariance[2, 2]).logpdf(z)
    weight = np.exp(density - density.max())
    weight /= weight.sum()
    center = free + slope * (z[:, None] - height) - answer
    conditional = covariance - np.outer(slope, slope) * covariance[2, 2]
    expected = conditional + np.einsum("n,ni,nj->ij", weight, center, center)
    assert np.allclose(ours, expected, rtol=2e-3, atol=1e-3 * np.trace(expected))
