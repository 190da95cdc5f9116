"""The regression at every candidate with its Gaussian unknowns at their best: what is left is β_NLOS.

Exists apart from ``regression``, which adds up rows, because this is asked for once an update and kept:
what it says of a place is what the next windows are judged by. Rule: β_LOS and the order of the antennas'
null are integrated in closed form, β_NLOS over a few nodes laid where its likelihood is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri

from groundstation.localization.problem import FloatArray, SignalModel

_NODES = 5
_MIDDLES = (np.arange(_NODES)[:, None] + 0.5).astype(np.float64)
_REACH = 3.2
"""Nodes over β_NLOS reach to so many standard deviations: 1.3 apart, where the midpoint rule errs by 1e-5."""
_STEEP = 1.5
_DOUBTS = 4.0
"""β_NLOS is followed beyond its limits until its prior has fallen by e⁻⁴."""
_LEAST_CURVE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The regression at C candidates with its Gaussian unknowns at their best: a form in β_NLOS.

    ``constant`` + 2 ``slope`` β_NLOS + ``curve`` β_NLOS², each (C,).
    """

    prior: SignalModel
    count: int
    """Rows taken in."""
    whitener: FloatArray
    """(1 + V, 1 + V) inverse of the Cholesky factor of the precision of power and offsets."""
    constant: FloatArray
    slope: FloatArray
    curve: FloatArray
    log_spread: FloatArray
    """(C,) half the log determinant that integrating β_LOS and the null's order out costs."""
    los: tuple[FloatArray, FloatArray]
    """Mean of β_LOS: intercept (C,) and slope (C,) on β_NLOS."""
    null: tuple[FloatArray, FloatArray]
    """The same of the order of the antennas' null."""

    @classmethod
    def of(
        cls, prior: SignalModel, count: int, whitener: FloatArray, constant: float, terms: FloatArray
    ) -> Solved:
        """From the quadratic form of ``count`` rows without power and offsets: ``constant``, and ``terms``
        (9, C), cross terms and squares as ``Evidence`` orders them."""
        # In prior standard deviations u: form + u² = a + 2 b β + c β² + 2 u (k₀ + k₁ β) + u² w.
        a, b, c, f0, f1, fw, g0, g1, gw, both = _about_prior(prior) @ terms
        fw += 1.0
        # β_LOS (f) goes first, then the null's order (g).
        share, f0_of, f1_of = both / fw, f0 / fw, f1 / fw
        g0 -= share * f0
        g1 -= share * f1
        gw += 1.0 - share * both
        g0_of, g1_of = g0 / gw, g1 / gw
        a += constant
        a -= f0_of * f0
        a -= g0_of * g0
        b -= f0_of * f1
        b -= g0_of * g1
        c -= f1_of * f1
        c -= g1_of * g1
        std = prior.los_exponent_std, prior.antenna_null_std
        return cls(
            prior, count, whitener, a, b, np.maximum(c, _LEAST_CURVE), 0.5 * np.log(fw * gw),
            (prior.los_exponent + std[0] * (share * g0_of - f0_of), std[0] * (share * g1_of - f1_of)),
            (prior.antenna_null_mean - std[1] * g0_of, -std[1] * g1_of),
        )  # fmt: skip

    def log_likelihood(self, noise_degrees: float | None) -> FloatArray:
        """(C,) of the powers; see ``Evidence.log_likelihood``."""
        nodes, width = self._nlos_nodes(noise_degrees)
        form = nodes * self.curve
        form += 2.0 * self.slope
        form *= nodes
        form += self.constant
        score = log_density(form, self.count, noise_degrees)
        if self.prior.nlos_exponent_doubt > 0.0:
            score += _log_prior_of_nlos_exponent(nodes, self.prior)
        return log_sum(score) + np.log(width) - self.log_spread

    def means_at(self, cell: int) -> tuple[float, float, float]:
        """Posterior mean of β_LOS, β_NLOS and the order of the antennas' null at one candidate."""
        nodes, _, score = self._of_nodes(slice(cell, cell + 1))
        weight = np.exp(score - score.max())
        mean = float((weight * nodes).sum() / weight.sum())
        los, null = ((float(part[0][cell]), float(part[1][cell])) for part in (self.los, self.null))
        return los[0] + los[1] * mean, mean, null[0] + null[1] * mean

    def orders_drawn(self, uniform: FloatArray) -> FloatArray:
        """See ``Evidence.orders_drawn``."""
        nodes, width, score = self._of_nodes(slice(None))
        reached = np.cumsum(np.exp(score - score.max(axis=0)), axis=0)
        node = np.argmax(reached >= uniform[0] * reached[-1], axis=0)
        nlos = nodes[node, np.arange(node.size)]
        if len(nodes) > 1:
            nlos = nlos + width * (uniform[1] - 0.5)
        return np.stack([self.los[0] + self.los[1] * nlos, nlos, self.null[0] + self.null[1] * nlos])

    def _of_nodes(self, cells: slice) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Nodes of β_NLOS at some candidates, how far apart, and their log posterior at the model's noise."""
        nodes, width = self._nlos_nodes(None, cells)
        score = -0.5 * nodes * (2.0 * self.slope[cells] + nodes * self.curve[cells])
        return nodes, width, score + _log_prior_of_nlos_exponent(nodes, self.prior)

    def _nlos_nodes(
        self, noise_degrees: float | None, cells: slice = slice(None)
    ) -> tuple[FloatArray, FloatArray]:
        """(M, C) midpoints over where β_NLOS is likely within its limits, and how far apart they are."""
        prior, slope, curve = self.prior, self.slope[cells], self.curve[cells]
        beyond = math.exp(_DOUBTS * prior.nlos_exponent_doubt)
        low, high = prior.nlos_exponent_min / beyond, prior.nlos_exponent_max * beyond
        if high <= low:
            return np.full((1, slope.size), low), np.ones(slope.size)
        best = -slope / curve
        variance = 1.0 / curve
        if noise_degrees is not None:
            least = np.maximum(self.constant[cells] + slope * best, self.count)
            variance = variance * (noise_degrees + least) / (noise_degrees + self.count)
        std = np.sqrt(variance)
        inside = np.minimum(np.maximum(best, low), high)
        # Beyond a limit the likelihood falls off like an exponential from there.
        reach = _REACH * std / np.maximum(np.abs(best - inside) / (_STEEP * std), 1.0)
        first = np.maximum(inside - reach, low)
        width = (np.minimum(inside + reach, high) - first) / _NODES
        return first + width * _MIDDLES, width


@lru_cache(maxsize=16)
def _about_prior(prior: SignalModel) -> FloatArray:
    """(10, 9) what turns cross terms (3) and squares (6) into the form's terms about the prior's means.

    a, b, c of β_NLOS; of β_LOS, then of the null's order, in prior standard deviations: term, its slope
    on β_NLOS and square; and the product of these two.
    """
    los, null = prior.los_exponent, prior.antenna_null_mean
    f, g = prior.los_exponent_std, prior.antenna_null_std
    # y·LOS, y·NLOS, y·null, LOS·LOS, LOS·NLOS, NLOS·NLOS, LOS·null, NLOS·null, null·null
    return np.array(
        [
            [2.0 * los, 0, 2.0 * null, los**2, 0, 0, 2.0 * los * null, 0, null**2],
            [0, 1, 0, 0, los, 0, 0, null, 0],
            [0, 0, 0, 0, 0, 1, 0, 0, 0],
            [f, 0, 0, f * los, 0, 0, f * null, 0, 0],
            [0, 0, 0, 0, f, 0, 0, 0, 0],
            [0, 0, 0, f * f, 0, 0, 0, 0, 0],
            [0, 0, g, 0, 0, 0, g * los, 0, g * null],
            [0, 0, 0, 0, 0, 0, 0, g, 0],
            [0, 0, 0, 0, 0, 0, 0, 0, g * g],
            [0, 0, 0, 0, 0, 0, f * g, 0, 0],
        ]
    )


def inverse_cholesky(precision: FloatArray) -> FloatArray:
    """Inverse of the lower Cholesky factor."""
    # LAPACK at once: of a matrix as small as this, NumPy's way there costs several times as much.
    factor, failed = dpotrf(precision, lower=1)
    if failed:
        raise np.linalg.LinAlgError("precision is not positive definite")
    inverse: FloatArray = np.ascontiguousarray(dtrtri(factor, lower=1)[0])
    return inverse


def log_density(form: FloatArray, count: int, noise_degrees: float | None) -> FloatArray:
    """Log density of a quadratic form of ``count`` rows, up to a constant.

    Gaussian where the noise is the model's (``noise_degrees`` None). Else the noise may be higher by a
    factor s² ≥ 1, inverse-gamma with so many degrees of freedom, taken at its best value: Gaussian
    up to the form to be expected, a Student-t's tail beyond. Never lower: residuals too small show that
    shadowing is smoother than thought, not that there is less of it.
    """
    if noise_degrees is None:
        return -0.5 * form
    degrees = noise_degrees + count
    beyond = np.maximum(form - count, 0.0)
    beyond /= degrees
    np.log1p(beyond, out=beyond)
    beyond *= -0.5 * degrees
    beyond -= 0.5 * np.minimum(form, count)
    return beyond


def _log_prior_of_nlos_exponent(exponent: FloatArray, prior: SignalModel) -> FloatArray:
    """Log density, up to a constant: even within the limits, beyond them falling with ln β."""
    if prior.nlos_exponent_doubt <= 0.0:
        return np.zeros_like(exponent)
    # Of the two one is 1.
    outside = np.maximum(prior.nlos_exponent_min / exponent, exponent / prior.nlos_exponent_max)
    result: FloatArray = np.log(np.maximum(outside, 1.0)) / -prior.nlos_exponent_doubt
    return result


def log_sum(score: FloatArray) -> FloatArray:
    """Log of the sum of exponentials over the first axis."""
    top = score.max(axis=0)
    result: FloatArray = top + np.log(np.exp(score - top).sum(axis=0))
    return result
