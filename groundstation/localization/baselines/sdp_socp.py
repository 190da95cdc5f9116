"""``sdp-socp``: the SDP/SOCP hybrid on LOS links at a fixed transmit power.

Exists as the paper's comparison (Gao & Sadjadpour, 2026, Section V-C); reconstructed from the
literature as

    min Σ w_k [(λ_k r_k − η)²/η² + ((c_kᵀ(x − a_k))² + (k_kᵀ(x − a_k))²)/r̂_k²]
    s.t. ‖x − a_k‖ ≤ r_k,  r_k² ≤ g_k,  g_k = tr X − 2 a_kᵀx + ‖a_k‖²,  [X x; xᵀ 1] ⪰ 0,

with η at P̂_t = 15 dBm (``first_transmit_power_dbm``, or the known power) and r̂_k = η/λ_k.

What it reduces to: X enters the g_k only, by its trace, and X = xxᵀ + tI is feasible for every
t ≥ 0 at no cost, so that r_k² ≤ g_k = ‖x − a_k‖² + 3t never binds. What is left of the
semidefinite part is r_k ≥ d_k = ‖x − a_k‖; the best r_k is max(d_k, r̂_k), and the program is

    min over x of Σ w_k [(d_k/r̂_k − 1)₊² + ((c_kᵀ(x − a_k))² + (k_kᵀ(x − a_k))²)/r̂_k²],

convex and once differentiable: a distance longer than its range costs, a shorter one is free. The
criterion weighs a relative range error (0.46 at 5 dB) like an angle in radians (0.017 at 1°).
Rule: solved as that, by a semismooth Newton method with a line search, batched; the tests set
it against the full program in a conic solver.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.localization.baselines.ranges import Ranges
from groundstation.localization.batch import Answers, Batch
from groundstation.localization.problem import FloatArray

_ROUNDS = 60
_HALVINGS = 30
_TOLERANCE = 1e-9
_RIDGE = 1e-12
_NEAREST_M = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class _Cost:
    """The reduced objective of N problems, about a start each."""

    place: FloatArray
    """(N, K, 3) vehicles less the start, metres."""
    weight: FloatArray
    """(N, K) w_k."""
    reach_m: FloatArray
    """(N, K) r̂_k."""
    across: FloatArray
    """(N, 2K, 3) weighted rows of the angle terms."""
    offset: FloatArray
    """(N, 2K) their right sides."""

    def rows(self, chosen: Any) -> _Cost:
        return _Cost(
            self.place[chosen], self.weight[chosen], self.reach_m[chosen], self.across[chosen],
            self.offset[chosen],
        )  # fmt: skip

    def value(self, step: FloatArray) -> FloatArray:
        gap = np.linalg.norm(step[:, None] - self.place, axis=2)
        excess = np.maximum(gap / self.reach_m - 1.0, 0.0)
        miss = np.einsum("nmi,ni->nm", self.across, step) - self.offset
        result: FloatArray = (self.weight * excess**2).sum(axis=1) + (miss**2).sum(axis=1)
        return result

    def slopes(self, step: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Half the gradient (N, 3) and half the generalised Hessian (N, 3, 3)."""
        away = step[:, None] - self.place
        gap = np.maximum(np.linalg.norm(away, axis=2), _NEAREST_M)
        over = gap / self.reach_m
        active = over > 1.0
        unit = away / gap[..., None]
        miss = np.einsum("nmi,ni->nm", self.across, step) - self.offset
        pull = np.where(active, self.weight * (over - 1.0) / self.reach_m, 0.0)
        gradient = np.einsum("nmi,nm->ni", self.across, miss) + np.einsum("nk,nki->ni", pull, unit)
        stiff = np.where(active, self.weight / self.reach_m**2, 0.0)
        bent = np.where(active, stiff * (1.0 - 1.0 / over), 0.0)
        hessian = np.swapaxes(self.across, 1, 2) @ self.across
        ridge = _RIDGE * np.einsum("nii->n", hessian) + bent.sum(axis=1)
        hessian = hessian + np.einsum("nk,nki,nkj->nij", stiff - bent, unit, unit)
        hessian += ridge[:, None, None] * np.eye(3)
        return gradient, hessian


def sdp_socp(batch: Batch) -> Answers:
    """``sdp-socp`` on the LOS-labelled links with angles of each problem (two or more)."""
    ranges = Ranges.of(batch)
    power = batch.first_power_dbm()
    reach = np.where(ranges.used, ranges.level(batch, power)[:, None] / ranges.gain, 1.0)
    # Where nothing decides (parallel bearings), the answer stays by what range and bearing say.
    start = np.einsum("nk,nki->ni", ranges.weight, batch.place + reach[..., None] * ranges.bearing)
    start /= ranges.weight.sum(axis=1)[:, None]
    step, rounds = _minimum(_cost(batch.place - start[:, None], ranges, reach))
    status = ["ok" if count < _ROUNDS else "iteration limit" for count in rounds.tolist()]
    return Answers(start + step, power, batch.first_exponents(), rounds, status)


def _cost(place: FloatArray, ranges: Ranges, reach: FloatArray) -> _Cost:
    root = np.sqrt(ranges.weight) / reach
    across = ranges.across * root[:, None, :, None]
    offset = np.einsum("nski,nki->nsk", across, place)
    size = len(place)
    return _Cost(place, ranges.weight, reach, across.reshape(size, -1, 3), offset.reshape(size, -1))


def _minimum(cost: _Cost) -> tuple[FloatArray, NDArray[np.int64]]:
    """Newton steps (N, 3) from each start to the minimum, and the rounds taken (N,)."""
    size = len(cost.place)
    answer = np.zeros((size, 3))
    rounds = np.full(size, _ROUNDS)
    rows = np.arange(size)
    step = np.zeros((size, 3))
    value = cost.value(step)
    for number in range(_ROUNDS):
        gradient, hessian = cost.slopes(step)
        move = -np.linalg.solve(hessian, gradient[..., None])[..., 0]
        slope = 2.0 * np.einsum("ni,ni->n", gradient, move)
        scale = np.ones(len(rows))
        trial = step + move
        tried = cost.value(trial)
        for _ in range(_HALVINGS):
            short = tried > value + 1e-4 * scale * slope + 1e-14 * value
            if not short.any():
                break
            scale[short] *= 0.5
            trial = step + scale[:, None] * move
            tried = cost.value(trial)
        step, value = trial, tried
        answer[rows] = step
        done = np.abs(move).max(axis=1) <= _TOLERANCE * (1.0 + np.abs(step).max(axis=1))
        if done.any():
            rounds[rows[done]] = number + 1
            going = np.flatnonzero(~done)
            if not going.size:
                break
            rows, step, value, cost = rows[going], step[going], value[going], cost.rows(going)
    return answer, rounds
