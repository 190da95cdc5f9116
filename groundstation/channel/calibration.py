"""From the network's logit to a probability one may bet on.

Why: localisation weighs links by P(line of sight) as it is. Scale and offset of the logit
(Platt 1999; temperature scaling of Guo et al., ICML 2017, with an offset) are fitted on links
held out from training; neither can change the order of links, so that no figure of merit but
calibration and the balance of the two mistakes moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_TEMPERATURE_MIN, _TEMPERATURE_MAX = 0.05, 20.0


@dataclass(frozen=True, slots=True)
class Calibration:
    """P(line of sight) = σ(logit / temperature + bias)."""

    temperature: float = 1.0
    """> 1 softens an overconfident network."""
    bias: float = 0.0
    """> 0 where the network says LOS too rarely."""

    def probability(self, logit: NDArray[np.float64]) -> NDArray[np.float64]:
        """Elementwise, without overflow."""
        return 0.5 * (1 + np.tanh(0.5 * (logit / self.temperature + self.bias)))


def fit_calibration(
    logit: NDArray[np.float64], is_los: NDArray[np.bool_], weight: NDArray[np.float64] | None = None
) -> Calibration:
    """Temperature (0.05…20) and bias that minimise the weighted cross-entropy of (N,) logits.

    Newton's method on slope and offset, with so much of a prior (a slope of one, no offset,
    each as sure as one link) that separable or few links do not run away.
    """
    weight = np.ones(len(logit)) if weight is None else weight
    design = np.stack([logit, np.ones(len(logit))])
    prior = np.array([1.0, 0.0])

    def loss(slope: float, offset: float) -> float:
        sign = np.where(is_los, 1.0, -1.0)
        value = weight @ np.logaddexp(0, -sign * (slope * logit + offset))
        return float(value + 0.5 * ((slope - 1) ** 2 + offset**2))

    parameters = prior.copy()
    for _ in range(100):
        probability = Calibration(1.0, 0.0).probability(parameters @ design)
        gradient = design @ (weight * (probability - is_los)) + (parameters - prior)
        curvature = (design * (weight * probability * (1 - probability))) @ design.T + np.eye(2)
        step = np.linalg.solve(curvature, gradient)
        size = 1.0
        while size > 1e-6 and loss(*(parameters - size * step)) > loss(*parameters):
            size *= 0.5
        parameters = parameters - size * step
        if float(np.abs(size * step).max()) < 1e-9:
            break
    temperature = float(np.clip(1 / max(parameters[0], 1e-9), _TEMPERATURE_MIN, _TEMPERATURE_MAX))
    return Calibration(temperature=temperature, bias=float(parameters[1]))


def even_weights(is_los: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(N,) weights under which LOS and NLOS are equally frequent; they sum to N."""
    los = max(int(np.count_nonzero(is_los)), 1)
    nlos = max(int(np.count_nonzero(~is_los)), 1)
    return np.where(is_los, 0.5 * len(is_los) / los, 0.5 * len(is_los) / nlos)


def expected_calibration_error(
    probability: NDArray[np.float64], is_los: NDArray[np.bool_], bins: int = 15
) -> float:
    """ECE: mean gap between P and the share of LOS in equal-width bins, weighted by their counts."""
    index = np.minimum((probability * bins).astype(np.int64), bins - 1)
    count = np.bincount(index, minlength=bins)
    gap = np.bincount(index, weights=probability - is_los, minlength=bins)
    return float(np.sum(np.abs(gap)) / max(int(count.sum()), 1))
