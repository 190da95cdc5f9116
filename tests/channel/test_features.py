"""The six statistics against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from groundstation.channel.features import FEATURE_NAMES, FIT_NAMES, features, moment_k


def test_against_scipy_on_normalised_magnitudes() -> None:
    magnitude = np.random.default_rng(0).rayleigh(size=1016) * 40
    normalised = (magnitude - magnitude.min()) / np.ptp(magnitude)
    expected = [
        normalised.mean(),
        normalised.std(),
        stats.skew(normalised),
        stats.kurtosis(normalised),
        np.log(np.maximum(normalised, 1e-6)).mean(),
    ]
    np.testing.assert_allclose(features(magnitude)[:5], expected)
    assert len(FEATURE_NAMES) == 6


def test_k_is_the_strongest_tap_over_all_others() -> None:
    magnitude = np.zeros(64)
    magnitude[10], magnitude[20], magnitude[30] = 2.0, 1.0, 0.5
    assert features(magnitude)[5] == pytest.approx(4 / 1.25)


@pytest.mark.parametrize("k", [1.0, 5.0, 20.0])
def test_moment_k_of_rician_samples(k: float) -> None:
    rng = np.random.default_rng(int(k))
    scatter = (rng.standard_normal(200_000) + 1j * rng.standard_normal(200_000)) * np.sqrt(0.5)
    assert moment_k(np.abs(np.sqrt(k) + scatter)) == pytest.approx(k, rel=0.05)


@pytest.mark.parametrize("k", [0.0, 6.0])
def test_goodness_of_fit_is_the_kolmogorov_smirnov_distance(k: float) -> None:
    """Against SciPy's test on the same fitted distributions; a sample of its own kind fits."""
    rng = np.random.default_rng(3)
    scatter = (rng.standard_normal(4000) + 1j * rng.standard_normal(4000)) * np.sqrt(0.5)
    magnitude = np.abs(np.sqrt(k) + scatter)
    magnitude[0] = 0.0
    scaled = magnitude / magnitude.max()
    rayleigh, rician = features(magnitude, goodness_of_fit=True)[6:]
    sigma = np.sqrt(np.mean(scaled**2) / 2)
    assert rayleigh == pytest.approx(stats.kstest(scaled, stats.rayleigh(scale=sigma).cdf).statistic)
    fitted = float(moment_k(scaled))
    sigma = np.sqrt(np.mean(scaled**2) / (2 * (1 + fitted)))
    theirs = stats.kstest(scaled, stats.rice(np.sqrt(2 * fitted), scale=sigma).cdf).statistic
    assert rician == pytest.approx(theirs, rel=1e-6)
    assert rician < 0.02
    assert (rayleigh < 0.02) == (k == 0)
    assert len(FIT_NAMES) == 2


def test_batches_and_constants() -> None:
    rng = np.random.default_rng(1)
    batch = rng.rayleigh(size=(5, 64))
    batch[2] = 3.0
    result = features(batch)
    assert np.all(result[2] == 0)
    np.testing.assert_array_equal(result[4], features(batch[4]))
