from __future__ import annotations

import numpy as np
import pytest

from groundstation.localization import SignalModel
from groundstation.localization.batch import Batch
from groundstation.localization.lsre_terms import criterion, log_end_weights, log_gains, weighted_centroid

MODEL = SignalModel()
BIAS = np.array([6.0, 7.3, 8.0])


@pytest.fixture
def batch(draw) -> Batch:
    drawn = draw(3, (1, 0, 0, 0), 21)
    return Batch.of(drawn.links, drawn.area, MODEL, BIAS)


def test_criterion_is_58_with_both_ends_written_out(batch: Batch) -> None:
    """The ends of the bias interval only scale each link's two terms."""
    exponent = np.array([[2.5, 2.2, 2.9, 3.3]] * 3)
    power, place = np.array([14.0, 15.0, 17.0]), np.array([[3.0, 40, 9], [-50, 2, 1], [0, 0, 20]])
    got = criterion(batch, place, power, exponent)
    for row in range(3):
        total = 0.0
        for k in range(4):
            beta, los = exponent[row, k], k == 0
            d = np.linalg.norm(batch.place[row, k] - place[row])
            m_t = 10 ** (power[row] / (10 * beta))
            m = 10 ** ((batch.links.rss_dbm[row, k] + (0 if los else BIAS[row] / 2)) / (10 * beta))
            low = 10 ** (-BIAS[row] / (20 * beta))
            for e in (1.0,) if los else (low, 1.0 / low):
                total += m_t**2 / (m**2 * d**2 * e**2) + m**2 * d**2 * e**2 / m_t**2
        assert got[row] == pytest.approx(total, rel=1e-12)


def test_centroid_weighs_by_gain_and_ends(batch: Batch) -> None:
    power, exponent = batch.first_power_dbm(), batch.first_exponents()
    weight = np.exp(2 * log_gains(batch, power, exponent) + log_end_weights(batch, exponent))
    expected = (weight[..., None] * batch.place).sum(axis=1) / weight.sum(axis=1)[:, None]
    assert np.allclose(weighted_centroid(batch, power, exponent), expected, rtol=1e-12)


def test_no_bias_on_a_line_of_sight_link(batch: Batch) -> None:
    exponent = batch.first_exponents()
    assert (log_end_weights(batch, exponent)[:, 0] == 0.0).all()
    gain = log_gains(batch, batch.first_power_dbm(), exponent)
    distance = 10 ** ((15.0 - batch.links.rss_dbm[:, 0]) / 25.0)
    assert np.exp(-gain[:, 0]) == pytest.approx(distance)
    shifted = 10 ** ((15.0 - batch.links.rss_dbm[:, 1] - BIAS / 2) / 27.0)
    assert np.exp(-gain[:, 1]) == pytest.approx(shifted)
