from __future__ import annotations

import numpy as np
import pytest

from groundstation.domain.errors import InputError
from groundstation.localization import Links, SearchArea, locate, locate_batch

AREA = SearchArea(np.zeros(2), 100.0, 0.0, 20.0)


def links(truth: np.ndarray, count: int = 4) -> Links:
    """Exact angles from every vehicle; the first is LOS."""
    turn = 2.0 * np.pi * np.arange(count) / count
    place = np.stack([100 * np.cos(turn), 100 * np.sin(turn), np.full(count, 50.0)], axis=1)
    offset = truth - place
    return Links(
        place,
        np.full(count, -60.0),
        np.arctan2(offset[:, 1], offset[:, 0]),
        np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1])),
        np.array([1.0] + [0.0] * (count - 1)),
    )


@pytest.mark.parametrize("count", [2, 4, 7])
def test_one_exact_nlos_bearing_meets_the_ray_at_the_target(count: int) -> None:
    truth = np.array([30.0, -40.0, 8.0])
    problem = links(truth, count)
    problem.azimuth_rad[2:] = np.nan
    estimate = locate(problem, AREA, "1aoa-nrss", covariance=False)
    assert np.allclose(estimate.position_enu_m, truth, atol=1e-6)
    assert np.isnan(estimate.transmit_power_dbm)
    assert np.isnan(estimate.rss_cost_db2)


def test_it_is_the_nearest_point_of_ray_and_mean_line() -> None:
    """Against a fine search along the ray."""
    problem = links(np.array([20.0, 10.0, 5.0]))
    problem.azimuth_rad[1:] += [0.3, -0.2, 0.5]
    found = locate(problem, AREA, "1aoa-nrss", covariance=False).position_enu_m
    cos = np.cos(problem.elevation_rad)
    unit = np.stack(
        [cos * np.cos(problem.azimuth_rad), cos * np.sin(problem.azimuth_rad), np.sin(problem.elevation_rad)],
        1,
    )
    mean = unit[1:].mean(axis=0)
    point = problem.position_enu_m[1:].mean(axis=0)
    along = np.linspace(0.0, 400.0, 400_001)
    ray = problem.position_enu_m[0] + along[:, None] * unit[0]
    gap = np.linalg.norm(np.cross(ray - point, mean / np.linalg.norm(mean)), axis=1)
    assert np.linalg.norm(found - ray[gap.argmin()]) < 2e-3


def test_nothing_behind_the_vehicle_and_nothing_from_parallels() -> None:
    problem = links(np.array([20.0, 10.0, 5.0]), 2)
    turned = links(np.array([20.0, 10.0, 5.0]), 2)
    turned.azimuth_rad[0] += np.pi
    turned.elevation_rad[0] *= -1.0
    assert np.allclose(locate(turned, AREA, "1aoa-nrss", covariance=False).position_enu_m, [100.0, 0, 50])
    problem.azimuth_rad[1], problem.elevation_rad[1] = problem.azimuth_rad[0], problem.elevation_rad[0]
    with pytest.raises(InputError, match="parallel to the LOS ray"):
        locate(problem, AREA, "1aoa-nrss", covariance=False)


def test_needs_an_angle_of_an_nlos_link(draw) -> None:
    drawn = draw(2, (1, 0, 0, 0), 7)
    for estimate in locate_batch(drawn.links, drawn.area, "1aoa-nrss", on_error="status"):
        assert estimate.status == "1aoa-nrss got 0 link(s) labelled NLOS with angles; it needs 1 or more"
        assert np.isnan(estimate.position_enu_m).all()
