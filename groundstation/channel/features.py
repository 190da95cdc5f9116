"""The paper's six statistics of a channel response (section III-A and VI-B).

Why: the classic classifiers (random forest, Gaussian process, SVM) that the network is set
beside work on them. Rule kept here: they are taken on min–max normalised magnitudes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FEATURE_NAMES = ("mean", "standard_deviation", "skewness", "kurtosis", "log_mean", "rician_k")
_LOG_FLOOR = 1e-6


def features(magnitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., taps) magnitudes → (..., 6) in the order of FEATURE_NAMES.

    Kurtosis is the excess; the log-mean is the mean of ln(max(m, 1e-6)); the Rician K-factor
    is the moment estimate of Greenstein, Michelson & Erceg (IEEE Comm. Letters 1999):
    with G = E[m²] and V = var(m²), K = √(G² − V) / (G − √(G² − V)), 0 where V > G².
    A constant response gives zeros.
    """
    low = magnitude.min(axis=-1, keepdims=True)
    span = magnitude.max(axis=-1, keepdims=True) - low
    constant = span == 0
    normalised = (magnitude - low) / np.where(constant, 1.0, span)

    mean = normalised.mean(axis=-1)
    deviation = normalised - mean[..., None]
    standard_deviation = np.sqrt((deviation**2).mean(axis=-1))
    safe = np.where(standard_deviation == 0, 1.0, standard_deviation)
    skewness = (deviation**3).mean(axis=-1) / safe**3
    kurtosis = (deviation**4).mean(axis=-1) / safe**4 - 3
    log_mean = np.log(np.maximum(normalised, _LOG_FLOOR)).mean(axis=-1)
    power = normalised**2
    gain = power.mean(axis=-1)
    specular = np.sqrt(np.maximum(gain**2 - power.var(axis=-1), 0.0))
    scattered = np.maximum(gain - specular, _LOG_FLOOR * _LOG_FLOOR)
    stacked = np.stack(
        [mean, standard_deviation, skewness, kurtosis, log_mean, specular / scattered], axis=-1
    )
    return np.where(constant, 0.0, stacked)
