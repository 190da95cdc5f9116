"""Figures of an exported network on links it did not see, with intervals.

Rules kept here: through the service's own code, not torch; intervals by resampling whole groups
(a log is one channel, and its links say the same thing many times).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.channel.calibration import Calibration, even_weights
from groundstation.channel.classifier import Classifier
from groundstation.channel.training.data import LinkData
from groundstation.channel.training.metrics import Confusion, Figures, auc, confusion, figures

BANDWIDTH_BANDS_MHZ = ((0, 50), (50, 150), (150, 450), (450, 1001))
CAUTIOUS_THRESHOLD = 0.75
"""Least expected cost where a NLOS called LOS costs three times the opposite: t = 3 / (3 + 1)."""
_DRAWS = 200


@dataclass(frozen=True, slots=True)
class Interval:
    """95 % percentile interval of a bootstrap over groups; NaN where there are too few groups."""

    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Figures on one set of links."""

    title: str
    figures: Figures
    """At P ≥ 0.5."""
    cautious: Figures
    """At P ≥ CAUTIOUS_THRESHOLD."""
    groups: int
    auc_interval: Interval
    balanced_interval: Interval
    ece_even: float
    """ECE with LOS and NLOS weighted to equal shares, which is what the probabilities assume."""
    confusion: Confusion
    """At P ≥ 0.5."""
    cautious_confusion: Confusion
    """At P ≥ CAUTIOUS_THRESHOLD."""


def evaluation(
    title: str, probability: NDArray[np.float64], is_los: NDArray[np.bool_], group: NDArray[np.int64]
) -> Evaluation:
    """Of (N,) probabilities, truths and groups."""
    auc_interval, balanced_interval = _intervals(probability, is_los, group)
    return Evaluation(
        title=title,
        figures=figures(probability, is_los),
        cautious=figures(probability, is_los, CAUTIOUS_THRESHOLD),
        groups=len(np.unique(group)),
        auc_interval=auc_interval,
        balanced_interval=balanced_interval,
        ece_even=_even_ece(probability, is_los),
        confusion=confusion(probability, is_los),
        cautious_confusion=confusion(probability, is_los, CAUTIOUS_THRESHOLD),
    )


def evaluate_splits(
    classifier: Classifier,
    data: LinkData,
    links: NDArray[np.int64],
    title: str = "held out",
    names: Sequence[str] = (),
) -> list[Evaluation]:
    """On ``links``: all captures of a link, the first only, by file (``names``), bandwidth and window."""
    result = [evaluate(classifier, data, links, f"{title}, all captures of a link", None)]
    if int(data.packets.max()) > 1:
        result.append(evaluate(classifier, data, links, f"{title}, first capture only", 1))
    source = None if data.source is None else data.source[links]
    for place, name in enumerate(names if source is not None else ()):
        part = links[source == place]
        if len(part):
            result.append(evaluate(classifier, data, part, f"{title}, of {name}", None))
            if int(data.packets[part].max()) > 1:
                result.append(evaluate(classifier, data, part, f"{title}, of {name}, first capture only", 1))
    for low, high in BANDWIDTH_BANDS_MHZ:
        inside = (data.bandwidth_hz[links] >= low * 1e6) & (data.bandwidth_hz[links] < high * 1e6)
        if np.any(inside) and not np.all(inside):
            here = f"{title}, bandwidth {low}–{high} MHz"
            result.append(evaluate(classifier, data, links[inside], here, None))
    for taps in np.unique(data.window_taps[links]):
        inside = data.window_taps[links] == taps
        if np.mean(inside) >= 0.02 and not np.all(inside):
            result.append(evaluate(classifier, data, links[inside], f"{title}, window of {taps} taps", None))
    return result


def evaluate(
    classifier: Classifier, data: LinkData, links: NDArray[np.int64], title: str, packets: int | None
) -> Evaluation:
    """Of the exported network: each link with all its captures, or with its first ``packets``."""
    logit, _ = judged(classifier, data, links, packets)
    calibration = Calibration(classifier.metadata.temperature, classifier.metadata.bias)
    return evaluation(title, calibration.probability(logit), data.is_los[links], data.group[links])


def judged(
    classifier: Classifier, data: LinkData, links: NDArray[np.int64], packets: int | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(links,) logits and (links,) novelty from the exported network."""
    count = data.packets[links] if packets is None else np.minimum(data.packets[links], packets)
    logit, novelty = np.empty(len(links)), np.empty(len(links))
    for here in np.unique(count):
        members = np.flatnonzero(count == here)
        for start in range(0, len(members), 256):
            part = members[start : start + 256]
            batch = data.batch(links[part], int(here), np.zeros(len(part), np.int64))
            logit[part], novelty[part] = classifier.judge(batch)
    return logit, novelty


def _intervals(
    probability: NDArray[np.float64], is_los: NDArray[np.bool_], group: NDArray[np.int64]
) -> tuple[Interval, Interval]:
    names, index = np.unique(group, return_inverse=True)
    unknown = Interval(float("nan"), float("nan"))
    if len(names) < 5:
        return unknown, unknown
    order = np.argsort(index, kind="stable")
    starts = np.searchsorted(index[order], np.arange(len(names) + 1))
    rng = np.random.default_rng(0)
    areas, balanced = [], []
    for _ in range(_DRAWS):
        drawn = rng.integers(0, len(names), size=len(names))
        rows = np.concatenate([order[starts[one] : starts[one + 1]] for one in drawn])
        truth = is_los[rows]
        if truth.all() or not truth.any():
            continue
        areas.append(auc(probability[rows], truth))
        called = probability[rows] >= 0.5
        balanced.append(0.5 * (float(called[truth].mean()) + float((~called[~truth]).mean())))
    if len(areas) < _DRAWS // 2:
        return unknown, unknown
    bounds = [np.quantile(values, [0.025, 0.975]) for values in (areas, balanced)]
    return Interval(*map(float, bounds[0])), Interval(*map(float, bounds[1]))


def _even_ece(probability: NDArray[np.float64], is_los: NDArray[np.bool_], bins: int = 15) -> float:
    weight = even_weights(is_los)
    index = np.minimum((probability * bins).astype(np.int64), bins - 1)
    gap = np.bincount(index, weights=weight * (probability - is_los), minlength=bins)
    return float(np.abs(gap).sum() / max(float(weight.sum()), 1e-9))
