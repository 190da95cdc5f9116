"""What every LSRE program is made of, eqs. (52)–(60) and (72), for N problems at once.

Exists so that the literal programs, the sound one and the relaxations of the literature weigh
the same powers in the same way. Rule: a link labelled LOS has b = 0 and β_LOS, (72); every
other has 0 ≤ b ≤ b_max. Equations are those of the paper (Gao & Sadjadpour, 2026).

With c_k = m_k/m_t (per metre) and the bias interval's ends e̲ and ē = 1/e̲, the criterion (58) is
Σ_k Σ_e [1/(c_k e d_k)² + (c_k e d_k)²] = Σ_k g_k [1/(c_k d_k)² + (c_k d_k)²] with
g_k = e̲² + ē²: the ends being each other's inverse only scale a link's two terms, alike.
"""

from __future__ import annotations

import numpy as np

from groundstation.localization.batch import Batch
from groundstation.localization.problem import FloatArray

_LN10 = float(np.log(10.0))
_SMALLEST_RELATIVE = 1e-9


def log_gains(batch: Batch, power_dbm: FloatArray, exponent: FloatArray) -> FloatArray:
    """(N, K) ln c_k, c_k = m_k/m_t of (54): one over the distance that the shifted power P̂_r tells.

    ``power_dbm`` (N,) P̂_t; ``exponent`` (N, K) β̂. P̂_r = P_r + b_max/2 on an NLOS link, (53).
    """
    shift = np.where(batch.los(), 0.0, 0.5 * batch.bias_max_db[:, None])
    result: FloatArray = (batch.received_dbm() + shift - power_dbm[:, None]) * (_LN10 / 10.0) / exponent
    return result


def log_interval_end(batch: Batch, exponent: FloatArray) -> FloatArray:
    """(N, K) ln ē_k = −ln e̲_k, half the bias interval below (57); 0 on a LOS link, (72)."""
    return np.where(batch.los(), 0.0, batch.bias_max_db[:, None] * (_LN10 / 20.0) / exponent)


def log_end_weights(batch: Batch, exponent: FloatArray) -> FloatArray:
    """(N, K) ln g_k, g_k = Σ e² over R_k of (72): 1 on a LOS link, e̲² + ē² on the others."""
    width = 2.0 * log_interval_end(batch, exponent)
    return np.where(batch.los(), 0.0, np.logaddexp(width, -width))


def criterion(
    batch: Batch, position_enu_m: FloatArray, power_dbm: FloatArray, exponent: FloatArray
) -> FloatArray:
    """(N,) the LSRE criterion (58), (60) at positions (N, 3): no unit, least where c_k d_k = 1."""
    weight = np.exp(log_end_weights(batch, exponent))
    gap = np.linalg.norm(batch.place - position_enu_m[:, None, :], axis=-1)
    relative = np.maximum(np.exp(log_gains(batch, power_dbm, exponent)) * gap, _SMALLEST_RELATIVE)
    result: FloatArray = (weight * (np.square(relative) + 1.0 / np.square(relative))).sum(axis=1)
    return result


def weighted_centroid(batch: Batch, power_dbm: FloatArray, exponent: FloatArray) -> FloatArray:
    """(N, 3) Σ w_k a_k / Σ w_k, w_k = c_k² g_k: the place that the quadratic terms of (58) pull to."""
    logs = 2.0 * log_gains(batch, power_dbm, exponent) + log_end_weights(batch, exponent)
    # Only the weights' ratios matter, and after (68) a link's weight may be any power of ten.
    weight = np.exp(logs - logs.max(axis=1, keepdims=True))
    result: FloatArray = np.einsum("nk,nkc->nc", weight, batch.place) / weight.sum(axis=1)[:, None]
    return result
