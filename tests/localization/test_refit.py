from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from groundstation.localization import SignalModel
from groundstation.localization.batch import Batch
from groundstation.localization.refit import misfit, refit_power_and_exponent

MODEL = SignalModel()


def chi2(batch: Batch, row: int, place: np.ndarray, power: float, exponent: float) -> float:
    """χ² of powers and priors, written out link by link."""
    model = batch.model
    total = (power - 15.5) ** 2 / (5.0**2 / 12.0) + (exponent - 2.7) ** 2 / (1.5**2 / 12.0)
    for k in range(batch.links.count):
        d = np.linalg.norm(batch.place[row, k] - place)
        los = batch.links.los_probability[row, k] >= 0.5
        bias = 0.0 if los else batch.bias_max_db[row] / 2
        variance = 25.0 if los else 25.0 + batch.bias_max_db[row] ** 2 / 12.0
        expected = power - 10 * (model.los_exponent if los else exponent) * np.log10(d) - bias
        total += (batch.links.rss_dbm[row, k] - expected) ** 2 / variance
    return float(total)


@pytest.mark.parametrize("los", [(0, 0, 0, 0), (1, 0, 0, 1, 0), (0, 0, 0)])
def test_least_squares_within_the_exponents_range(draw, los: tuple[int, ...]) -> None:
    drawn = draw(14, los, 51, rss_std_db=12.0)
    batch = Batch.of(drawn.links, drawn.area, MODEL, np.linspace(6.0, 8.0, 14))
    power, exponent = refit_power_and_exponent(batch, drawn.truth_enu_m)
    value = misfit(batch, drawn.truth_enu_m)
    shared = exponent[:, los.index(0)]
    assert ((shared == 2.0) | (shared == 3.5)).any()
    assert ((shared > 2.0) & (shared < 3.5)).any()
    for row in range(14):
        place = drawn.truth_enu_m[row]
        best = minimize(
            lambda v, r=row, at=place: chi2(batch, r, at, v[0], v[1]),
            [15.0, 2.7],
            bounds=[(None, None), (2.0, 3.5)],
        )
        assert value[row] == pytest.approx(best.fun, rel=1e-5)
        assert chi2(batch, row, place, power[row], shared[row]) == pytest.approx(value[row], rel=1e-9)


def test_line_of_sight_links_keep_their_exponent(draw) -> None:
    drawn = draw(5, (1, 1, 1, 1), 52)
    batch = Batch.of(drawn.links, drawn.area, MODEL)
    _, exponent = refit_power_and_exponent(batch, drawn.truth_enu_m)
    assert (exponent == MODEL.los_exponent).all()
    assert np.isfinite(misfit(batch, drawn.truth_enu_m)).all()


def test_known_power_is_kept(draw) -> None:
    drawn = draw(5, (0, 0, 0, 0), 53)
    batch = Batch.of(drawn.links, drawn.area, replace(MODEL, known_transmit_power_dbm=17.0))
    power, _ = refit_power_and_exponent(batch, drawn.truth_enu_m)
    assert power == pytest.approx(np.full(5, 17.0), abs=1e-6)
