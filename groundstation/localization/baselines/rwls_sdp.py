"""Iterative robust WLS–SDP (``rwls-sdp``), as the paper's NLOS benchmark; written out, as it is not there.

Exists for comparison. With q_k = c_k² tr(C_k Z): min Σ w_k max over e ∈ R_k of (e² q_k − 1)², Z ⪰ 0,
Z₄₄ = 1 (in units of 1/m_t²), w_k = 1 − d̂_k/Σ d̂ with d̂_k = 1/c_k, the distance that the power tells;
then P̂_t and β̂ by (67) and (68), without the relaxation (70), and again. As Σ w_k r_k² over
r_k ≥ 1 − e̲² q_k and r_k ≥ ē² q_k − 1 it is a quadratic program in (x, s, r) with the one
constraint of the lifting. Rule: heights and search area bound the recovered place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from groundstation.localization.alternation import alternate
from groundstation.localization.baselines.lifting import lifted_constraints, lifted_start, relative_squares
from groundstation.localization.batch import Answers, Batch
from groundstation.localization.interior import Constraints, minimise
from groundstation.localization.lsre_terms import log_gains, log_interval_end, weighted_centroid
from groundstation.localization.problem import FloatArray
from groundstation.localization.region import Region


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Σ w_k r_k² over y = (x, s, r)."""

    weight: FloatArray
    """(N, K): w_k."""

    def evaluate(self, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value, gradient, Hessian."""
        count, unknowns = y.shape
        pull = self.weight * y[:, 4:]
        gradient, hessian = np.zeros((count, unknowns)), np.zeros((count, unknowns, unknowns))
        gradient[:, 4:] = 2.0 * pull
        diagonal = np.arange(4, unknowns)
        hessian[:, diagonal, diagonal] = 2.0 * self.weight
        return (pull * y[:, 4:]).sum(axis=1), gradient, hessian

    def rows(self, chosen: Any) -> Residuals:
        """The problems that ``chosen`` selects."""
        return Residuals(self.weight[chosen])


def rwls_sdp_program(
    batch: Batch, region: Region, power_dbm: FloatArray, exponent: FloatArray
) -> tuple[Residuals, Constraints, FloatArray]:
    """Objective, constraints and a start (N, 4 + K) strictly inside."""
    count, links = exponent.shape
    log_gain = log_gains(batch, power_dbm, exponent)
    distance = np.exp(log_gain.min(axis=1, keepdims=True) - log_gain)
    weight = 1.0 - distance / distance.sum(axis=1, keepdims=True)
    slope, offset = relative_squares(batch, region, log_gain)
    high = np.exp(2.0 * log_interval_end(batch, exponent))
    lifted = lifted_constraints(region, 4 + links)
    fixed = len(lifted.offset)
    a, b = np.zeros((count, fixed + 2 * links, 4 + links)), np.zeros((count, fixed + 2 * links))
    a[:, :fixed], b[:, :fixed] = lifted.slope, lifted.offset
    one = np.arange(links)
    for first, sign, factor in ((fixed, 1.0, 1.0 / high), (fixed + links, -1.0, high)):
        a[:, first + one, 4 + one] = 1.0
        a[:, first : first + links, :4] = sign * factor[..., None] * slope
        b[:, first : first + links] = sign * (factor * offset - 1.0)
    bend = np.concatenate([lifted.curvature, np.zeros((2 * links, 4 + links))])
    program = Constraints(b, a, bend, np.append(lifted.weight, np.ones(2 * links)))
    place = lifted_start(batch, region, batch.area.clip(weighted_centroid(batch, power_dbm, exponent)))
    q = np.matmul(slope, place[:, :, None])[:, :, 0] + offset
    residual = 1.1 * np.maximum(np.abs(q / high - 1.0), np.abs(q * high - 1.0)) + 0.1
    return Residuals(weight), program, np.concatenate([place, residual], axis=1)


def rwls_sdp_positions(batch: Batch, power_dbm: FloatArray, exponent: FloatArray) -> FloatArray:
    """(N, 3) metres: the place of the optimum at P̂_t (N,) and β̂ (N, K)."""
    region = Region.of(batch.area)
    found = minimise(*rwls_sdp_program(batch, region, power_dbm, exponent), centred=True)
    return batch.area.clip(region.metres(found.y[:, :3]))


def rwls_sdp(batch: Batch) -> Answers:
    """The program, (67) and (68) in turn with the paper's stopping rules."""
    return alternate(batch, rwls_sdp_positions, relaxation=1.0)
