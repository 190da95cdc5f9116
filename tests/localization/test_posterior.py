from __future__ import annotations

import numpy as np
import pytest

from groundstation.localization import SignalModel, locate_batch
from groundstation.localization.posterior import posterior


@pytest.mark.parametrize(
    ("los", "limit_m", "low", "high"),
    [((1, 1, 1, 1), 1.88, 0.8, 1.1), ((1, 0, 0, 0), 14.1, 0.8, 1.2), ((0, 0, 0, 0), 45.0, 0.9, 1.1)],
)
def test_reaches_the_limits(draw, los: tuple[int, ...], limit_m: float, low: float, high: float) -> None:
    """K = 4, R₀ = 100 m, 120 trials, seed 21: RMSE over the limit; the 90 % ellipsoid is honest."""
    drawn = draw(120, los, 21)
    estimates = locate_batch(drawn.links, drawn.area, "posterior")
    error = np.array([e.position_enu_m for e in estimates]) - drawn.truth_enu_m
    ratio = np.sqrt(np.square(error).sum(axis=1).mean()) / limit_m
    assert low < ratio < high
    inside = [e @ np.linalg.solve(s.covariance_m2, e) < 6.251 for e, s in zip(error, estimates, strict=True)]
    assert 0.85 <= np.mean(inside) <= 1.0


@pytest.mark.parametrize("count", [1, 2, 3, 12])
def test_any_number_of_links(draw, count: int) -> None:
    drawn = draw(1, (0,) * count, 2)
    answer = posterior(drawn.links.problem(0), drawn.area, SignalModel())
    assert np.isfinite(answer.position_enu_m).all()
    spread = np.sqrt(answer.covariance_m2[0, 0] + answer.covariance_m2[1, 1])
    assert 20.0 < spread < 75.0


def test_one_outlier_of_30_db_does_not_make_it_certain(draw) -> None:
    drawn = draw(1, (1, 1, 1, 1), 5)
    links = drawn.links.problem(0)
    links.rss_dbm[2] += 30.0
    answer = posterior(links, drawn.area, SignalModel())
    # Four bearings outvote the power.
    assert np.linalg.norm(answer.position_enu_m - drawn.truth_enu_m[0]) < 8.0


def test_power_is_estimated(draw) -> None:
    drawn = draw(1, (1, 1, 1, 1), 9, rss_std_db=0.0, angle_std_deg=0.1)
    model = SignalModel(rss_std_db=0.3, transmit_power_min_dbm=0.0, transmit_power_max_dbm=40.0)
    links = drawn.links.problem(0)
    distance = np.linalg.norm(links.position_enu_m - drawn.truth_enu_m[0], axis=1)
    true_power = float((links.rss_dbm + 25.0 * np.log10(distance)).mean())
    assert abs(posterior(links, drawn.area, model).transmit_power_dbm - true_power) < 0.5
