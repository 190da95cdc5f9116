"""Figures of merit of a classifier, without scikit-learn. LOS is the positive class."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.channel.calibration import expected_calibration_error

RELIABILITY_BINS = 15


@dataclass(frozen=True, slots=True)
class Figures:
    """How a classifier did on a set of links."""

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
    precision: float = float("nan")
    """Of the links called LOS, the share that is; NaN where none is called LOS."""
    recall: float = float("nan")
    """Of the LOS links, the share called LOS."""
    f1: float = float("nan")
    auc_hard: float = float("nan")
    """Area under the ROC of the decisions alone (one point): equals the balanced accuracy. What the
    paper's table seems to give for RF, GPC and SVM."""


@dataclass(frozen=True, slots=True)
class Confusion:
    """Counts at one threshold."""

    los_called_los: int
    los_called_nlos: int
    nlos_called_los: int
    nlos_called_nlos: int


def confusion(
    probability: NDArray[np.float64], is_los: NDArray[np.bool_], threshold: float = 0.5
) -> Confusion:
    """Of (N,) probabilities against (N,) truths; P ≥ threshold is called LOS."""
    called = probability >= threshold
    return Confusion(
        los_called_los=int(np.count_nonzero(called & is_los)),
        los_called_nlos=int(np.count_nonzero(~called & is_los)),
        nlos_called_los=int(np.count_nonzero(called & ~is_los)),
        nlos_called_nlos=int(np.count_nonzero(~called & ~is_los)),
    )


def figures(probability: NDArray[np.float64], is_los: NDArray[np.bool_], threshold: float = 0.5) -> Figures:
    """Figures of (N,) probabilities against (N,) truths."""
    counts = confusion(probability, is_los, threshold)
    los = counts.los_called_los + counts.los_called_nlos
    nlos = counts.nlos_called_los + counts.nlos_called_nlos
    recall = _ratio(counts.los_called_los, los)
    precision = _ratio(counts.los_called_los, counts.los_called_los + counts.nlos_called_los)
    false_los = _ratio(counts.nlos_called_los, nlos)
    missed_los = _ratio(counts.los_called_nlos, los)
    return Figures(
        links=len(is_los),
        accuracy=_ratio(counts.los_called_los + counts.nlos_called_nlos, len(is_los)),
        balanced_accuracy=1 - (false_los + missed_los) / 2,
        auc=auc(probability, is_los),
        ece=expected_calibration_error(probability, is_los),
        nlos_called_los=false_los,
        los_called_nlos=missed_los,
        precision=precision,
        recall=recall,
        f1=_ratio(2 * counts.los_called_los, los + counts.los_called_los + counts.nlos_called_los),
        auc_hard=auc((probability >= threshold).astype(np.float64), is_los),
    )


def auc(score: NDArray[np.float64], is_los: NDArray[np.bool_]) -> float:
    """Area under the ROC curve (Mann–Whitney, ties count half)."""
    los, nlos = int(np.count_nonzero(is_los)), int(np.count_nonzero(~is_los))
    if not los or not nlos:
        return float("nan")
    _, place, count = np.unique(score, return_inverse=True, return_counts=True)
    mean_rank = (np.cumsum(count) - (count - 1) / 2)[place]
    return float((mean_rank[is_los].sum() - los * (los + 1) / 2) / (los * nlos))


def roc(
    score: NDArray[np.float64], is_los: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(share of NLOS called LOS, share of LOS called LOS) over all thresholds, from (0, 0) to (1, 1)."""
    order = np.argsort(-score, kind="stable")
    last_of_tie = np.flatnonzero(np.append(np.diff(score[order]) != 0, True))
    hits = np.cumsum(is_los[order])[last_of_tie]
    false_alarms = last_of_tie + 1 - hits
    return (
        np.append(0.0, false_alarms / max(int(np.count_nonzero(~is_los)), 1)),
        np.append(0.0, hits / max(int(np.count_nonzero(is_los)), 1)),
    )


def reliability(
    probability: NDArray[np.float64], is_los: NDArray[np.bool_], bins: int = RELIABILITY_BINS
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """(mean P, share of LOS, count) in each bin of equal width that is not empty."""
    index = np.minimum((probability * bins).astype(np.int64), bins - 1)
    count = np.bincount(index, minlength=bins)
    kept = count > 0
    mean = np.bincount(index, weights=probability, minlength=bins)[kept] / count[kept]
    share = np.bincount(index, weights=is_los.astype(np.float64), minlength=bins)[kept] / count[kept]
    return mean, share, count[kept]


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
