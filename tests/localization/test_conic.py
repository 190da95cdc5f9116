from __future__ import annotations

import numpy as np
import shapely

from groundstation.localization.conic import Region, majoriser, solve_literal
from groundstation.localization.problem import SearchArea


def test_region_rows_hold_exactly_inside() -> None:
    for ring in ([(0, 0), (40, 0), (40, 30), (0, 30)], [(0, 0), (0, 30), (40, 30), (40, 0)]):
        area = SearchArea.of_polygon(shapely.Polygon(ring), 0.0, 20.0)
        region = Region.of(area)
        inside = region.scaled(np.array([10.0, 10, 5]))
        outside = region.scaled(np.array([50.0, 10, 5]))
        slack = region.faces[:, 2] - region.faces[:, :2] @ inside[:2]
        assert (slack > 0).all()
        assert (region.faces[:, 2] < region.faces[:, :2] @ outside[:2]).any()


def test_scaling_is_undone() -> None:
    region = Region.of(SearchArea(np.array([100.0, -50]), 70.0, 2.0, 18.0))
    place = np.array([[110.0, -45, 7], [60.0, -80, 3]])
    assert np.allclose(region.metres(region.scaled(place)), place)


def test_step_minimises_the_majoriser() -> None:
    """Against a dense random search over the disc."""
    rng = np.random.default_rng(3)
    area = SearchArea(np.zeros(2), 100.0, 0.0, 20.0)
    vehicles = np.column_stack([rng.uniform(-90, 90, (5, 2)), np.full(5, 50.0)])
    gain, weight = 1.0 / rng.uniform(40, 140, 5), rng.uniform(1.5, 3.0, 5)
    start = np.array([20.0, -10.0, 10.0])
    found, status = majoriser(vehicles, gain, weight, area)(start)
    assert status == "Solved"

    def bound(x: np.ndarray) -> np.ndarray:
        offset = start - vehicles
        distance = np.linalg.norm(offset, axis=1)
        linear = distance + (x - start) @ (offset / distance[:, None]).T
        linear = np.where(linear > 1e-9, linear, 1e-9)
        square = np.square(np.linalg.norm(x[:, None] - vehicles, axis=2))
        return (weight * (1 / (gain * linear) ** 2 + gain**2 * square)).sum(axis=1)

    reach, turn = 100 * np.sqrt(rng.random(60000)), 2 * np.pi * rng.random(60000)
    around = np.column_stack([reach * np.cos(turn), reach * np.sin(turn), rng.uniform(0, 20, 60000)])
    assert bound(found[None])[0] <= bound(around).min() * (1 + 1e-6)
    # The second call reuses the assembled program and must not depend on the first.
    step = majoriser(vehicles, gain, weight, area)
    step(np.array([-50.0, 40.0, 3.0]))
    assert np.allclose(step(start)[0], found, atol=1e-4)


def test_literal_without_bias_is_the_plain_centroid() -> None:
    vehicles = np.array([[30.0, 0, 10], [-30.0, 0, 10], [0, 60.0, 10]])
    area = SearchArea(np.zeros(2), 100.0, 0.0, 20.0)
    found, _ = solve_literal(vehicles, np.full(3, 0.01), [(1.0,)] * 3, area)
    assert np.allclose(found, [0, 20, 10], atol=1e-3)
