"""From the network's logit to a probability one may bet on.

Why: localisation weighs links by P(line of sight) as it is. Temperature scaling (Guo et al.,
ICML 2017) is one number fitted on links held out from training; it cannot change the order of
links, so that no figure of merit but calibration moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Calibration:
    """P(line of sight) = σ(logit / temperature)."""

    temperature: float = 1.0
    """> 1 softens an overconfident network."""

    def probability(self, logit: NDArray[np.float64]) -> NDArray[np.float64]:
        """Elementwise, without overflow."""
        return 0.5 * (1 + np.tanh(0.5 * logit / self.temperature))


def fit_temperature(logit: NDArray[np.float64], is_los: NDArray[np.bool_]) -> Calibration:
    """The temperature in 0.05…20 that minimises the cross-entropy of (N,) logits (golden section)."""
    sign = np.where(is_los, 1.0, -1.0)

    def loss(log_temperature: float) -> float:
        return float(np.mean(np.logaddexp(0, -sign * logit / np.exp(log_temperature))))

    low, high = float(np.log(0.05)), float(np.log(20.0))
    ratio = (np.sqrt(5) - 1) / 2
    for _ in range(60):
        left, right = high - ratio * (high - low), low + ratio * (high - low)
        if loss(left) < loss(right):
            high = right
        else:
            low = left
    return Calibration(temperature=float(np.exp(0.5 * (low + high))))


def expected_calibration_error(
    probability: NDArray[np.float64], is_los: NDArray[np.bool_], bins: int = 15
) -> float:
    """ECE: mean gap between P and the share of LOS in equal-width bins, weighted by their counts."""
    index = np.minimum((probability * bins).astype(np.int64), bins - 1)
    count = np.bincount(index, minlength=bins)
    gap = np.bincount(index, weights=probability - is_los, minlength=bins)
    return float(np.sum(np.abs(gap)) / max(int(count.sum()), 1))
