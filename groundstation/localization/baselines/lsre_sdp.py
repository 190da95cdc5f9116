"""LSRE–SDP, (62)–(63): ``lsre-sdp`` once at fixed P̂_t and β̂, ``lsre-sdp-iterative`` with (66)–(70).

Exists as the relaxation that the paper compares its own with. Z₄₄ = 1/m_t² is fixed by P̂_t; m_k/m_t
is taken link by link, since after (68) the β̂_k differ. With the two ends of the bias interval
each other's inverse the program is min Σ g_k [1/q_k + q_k], q_k = c_k² tr(C_k Z), Z ⪰ 0
(``lsre_terms``). Rule: heights and search area bound the recovered place (63) as they do in the
paper's own program, so that the comparison is fair; without them, and with Z₄₄ free as (62) is
printed, the scale of the place is free too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from groundstation.localization.alternation import alternate
from groundstation.localization.baselines.lifting import lifted_constraints, lifted_start, relative_squares
from groundstation.localization.batch import Answers, Batch
from groundstation.localization.interior import minimise
from groundstation.localization.lsre_terms import log_end_weights, log_gains, weighted_centroid
from groundstation.localization.problem import FloatArray
from groundstation.localization.region import Region


@dataclass(frozen=True, slots=True, eq=False)
class LsreLifted:
    """Σ g_k [1/q_k + q_k] over scaled (x, s)."""

    slope: FloatArray
    """(N, K, 4): of q_k."""
    offset: FloatArray
    """(N, K): of q_k."""
    weight: FloatArray
    """(N, K): g_k over a number of the problem's own."""

    def evaluate(self, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value (inf where a q_k is not positive), gradient, Hessian."""
        q = np.matmul(self.slope, y[:, :, None])[:, :, 0] + self.offset
        bad = q.min(axis=1) <= 0.0
        inverse = 1.0 / np.where(q > 0.0, q, 1.0)
        value = (self.weight * (inverse + q)).sum(axis=1)
        gradient = np.matmul((self.weight * (1.0 - inverse * inverse))[:, None, :], self.slope)[:, 0]
        bend = (2.0 * self.weight * inverse**3)[:, :, None] * self.slope
        return np.where(bad, np.inf, value), gradient, np.matmul(np.swapaxes(bend, 1, 2), self.slope)

    def rows(self, chosen: Any) -> LsreLifted:
        """The problems that ``chosen`` selects."""
        return LsreLifted(self.slope[chosen], self.offset[chosen], self.weight[chosen])


def lsre_sdp_program(
    batch: Batch, region: Region, power_dbm: FloatArray, exponent: FloatArray
) -> tuple[LsreLifted, FloatArray, FloatArray]:
    """The program of (62), a start (N, 4) strictly inside, and the scale (N,) of its objective in (62)'s."""
    slope, offset = relative_squares(batch, region, log_gains(batch, power_dbm, exponent))
    start = lifted_start(batch, region, batch.area.clip(weighted_centroid(batch, power_dbm, exponent)))
    log_weight = log_end_weights(batch, exponent)
    q = np.matmul(slope, start[:, :, None])[:, :, 0] + offset
    scale = (np.exp(log_weight) * (1.0 / q + q)).sum(axis=1)
    return LsreLifted(slope, offset, np.exp(log_weight) / scale[:, None]), start, scale


def lsre_sdp_positions(batch: Batch, power_dbm: FloatArray, exponent: FloatArray) -> FloatArray:
    """(N, 3) metres: (63) of the optimum of (62) at P̂_t (N,) and β̂ (N, K)."""
    region = Region.of(batch.area)
    program, start, _ = lsre_sdp_program(batch, region, power_dbm, exponent)
    found = minimise(program, lifted_constraints(region), start, centred=True)
    return batch.area.clip(region.metres(found.y[:, :3]))


def lsre_sdp(batch: Batch) -> Answers:
    """(62)–(63) at the first P̂_t and β̂."""
    power, exponent = batch.first_power_dbm(), batch.first_exponents()
    return Answers.closed_form(batch, lsre_sdp_positions(batch, power, exponent), power, exponent)


def lsre_sdp_iterative(batch: Batch) -> Answers:
    """(62)–(63) and (66)–(70) in turn with the paper's stopping rules."""
    return alternate(batch, lsre_sdp_positions)
