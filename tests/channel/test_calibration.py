"""Temperature scaling recovers a known temperature; ECE is what its definition says."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.channel.calibration import Calibration, expected_calibration_error, fit_temperature


@pytest.mark.parametrize("temperature", [0.4, 1.0, 3.0])
def test_temperature_is_recovered(temperature: float) -> None:
    rng = np.random.default_rng(0)
    true_logit = rng.normal(0, 2, size=20_000)
    is_los = rng.random(20_000) < 1 / (1 + np.exp(-true_logit))
    fitted = fit_temperature(true_logit * temperature, is_los)
    assert fitted.temperature == pytest.approx(temperature, rel=0.05)
    probability = fitted.probability(true_logit * temperature)
    assert expected_calibration_error(probability, is_los) < 0.015


def test_probability_does_not_overflow() -> None:
    probability = Calibration(0.05).probability(np.array([-1e300, -1e3, 0.0, 1e3, 1e300]))
    np.testing.assert_allclose(probability, [0, 0, 0.5, 1, 1])


def test_ece_by_hand() -> None:
    probability = np.array([0.9, 0.9, 0.1, 1.0])
    is_los = np.array([True, False, False, True])
    # Bins of a fifteenth: |1.8 − 1| + |0.1 − 0| + |1 − 1| over four.
    assert expected_calibration_error(probability, is_los) == pytest.approx(0.9 / 4)
