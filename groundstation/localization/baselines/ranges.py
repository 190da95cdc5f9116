"""What the LOS baselines share: gains, bearings and weights of the links they use.

Exists so that ``sdp-socp`` and ``sr-wls`` read the same links in the same way. Rule: a link
that is not used (no LOS label, or no angles) has weight 0 and harmless values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from groundstation.localization.batch import Batch
from groundstation.localization.problem import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Ranges:
    """N problems of K links."""

    used: BoolArray
    """(N, K) LOS-labelled links with both angles."""
    gain: FloatArray
    """(N, K) λ_k = 10^(P_k / 10β)."""
    weight: FloatArray
    """(N, K) w_k = 1 − d̂_k / Σ d̂ with d̂_k ∝ 1 / λ_k: near links count more; 0 where not used."""
    bearing: FloatArray
    """(N, K, 3) u_k, from the vehicle to the beacon."""
    across: FloatArray
    """(N, 2, K, 3) c_k and k_k: the directions in which the azimuth and the elevation see an error."""

    @classmethod
    def of(cls, batch: Batch) -> Ranges:
        """The LOS links of a batch."""
        used = batch.bearing_usable()
        azimuth = np.where(used, batch.links.azimuth_rad, 0.0)
        elevation = np.where(used, batch.links.elevation_rad, 0.0)
        received = np.where(used, batch.received_dbm(), 0.0)
        gain = np.exp(received * (math.log(10.0) / (10.0 * batch.model.los_exponent)))
        # Relative to the strongest: the sum must not overflow.
        range_ratio = np.where(used, np.where(used, gain, 0.0).max(axis=1, keepdims=True) / gain, 0.0)
        weight = np.where(used, 1.0 - range_ratio / range_ratio.sum(axis=1, keepdims=True), 0.0)
        cos_az, sin_az, cos_el, sin_el = (
            np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation),
        )  # fmt: skip
        bearing = np.stack([cos_el * cos_az, cos_el * sin_az, sin_el], axis=-1)
        azimuth_row = np.stack([-sin_az, cos_az, np.zeros_like(cos_az)], axis=-1)
        elevation_row = np.stack([sin_el * cos_az, sin_el * sin_az, -cos_el], axis=-1)
        return cls(used, gain, weight, bearing, np.stack([azimuth_row, elevation_row], axis=1))

    def level(self, batch: Batch, power_dbm: FloatArray) -> FloatArray:
        """(N,) η = 10^(P_t / 10β)."""
        result: FloatArray = np.exp(power_dbm * (math.log(10.0) / (10.0 * batch.model.los_exponent)))
        return result
