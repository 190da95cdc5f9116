"""The paper's six statistics of a channel response (III-A, V-B), and goodness of fit as an option.

Why: the classic classifiers (random forest, Gaussian process, SVM) that the network is set
beside work on them. Rule kept here: they are taken on min–max normalised magnitudes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chndtr

FEATURE_NAMES = ("mean", "standard_deviation", "skewness", "kurtosis", "log_mean", "rician_k")
FIT_NAMES = ("rayleigh_distance", "rician_distance")
"""Of the option: Kolmogorov–Smirnov distances to the fitted distributions."""
_LOG_FLOOR = 1e-6
_K_MAX = 1e6


def features(magnitude: NDArray[np.floating], *, goodness_of_fit: bool = False) -> NDArray[np.float64]:
    """(..., taps) magnitudes → (..., 6) in the order of FEATURE_NAMES; (..., 8) with FIT_NAMES.

    Kurtosis is the excess; the log-mean is the mean of ln(max(m, 1e-6)). The Rician K-factor is
    the power of the strongest tap over that of all others: the paper means the "specular
    dominance", and the taps of a response are no sample of one Rician variable (the
    moment estimate of Greenstein et al. gives K = 0 for 99 % of simulated and all of the
    measured responses we have). A constant response gives zeros.
    """
    values = np.asarray(magnitude, np.float64)
    low = values.min(axis=-1, keepdims=True)
    span = values.max(axis=-1, keepdims=True) - low
    constant = span == 0
    normalised = (values - low) / np.where(constant, 1.0, span)

    mean = normalised.mean(axis=-1)
    deviation = normalised - mean[..., None]
    squared = deviation * deviation
    standard_deviation = np.sqrt(squared.mean(axis=-1))
    safe = np.where(standard_deviation == 0, 1.0, standard_deviation)
    skewness = (squared * deviation).mean(axis=-1) / safe**3
    kurtosis = (squared * squared).mean(axis=-1) / safe**4 - 3
    log_mean = np.log(np.maximum(normalised, _LOG_FLOOR)).mean(axis=-1)
    energy = (normalised * normalised).sum(axis=-1)
    rician_k = np.minimum(1 / np.maximum(energy - 1, 1 / _K_MAX), _K_MAX)
    columns = [mean, standard_deviation, skewness, kurtosis, log_mean, rician_k]
    if goodness_of_fit:
        columns += _fit_distances(normalised)
    stacked = np.stack(columns, axis=-1)
    return np.where(constant, 0.0, stacked)


def moment_k(magnitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., samples) → (...) K of Rician samples by moments (Greenstein, Michelson & Erceg, 1999).

    With G = E[m²] and V = var(m²), K = √(G² − V) / (G − √(G² − V)), 0 where V > G².
    """
    power = magnitude * magnitude
    gain = power.mean(axis=-1)
    specular = np.sqrt(np.maximum(gain**2 - power.var(axis=-1), 0.0))
    ratio: NDArray[np.float64] = specular / np.maximum(gain - specular, _LOG_FLOOR * _LOG_FLOOR)
    return ratio


def _fit_distances(normalised: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Kolmogorov–Smirnov distances of (..., taps) to their Rayleigh and Rician fits (by moments)."""
    ordered = np.sort(normalised, axis=-1)
    taps = ordered.shape[-1]
    power = ordered * ordered
    gain = np.maximum(power.mean(axis=-1, keepdims=True), _LOG_FLOOR**2)
    above, below = np.arange(1, taps + 1) / taps, np.arange(taps) / taps

    def distance(cumulative: NDArray[np.float64]) -> NDArray[np.float64]:
        worst: NDArray[np.float64] = np.maximum(above - cumulative, cumulative - below).max(axis=-1)
        return worst

    rayleigh = distance(-np.expm1(-power / gain))
    k = np.minimum(moment_k(normalised)[..., None], 1e4)
    # m² / σ² is non-central χ² of two degrees of freedom, non-centrality 2K, σ² = G / (2 (1 + K)).
    rician = distance(chndtr(power * 2 * (1 + k) / gain, 2.0, 2 * k)) if np.any(k > 0) else rayleigh
    return [rayleigh, rician]
