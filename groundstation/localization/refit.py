"""Transmit power and one shared NLOS exponent, refitted at a given place with their priors.

Exists because (68) as printed fits one exponent a link and so makes every place as good as any
other; one exponent for all links under rubble, held by its prior, leaves K − 2 residuals that
can tell places apart. Rule: priors and noise are the model's; a link labelled LOS keeps β_LOS
and has no bias, the others' bias is uniform on 0 … b_max (mean b_max/2, variance b_max²/12).
"""

from __future__ import annotations

import math

import numpy as np

from groundstation.localization.batch import Batch
from groundstation.localization.problem import FloatArray

_SMALLEST_STD = 1e-6


def refit_power_and_exponent(batch: Batch, position_enu_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """P̂_t (N,) dBm and β̂ (N, K) at positions (N, 3), by least squares with priors; β̂ kept in its range."""
    model, los = batch.model, batch.los()
    path = 10.0 * np.log10(batch.distances_m(position_enu_m))
    variance = _noise_variance_db2(batch)
    level = batch.received_dbm() + np.where(los, model.los_exponent * path, 0.5 * batch.bias_max_db[:, None])
    slope = np.where(los, 0.0, -path)
    power_std, exponent_std = _prior_std(batch)
    # Normal equations of (P_t, β): two unknowns, solved by Cramer's rule for all problems.
    a = (1.0 / variance).sum(axis=1) + 1.0 / power_std**2
    b = (slope / variance).sum(axis=1)
    c = (slope * slope / variance).sum(axis=1) + 1.0 / exponent_std**2
    p = (level / variance).sum(axis=1) + model.transmit_power_mean_dbm / power_std**2
    q = (slope * level / variance).sum(axis=1) + model.first_exponent / exponent_std**2
    exponent = (a * q - b * p) / (a * c - b * b)
    exponent = np.clip(exponent, model.nlos_exponent_min, model.nlos_exponent_max)
    power = (p - b * exponent) / a
    return power, np.where(los, model.los_exponent, exponent[:, None])


def misfit(batch: Batch, position_enu_m: FloatArray) -> FloatArray:
    """(N,) χ² of the powers at positions (N, 3), power and exponent refitted, their priors included."""
    model, los = batch.model, batch.los()
    power, exponent = refit_power_and_exponent(batch, position_enu_m)
    shift = np.where(los, 0.0, 0.5 * batch.bias_max_db[:, None])
    expected = power[:, None] - 10.0 * exponent * np.log10(batch.distances_m(position_enu_m)) - shift
    value = (np.square(batch.received_dbm() - expected) / _noise_variance_db2(batch)).sum(axis=1)
    power_std, exponent_std = _prior_std(batch)
    value += np.square((power - model.transmit_power_mean_dbm) / power_std)
    shared = np.where(los, model.first_exponent, exponent) - model.first_exponent
    result: FloatArray = value + np.square(np.abs(shared).max(axis=1, initial=0.0) / exponent_std)
    return result


def _noise_variance_db2(batch: Batch) -> FloatArray:
    """(N, K) dB²: shadowing, and on an NLOS link the spread of the bias."""
    model = batch.model
    obstructed = model.nlos_rss_std_db**2 + np.square(batch.bias_max_db[:, None]) / 12.0
    return np.where(batch.los(), model.rss_std_db**2, obstructed)


def _prior_std(batch: Batch) -> tuple[float, float]:
    model = batch.model
    exponent = (model.nlos_exponent_max - model.nlos_exponent_min) / math.sqrt(12.0)
    return max(model.transmit_power_std_db, _SMALLEST_STD), max(exponent, _SMALLEST_STD)
