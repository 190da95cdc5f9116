"""The six statistics against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from groundstation.channel.features import FEATURE_NAMES, features


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


@pytest.mark.parametrize("k", [1.0, 5.0, 20.0])
def test_rician_k_of_rician_magnitudes(k: float) -> None:
    """Two pins hold the range to 0 and 1·max, so that normalisation is a scale only."""
    rng = np.random.default_rng(int(k))
    taps = 200_000
    scatter = (rng.standard_normal(taps) + 1j * rng.standard_normal(taps)) * np.sqrt(0.5)
    magnitude = np.abs(np.sqrt(k) + scatter)
    magnitude[0] = 0
    assert features(magnitude)[5] == pytest.approx(k, rel=0.05)


def test_batches_and_constants() -> None:
    rng = np.random.default_rng(1)
    batch = rng.rayleigh(size=(5, 64))
    batch[2] = 3.0
    result = features(batch)
    assert np.all(result[2] == 0)
    np.testing.assert_array_equal(result[4], features(batch[4]))
