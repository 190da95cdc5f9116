"""Scale and offset are recovered; ECE is what its definition says."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.channel.calibration import (
    Calibration,
    even_weights,
    expected_calibration_error,
    fit_calibration,
)


@pytest.mark.parametrize("temperature", [0.4, 1.0, 3.0])
def test_temperature_is_recovered(temperature: float) -> None:
    rng = np.random.default_rng(0)
    true_logit = rng.normal(0, 2, size=20_000)
    is_los = rng.random(20_000) < 1 / (1 + np.exp(-true_logit))
    fitted = fit_calibration(true_logit * temperature, is_los)
    assert fitted.temperature == pytest.approx(temperature, rel=0.05)
    probability = fitted.probability(true_logit * temperature)
    assert expected_calibration_error(probability, is_los) < 0.015


def test_offset_is_recovered_and_even_weights_undo_a_skewed_class_mix() -> None:
    rng = np.random.default_rng(1)
    true_logit = rng.normal(0, 2, size=20_000)
    is_los = rng.random(20_000) < 1 / (1 + np.exp(-true_logit))
    assert fit_calibration(true_logit - 1.5, is_los).bias == pytest.approx(1.5, abs=0.06)
    # One NLOS in ten kept: the plain fit takes LOS for likelier, the even one does not.
    kept = is_los | (rng.random(20_000) < 0.1)
    plain = fit_calibration(true_logit[kept], is_los[kept])
    even = fit_calibration(true_logit[kept], is_los[kept], even_weights(is_los[kept]))
    assert plain.bias == pytest.approx(np.log(10), abs=0.2)
    assert even.bias == pytest.approx(0, abs=0.15)


def test_separable_links_do_not_run_away() -> None:
    fitted = fit_calibration(np.array([-1.0, -0.5, 0.5, 1.0]), np.array([False, False, True, True]))
    assert 0.2 < fitted.temperature < 1
    assert abs(fitted.bias) < 0.1


def test_probability_does_not_overflow() -> None:
    probability = Calibration(0.05).probability(np.array([-1e300, -1e3, 0.0, 1e3, 1e300]))
    np.testing.assert_allclose(probability, [0, 0, 0.5, 1, 1])


def test_ece_by_hand() -> None:
    probability = np.array([0.9, 0.9, 0.1, 1.0])
    is_los = np.array([True, False, False, True])
    # Bins of a fifteenth: |1.8 − 1| + |0.1 − 0| + |1 − 1| over four.
    assert expected_calibration_error(probability, is_los) == pytest.approx(0.9 / 4)
