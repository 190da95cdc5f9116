"""Figures of merit of a classifier, without scikit-learn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.channel.calibration import expected_calibration_error


@dataclass(frozen=True, slots=True)
class Figures:
    """How a classifier did on a set of links, LOS being the positive class."""

    links: int
    accuracy: float
    balanced_accuracy: float
    auc: float
    """From probabilities; NaN with one class."""
    ece: float
    """Expected calibration error, 15 bins."""
    nlos_called_los: float
    """Share of NLOS links with P ≥ threshold: the dangerous mistake."""
    los_called_nlos: float


def figures(probability: NDArray[np.float64], is_los: NDArray[np.bool_], threshold: float = 0.5) -> Figures:
    """Figures of (N,) probabilities against (N,) truths."""
    called_los = probability >= threshold
    los, nlos = int(np.count_nonzero(is_los)), int(np.count_nonzero(~is_los))
    false_los = np.count_nonzero(called_los & ~is_los) / nlos if nlos else float("nan")
    missed_los = np.count_nonzero(~called_los & is_los) / los if los else float("nan")
    return Figures(
        links=len(is_los),
        accuracy=float(np.mean(called_los == is_los)) if len(is_los) else float("nan"),
        balanced_accuracy=float(1 - (false_los + missed_los) / 2),
        auc=auc(probability, is_los),
        ece=expected_calibration_error(probability, is_los),
        nlos_called_los=float(false_los),
        los_called_nlos=float(missed_los),
    )


def auc(score: NDArray[np.float64], is_los: NDArray[np.bool_]) -> float:
    """Area under the ROC curve (Mann–Whitney, ties count half)."""
    los, nlos = int(np.count_nonzero(is_los)), int(np.count_nonzero(~is_los))
    if not los or not nlos:
        return float("nan")
    _, place, count = np.unique(score, return_inverse=True, return_counts=True)
    mean_rank = (np.cumsum(count) - (count - 1) / 2)[place]
    return float((mean_rank[is_los].sum() - los * (los + 1) / 2) / (los * nlos))
