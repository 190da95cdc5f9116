"""A calibrated classifier from few logs, with figures of logs that had no part in it.

Why: two dozen logs leave none to hold back, so that folds give the figures and the model that is kept has
seen all logs. Rule kept here: whatever is decided from data (weights, offset, whether the
network helps) is decided anew in each fold, from the other folds alone; the odds are those of equally
frequent classes, and need no calibration behind the ridge.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray

from groundstation.channel.calibration import Calibration
from groundstation.channel.training.card import CurvePoint, SeedFigures
from groundstation.channel.training.data import LinkData
from groundstation.channel.training.evaluation import Evaluation, evaluation
from groundstation.channel.training.measured import (
    NETWORK,
    STATISTICS,
    Head,
    MeasuredModel,
    choose_head,
    deal_groups,
    inputs_of,
)
from groundstation.channel.training.metrics import auc, figures
from groundstation.channel.training.model import CnnLstm
from groundstation.channel.training.options import TrainingOptions, TrainingProgress
from groundstation.channel.training.recipes import Trained

CURVE_DEALS = 5
"""Ways to deal folds that a point of the learning curve is the mean over."""


def from_few(
    data: LinkData,
    options: TrainingOptions,
    state: dict[str, torch.Tensor],
    report: Callable[[TrainingProgress], None],
) -> Trained:
    """Statistics weighed by few logs (:mod:`.measured`), beside the network of ``state`` as it is."""
    network = CnnLstm()
    network.load_state_dict(state)
    network.eval()
    inputs = inputs_of(data, network)
    evaluations: list[Evaluation] = []
    seeds: list[SeedFigures] = []
    for seed in range(options.seed, options.seed + options.seeds):
        logit = cross_fit(data, inputs, options.folds, seed, report=report)
        title = f"logs held out in {options.folds} folds, dealt with seed {seed}"
        now = evaluation(title, Calibration().probability(logit), data.is_los, data.group)
        evaluations.append(now)
        f = now.figures
        seeds.append(SeedFigures(seed, math.nan, f.accuracy, f.balanced_accuracy, f.auc, f.ece))
    head = choose_head(inputs, data.is_los, data.group, options.seed)
    everything = np.arange(len(data))
    return Trained(
        model=network,
        calibration=Calibration(),
        seed=options.seed,
        training=everything,
        validation=everything[:0],
        test=everything[:0],
        evaluations=tuple(evaluations),
        seeds=tuple(seeds),
        curve=_curve(data, inputs, options, report) if options.learning_curve else (),
        split=(
            f"Few groups: the figures are of {options.folds} models, each judged on logs that had no part in "
            "any of its numbers; the model kept was made from all logs in the same way."
        ),
        epochs=options.folds * options.seeds,
        exported=MeasuredModel(head, network),
        method=method_text(head, data),
    )


def cross_fit(
    data: LinkData,
    inputs: NDArray[np.float64],
    folds: int,
    seed: int,
    share: float = 1.0,
    report: Callable[[TrainingProgress], None] = lambda _: None,
) -> NDArray[np.float64]:
    """(links,) logits, each from a head that saw no link of the same fold.

    Of the other folds' groups it saw ``share``, of each class at least one.
    """
    fold = deal_groups(data.group, data.is_los, folds, seed)
    logit = np.zeros(len(data))
    numbers = np.unique(fold)
    for done, number in enumerate(numbers, start=1):
        seen = some_groups(data, np.flatnonzero(fold != number), share, seed)
        head = choose_head(inputs[seen], data.is_los[seen], data.group[seen], seed)
        held_out = fold == number
        logit[held_out] = head.logit(inputs[held_out])
        report(TrainingProgress("training", done, len(numbers), f"folds of seed {seed}"))
    return logit


def some_groups(data: LinkData, links: NDArray[np.int64], share: float, seed: int) -> NDArray[np.int64]:
    """Of ``links`` those of a random ``share`` of each class's groups, at least one of each."""
    if share >= 1:
        return links
    rng = np.random.default_rng([seed, 31])
    kept: list[NDArray[np.int64]] = []
    for state in (True, False):
        groups = rng.permutation(np.unique(data.group[links][data.is_los[links] == state]))
        kept.append(groups[: math.ceil(share * len(groups))])
    return links[np.isin(data.group[links], np.concatenate(kept))]


def method_text(head: Head, data: LinkData) -> str:
    """What was trained and why, in one line."""
    groups = len(np.unique(data.group))
    taken = "with" if len(head.weight) > len(STATISTICS) else "without"
    names = ", ".join(
        f"{name} {weight:.3g}" for name, weight in zip((*STATISTICS, NETWORK), head.weight, strict=False)
    )
    return (
        f"{groups} logs are {groups} examples, too few for a network to learn from: a regularised logistic "
        f"regression on statistics of the direct path, {taken} the network's logit (logs left out decided); "
        f"weights: {names}"
    )


def _curve(
    data: LinkData,
    inputs: NDArray[np.float64],
    options: TrainingOptions,
    report: Callable[[TrainingProgress], None],
) -> tuple[CurvePoint, ...]:
    points = []
    shares = (1 / 3, 2 / 3, 1.0)
    for done, share in enumerate(shares):
        report(TrainingProgress("evaluating", done, len(shares), "learning curve"))
        seen, areas, balanced = [], [], []
        for seed in range(options.seed, options.seed + CURVE_DEALS):
            fold = deal_groups(data.group, data.is_los, options.folds, seed)
            for number in np.unique(fold):
                links = some_groups(data, np.flatnonzero(fold != number), share, seed)
                seen.append(len(np.unique(data.group[links])))
            logit = cross_fit(data, inputs, options.folds, seed, share)
            areas.append(auc(logit, data.is_los))
            balanced.append(figures(Calibration().probability(logit), data.is_los).balanced_accuracy)
        points.append(CurvePoint(round(np.mean(seen)), float(np.mean(areas)), float(np.mean(balanced))))
    return tuple(points)
