"""The Cramér–Rao lower bound on LOS links: what no unbiased estimator beats.

Exists as the yardstick of every LOS table and as the covariance that LOS answers carry.
Rule: it holds for LOS links with the model's noise only; NLOS answers take the posterior's
spread, because local bounds say nothing about a posterior with a prior and several modes.
"""

from __future__ import annotations

import numpy as np

from groundstation.localization.problem import BoolArray, FloatArray, SignalModel

_MINIMUM_DISTANCE_M = 0.1


def fisher_information(
    target_enu_m: FloatArray,
    vehicle_enu_m: FloatArray,
    model: SignalModel,
    has_angle: BoolArray | None = None,
    known_transmit_power: bool = False,
) -> FloatArray:
    """Fisher information of position from received power and both angles of LOS links.

    target_enu_m (…, 3), vehicle_enu_m (…, K, 3), metres ENU; ``has_angle`` (…, K), all when
    None. Received power enters with its mean over links removed when the transmit power is
    unknown (the Schur complement of a common offset). Returns (…, 3, 3), 1/m².
    """
    offset = target_enu_m[..., None, :] - vehicle_enu_m
    horizontal = np.maximum(np.hypot(offset[..., 0], offset[..., 1]), _MINIMUM_DISTANCE_M)
    distance2 = np.maximum(np.square(offset).sum(axis=-1), _MINIMUM_DISTANCE_M**2)
    zeros = np.zeros_like(horizontal)
    azimuth = np.stack([-offset[..., 1], offset[..., 0], zeros], axis=-1) / np.square(horizontal)[..., None]
    elevation = (
        np.stack(
            [
                -offset[..., 0] * offset[..., 2] / horizontal,
                -offset[..., 1] * offset[..., 2] / horizontal,
                horizontal,
            ],
            axis=-1,
        )
        / distance2[..., None]
    )
    power = 10.0 * model.los_exponent / np.log(10.0) * offset / distance2[..., None]
    if not known_transmit_power:
        power = power - power.mean(axis=-2, keepdims=True)
    weight = np.ones_like(horizontal) if has_angle is None else has_angle.astype(np.float64)
    information = np.einsum("...ki,...kj->...ij", power, power) / model.rss_std_db**2
    information += np.einsum("...k,...ki,...kj->...ij", weight, azimuth, azimuth) / model.azimuth_std_rad**2
    information += (
        np.einsum("...k,...ki,...kj->...ij", weight, elevation, elevation) / model.elevation_std_rad**2
    )
    result: FloatArray = information
    return result


def crlb(
    target_enu_m: FloatArray,
    vehicle_enu_m: FloatArray,
    model: SignalModel,
    has_angle: BoolArray | None = None,
    known_transmit_power: bool = False,
) -> FloatArray:
    """Cramér–Rao bound (…, 3, 3) in m²; directions that nothing measures come out at 1 km²."""
    information = fisher_information(target_enu_m, vehicle_enu_m, model, has_angle, known_transmit_power)
    floor = 1e-6 * np.eye(3)
    bound: FloatArray = np.asarray(np.linalg.inv(information + floor), dtype=np.float64)
    return bound
