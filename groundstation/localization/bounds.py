"""The Cramér–Rao lower bound on LOS links: what no unbiased estimator beats.

Exists as the yardstick of every LOS table and as the covariance that LOS answers carry.
Rule: it holds for LOS links with the model's noise only; NLOS answers take the posterior's
spread, because local bounds say nothing about a posterior with a prior and several modes.
"""

from __future__ import annotations

import math

import numpy as np

from groundstation.localization.problem import BoolArray, FloatArray, SignalModel

_MINIMUM_DISTANCE_M = 1e-3
_FLOOR_PER_M2 = 1e-6


def fisher_information(
    target_enu_m: FloatArray,
    vehicle_enu_m: FloatArray,
    model: SignalModel,
    has_angle: BoolArray | None = None,
    known_transmit_power: bool = False,
    *,
    used: BoolArray | None = None,
    spread_m2: FloatArray | None = None,
) -> FloatArray:
    """Fisher information of position from received power and both angles of LOS links.

    target_enu_m (…, 3), vehicle_enu_m (…, K, 3), metres ENU; ``has_angle`` (…, K): links whose
    angles count, and ``used`` (…, K): links that count at all; all when None. Received power
    enters with its mean over links removed when the transmit power is unknown (the Schur
    complement of a common offset). ``spread_m2`` (…,) is added to each squared distance: the
    information expected of a place known to that mean square only. Returns (…, 3, 3), 1/m².
    """
    offset = target_enu_m[..., None, :] - vehicle_enu_m
    x, y, z = offset[..., 0], offset[..., 1], offset[..., 2]
    horizontal2 = x * x + y * y + _MINIMUM_DISTANCE_M**2
    distance2 = horizontal2 + z * z
    horizontal, distance = np.sqrt(horizontal2), np.sqrt(distance2)
    beside, away = horizontal, distance
    if spread_m2 is not None:
        spread = spread_m2[..., None]
        beside, away = np.sqrt(horizontal2 + spread), np.sqrt(distance2 + spread)
    per_azimuth = (1.0 / model.azimuth_std_rad) / beside
    per_elevation = (1.0 / model.elevation_std_rad) / away
    if has_angle is not None:
        per_azimuth, per_elevation = per_azimuth * has_angle, per_elevation * has_angle
    # Each measurement's direction of steepest change, over the distance of one standard deviation.
    rows = np.zeros((*distance.shape[:-1], 3, distance.shape[-1], 3))
    across = per_azimuth / horizontal
    rows[..., 0, :, 0] = -y * across
    rows[..., 0, :, 1] = x * across
    climb = per_elevation * z / (horizontal * distance)
    rows[..., 1, :, 0] = -x * climb
    rows[..., 1, :, 1] = -y * climb
    rows[..., 1, :, 2] = per_elevation * horizontal / distance
    per_m = 10.0 * model.los_exponent / (math.log(10.0) * model.rss_std_db)
    rows[..., 2, :, :] = offset * (per_m / (distance * away))[..., None]
    if used is not None:
        rows *= used[..., None, :, None]
    if not known_transmit_power:
        power = rows[..., 2, :, :]
        if used is None:
            power -= power.mean(axis=-2, keepdims=True)
        else:
            count = np.maximum(used.sum(axis=-1), 1)[..., None, None]
            power -= power.sum(axis=-2, keepdims=True) / count * used[..., None]
    flat = rows.reshape(*horizontal.shape[:-1], 3 * horizontal.shape[-1], 3)
    information: FloatArray = np.swapaxes(flat, -1, -2) @ flat
    return information


def crlb(
    target_enu_m: FloatArray,
    vehicle_enu_m: FloatArray,
    model: SignalModel,
    has_angle: BoolArray | None = None,
    known_transmit_power: bool = False,
    *,
    used: BoolArray | None = None,
    height_std_m: float | None = None,
    spread_m2: FloatArray | None = None,
) -> FloatArray:
    """Cramér–Rao bound (…, 3, 3) in m²; directions that nothing measures come out at 1 km².

    ``height_std_m``: standard deviation of a prior on the height (√(1/12) of its range where it
    is uniform), counted as one more measurement: the bound of an estimator that uses it is then
    a local Bayesian one. The rest as in ``fisher_information``.
    """
    information = fisher_information(
        target_enu_m, vehicle_enu_m, model, has_angle, known_transmit_power, used=used, spread_m2=spread_m2
    )
    information += _FLOOR_PER_M2 * np.eye(3)
    if height_std_m is not None:
        information[..., 2, 2] += 1.0 / height_std_m**2
    bound: FloatArray = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return bound
