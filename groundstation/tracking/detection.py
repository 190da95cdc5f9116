"""What silence says of a place: P(nobody there heard it | the beacon is here).

Exists to keep the model of hearing apart from the bookkeeping of who listened where
(``silence``). Rules: the same signal model and priors as the windows' likelihood; softened by
everything that is not known, and with a floor: silence lowers a place, it never rules it out.

Model, for a beacon at x and a receiver at a_i that was silent:

    level_i = P − β L_i − g N_i − b + o + n_i,   L_i = 10 log₁₀‖x − a_i‖,
    P(silent_i | x) = 1 − (1 − m_i) Φ((E level_i − S_i) / τ)

with S_i the receiver's sensitivity, m_i the probability that no packet came through although the
level was enough, and τ² = σ² + b_max²/12 + σ_o² + σ_S² + σ_g² N_i²; N_i is the loss in the antennas' null
overhead. P and β_NLOS are what the levels that *were*
heard say of them, were the beacon at x: a regression with two unknowns in closed form at each
x (a Gaussian with the prior's moments for β). What remains unknown of them is common to all
receivers, and is summed over by three nodes of Gauss–Hermite. Neighbouring silences share
their shadowing, so each counts with the part 1/(1 + Σ ρ_ij) (effective number of samples).

Around that, what is common to many silences: a receiver may be deaf, and a beacon that nobody
heard may not have spoken (three cases: it spoke only when heard; since it was first heard;
always). Last, with probability ``doubt`` none of this holds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from groundstation.localization.likelihood import path_loss_of_square
from groundstation.localization.problem import FloatArray, SignalModel

_NODES = (-math.sqrt(3.0), 0.0, math.sqrt(3.0))
_NODE_SHARES = (1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0)
_CHUNK = 512
_LOGISTIC = 1.702
_DEEPEST_NULL_DB = -10.0 * math.log10(0.02)
"""As ``likelihood`` has it: no null is empty, with reflections about."""


@dataclass(frozen=True, slots=True, eq=False)
class SilenceField:
    """Log likelihood of boxes given who was silent; callable as a ``Field`` of the belief.

    H heard places, R silent ones, V receivers.
    """

    heard_enu_m: FloatArray
    """(H, 3) where levels were heard."""
    level_dbm: FloatArray
    """(H,) mean level there, less what the model takes off: E[P] and, on NLOS, E[b]."""
    heard_los: FloatArray
    """(H,) P(line of sight) there."""
    heard_precision: FloatArray
    """(H,) 1/dB²: inverse variance of such a level about the model's, times its own share of evidence."""
    silent_enu_m: FloatArray
    """(R, 3) where nothing was heard."""
    receiver: Any
    """(R,) int: whose silence, 0 … V−1."""
    sensitivity_dbm: FloatArray
    """(R,) S_i."""
    missed: FloatArray
    """(3, R) m_i in each of the three cases; 1 where the silence does not count in the case."""
    cases: FloatArray
    """(3,) their probabilities."""
    share: FloatArray
    """(R,) of independent evidence in each silence."""
    deaf: FloatArray
    """(V,) P(the receiver hears nothing at all)."""
    power_mean_dbm: float
    power_std_db: float
    los_exponent: float
    exponent_mean: float
    exponent_std: float
    bias_db: float
    """E[b] of an NLOS link."""
    softness_db: float
    """τ."""
    doubt: float
    null_mean: float
    """E[g]: order of the antennas' null overhead."""
    null_std: float

    def __call__(self, center_enu_m: FloatArray, half_m: FloatArray) -> FloatArray:
        """(C,) log P(silences | x), 0 where they say nothing, never under log ``doubt``."""
        del half_m  # Hearing changes over tens of metres, wider boxes are weighed at their centre.
        parts = [
            self._at(center_enu_m[first : first + _CHUNK])
            for first in range(0, center_enu_m.shape[0], _CHUNK)
        ]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _at(self, places: FloatArray) -> FloatArray:
        power, exponent, covariance = self._power_and_exponent(places)
        path, null = _losses(self.silent_enu_m, places, self._has_null)
        margin = self.power_mean_dbm + power - exponent * path - self.bias_db
        margin -= self.sensitivity_dbm[:, None]
        softness: FloatArray | float = self.softness_db
        if self._has_null:
            margin -= self.null_mean * null
            softness = np.sqrt(self.softness_db**2 + np.square(self.null_std * null))
        spread = np.sqrt(
            np.maximum(covariance[0] - 2.0 * covariance[1] * path + covariance[2] * path * path, 0.0)
        )
        likelihood = np.zeros(places.shape[0])
        used = [case for case in range(3) if self.cases[case] > 0.0]
        for node, node_share in zip(_NODES, _NODE_SHARES, strict=True):
            # Φ(z) as a logistic function, to a hundredth: NumPy has a vector loop for exp, none for erf.
            audible = 1.0 / (1.0 + np.exp((margin + node * spread) * (-_LOGISTIC / softness)))
            for case in used:
                caught = (1.0 - self.missed[case])[:, None] * audible
                log_silent = self.share[:, None] * np.log(1.0 - caught)
                likelihood += node_share * self.cases[case] * self._over_receivers(log_silent)
        result: FloatArray = np.log(self.doubt + (1.0 - self.doubt) * likelihood)
        return result

    @property
    def _has_null(self) -> bool:
        return self.null_mean != 0.0 or self.null_std > 0.0

    def _over_receivers(self, log_silent: FloatArray) -> FloatArray:
        """(R, C) → (C,): the product, each receiver's silence as a whole no less likely than its deafness."""
        product = np.ones(log_silent.shape[1])
        for receiver, deaf in enumerate(self.deaf):
            mine = np.flatnonzero(self.receiver == receiver)
            total = np.zeros(log_silent.shape[1])
            # Row by row: the same sums whatever the number of places.
            for row in mine:
                total += log_silent[row]
            product *= deaf + (1.0 - deaf) * np.exp(total)
        return product

    def _power_and_exponent(
        self, places: FloatArray
    ) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
        """Posterior mean of P − E[P] and of β_NLOS at places (C,), and their covariance (PP, Pβ, ββ)."""
        count = places.shape[0]
        pp = np.full(count, 1.0 / max(self.power_std_db, 0.1) ** 2)
        pe, ee = np.zeros(count), np.full(count, 1.0 / max(self.exponent_std, 0.01) ** 2)
        right_p, right_e = np.zeros(count), ee * self.exponent_mean
        path, null = _losses(self.heard_enu_m, places, self._has_null)
        for row in range(self.level_dbm.size):
            weight: Any = self.heard_precision[row]
            los = self.heard_los[row]
            level = self.level_dbm[row] + los * self.los_exponent * path[row]
            if self._has_null:
                level = level + self.null_mean * null[row]
                weight = weight / (1.0 + weight * np.square(self.null_std * null[row]))
            slope = -(1.0 - los) * path[row]
            pp += weight
            pe += weight * slope
            ee += weight * slope * slope
            right_p += weight * level
            right_e += weight * slope * level
        determinant = pp * ee - pe * pe
        covariance = ee / determinant, -pe / determinant, pp / determinant
        power = covariance[0] * right_p + covariance[1] * right_e
        exponent = covariance[1] * right_p + covariance[2] * right_e
        return power, exponent, covariance

    def resembles(self, other: SilenceField) -> bool:
        """Whether it says the same of every place, but for hundredths."""
        if self.missed.shape != other.missed.shape or self.level_dbm.shape != other.level_dbm.shape:
            return False
        return all(
            np.allclose(getattr(self, name), getattr(other, name), rtol=0.0, atol=tolerance)
            for name, tolerance in (
                ("silent_enu_m", 1.0), ("missed", 0.02), ("cases", 0.02), ("deaf", 0.02), ("share", 0.05),
                ("sensitivity_dbm", 0.5), ("heard_enu_m", 1.0), ("level_dbm", 0.5), ("heard_los", 0.05),
            )
        )  # fmt: skip

    def state(self) -> dict[str, Any]:
        """Everything, as arrays and plain values."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}

    @classmethod
    def restore(cls, tree: Mapping[str, Any]) -> SilenceField:
        """The reverse of ``state``."""
        values: dict[str, Any] = {}
        for entry in fields(cls):
            kept = tree[entry.name]
            if entry.name == "receiver":
                values[entry.name] = np.array(kept, dtype=np.int64)
            elif entry.type == "float":
                values[entry.name] = float(kept)
            else:
                values[entry.name] = np.array(kept, dtype=np.float64)
        for name in ("heard_enu_m", "silent_enu_m"):
            values[name] = values[name].reshape(-1, 3)
        values["missed"] = values["missed"].reshape(3, -1)
        return cls(**values)


def _losses(vehicle_enu_m: FloatArray, places: FloatArray, null: bool) -> tuple[FloatArray, FloatArray]:
    """10 log₁₀ of the distances and the loss in a null of order 1 overhead, (n, C) each, dB.

    Element by element, unlike ``likelihood``'s products of matrices: a belief asks for its boxes in
    portions, and their numbers must not depend on the portion.
    """
    square = np.square(places[None, :, 0] - vehicle_enu_m[:, 0, None])
    square += np.square(places[None, :, 1] - vehicle_enu_m[:, 1, None])
    flat = path_loss_of_square(square.copy()) if null else np.zeros(0)
    square += np.square(places[None, :, 2] - vehicle_enu_m[:, 2, None])
    path = path_loss_of_square(square)
    return path, np.minimum(2.0 * (path - flat), _DEEPEST_NULL_DB) if null else flat


def softness_db(model: SignalModel, sensitivity_std_db: float) -> float:
    """τ: what is unknown of one silent link besides what all links share, dB."""
    return math.sqrt(
        model.nlos_rss_std_db**2
        + model.nlos_bias_max_db**2 / 12.0
        + model.receiver_offset_std_db**2
        + sensitivity_std_db**2
    )


def shares(enu_m: FloatArray, receiver: Any, correlation_m: float, shared: float) -> FloatArray:
    """(n,) 1/(1 + Σ ρ_ij): each place's share of independent evidence, shadowing being what it has in
    common with the others: exp(−Δ/``correlation_m``), times ``shared`` between two receivers."""
    gap = np.sqrt(np.square(enu_m[:, None] - enu_m[None]).sum(axis=-1))
    alike = np.where(receiver[:, None] == receiver[None], 1.0, shared) * np.exp(-gap / correlation_m)
    result: FloatArray = 1.0 / np.maximum(alike.sum(axis=1), 1.0)
    return result
