from __future__ import annotations

import numpy as np
import pytest
import shapely

from groundstation.localization import SearchArea, SignalModel, crlb, locate_batch
from groundstation.localization.wls import strongest_first, wls_taylor


def rmse(estimates: list, truth: np.ndarray) -> float:
    error = np.array([e.position_enu_m for e in estimates]) - truth
    return float(np.sqrt(np.square(error).sum(axis=1).mean()))


@pytest.mark.parametrize(("method", "limit"), [("wls-taylor", 1.03), ("wls-taylor-bounded", 1.02)])
def test_reaches_the_bound(draw, method: str, limit: float) -> None:
    """K = 4, R₀ = 100 m, 4,000 trials, seed 11: RMSE over the bound of the same trials."""
    drawn = draw(4000, (1, 1, 1, 1), 11)
    bound = crlb(drawn.truth_enu_m, drawn.links.position_enu_m, SignalModel())
    ratio = rmse(locate_batch(drawn.links, drawn.area, method), drawn.truth_enu_m) / np.sqrt(
        np.trace(bound, axis1=1, axis2=2).mean()
    )
    assert 0.95 < ratio < limit


def test_exact_without_noise(draw) -> None:
    drawn = draw(50, (1, 1, 1), 3, rss_std_db=0.0, angle_std_deg=0.0)
    for method in ("wls-taylor", "wls-taylor-bounded"):
        assert rmse(locate_batch(drawn.links, drawn.area, method), drawn.truth_enu_m) < 1e-5


def test_nlos_links_are_left_out(draw) -> None:
    drawn = draw(20, (1, 1, 0, 1, 0), 4)
    whole = locate_batch(drawn.links, drawn.area, "wls-taylor")
    for index, estimate in enumerate(whole):
        alone = drawn.links.problem(index).subset(np.array([0, 1, 3]))
        problem = strongest_first(
            alone.position_enu_m[None],
            alone.rss_dbm[None],
            alone.azimuth_rad[None],
            alone.elevation_rad[None],
        )
        assert np.allclose(wls_taylor(problem, SignalModel())[0], estimate.position_enu_m, atol=1e-7)


def test_bounds_hold_on_disc_and_polygon(draw) -> None:
    drawn = draw(300, (1, 1), 6, angle_std_deg=8.0)
    disc = SearchArea(np.array([20.0, 10.0]), 40.0, 2.0, 6.0)
    triangle = SearchArea.of_polygon(shapely.Polygon([(-20, -20), (30, -20), (0, 30)]), 2.0, 6.0)
    for area in (disc, triangle):
        places = np.array([e.position_enu_m for e in locate_batch(drawn.links, area, "wls-taylor-bounded")])
        assert (places[:, 2] >= 2.0).all()
        assert (places[:, 2] <= 6.0).all()
        grown = SearchArea(area.center_enu_m, area.radius_m * (1 + 1e-9), 2.0, 6.0)
        if area.polygon_en_m is None:
            assert grown.contains(places[:, 0], places[:, 1]).all()
        else:
            assert shapely.distance(area.polygon_en_m, shapely.points(places[:, :2])).max() < 1e-9


def test_rim_point_is_the_best_of_the_rim() -> None:
    """The multiplier's answer against a fine search along the rim."""
    from groundstation.localization.wls import _on_the_edge

    rng = np.random.default_rng(2)
    area = SearchArea(np.array([5.0, -3.0]), 30.0, 0.0, 20.0)
    for _ in range(20):
        root = rng.standard_normal((3, 3))
        normal = root @ root.T + 0.1 * np.eye(3)
        free = np.array([*(area.center_enu_m + 80 * rng.standard_normal(2)), 4.0])
        vector = normal @ free
        if area.contains(free[:1], free[1:2])[0]:
            continue
        found = _on_the_edge(normal, vector, free, area)
        turn = np.linspace(0, 2 * np.pi, 20001)
        rim = np.stack([5 + 30 * np.cos(turn), -3 + 30 * np.sin(turn), np.full(turn.size, 4.0)], axis=1)
        cost = np.einsum("ni,ij,nj->n", rim, normal, rim) - 2 * rim @ vector
        ours = found @ normal @ found - 2 * found @ vector
        assert ours <= cost.min() + 1e-6 * abs(cost.min())


def test_angles_near_pi(draw) -> None:
    """Bearings that straddle ±π say the same as the same scene turned by a right angle."""
    drawn = draw(200, (1, 1, 1, 1), 8)
    turned = drawn.links.azimuth_rad + 2 * np.pi * (np.arange(4) % 2)
    again = type(drawn.links)(
        drawn.links.position_enu_m, drawn.links.rss_dbm, turned, drawn.links.elevation_rad,
        drawn.links.los_probability,
    )  # fmt: skip
    one = locate_batch(drawn.links, drawn.area, "wls-taylor")
    two = locate_batch(again, drawn.area, "wls-taylor")
    for a, b in zip(one, two, strict=True):
        assert np.allclose(a.position_enu_m, b.position_enu_m, atol=1e-6)
