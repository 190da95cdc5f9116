"""The two ways to a calibrated network: from many groups, and from few.

Why: with thousands of geometries a part can be held back for early stopping, calibration
and figures; with two dozen measured logs nothing can be spared, so that folds give the
figures and the calibration, and the network that is kept has seen all logs. Rule kept here: no figure and
no calibration from links that the network in question was trained on.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from groundstation.channel.calibration import Calibration, even_weights, fit_calibration
from groundstation.channel.training.adapt import AdaptOptions, State, adapt, cross_fit, deal_groups
from groundstation.channel.training.card import CurvePoint, SeedFigures
from groundstation.channel.training.data import LinkData, split_by_group
from groundstation.channel.training.evaluation import Evaluation, evaluation
from groundstation.channel.training.fit import FitOptions, fit, logits
from groundstation.channel.training.metrics import auc, figures
from groundstation.channel.training.model import CnnLstm
from groundstation.channel.training.options import TrainingOptions, TrainingProgress

Report = Callable[[TrainingProgress], None]


@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """What a recipe gives."""

    model: CnnLstm
    calibration: Calibration
    seed: int
    """The seed kept."""
    training: NDArray[np.int64]
    """Links that the network was trained on."""
    validation: NDArray[np.int64]
    """Links for the novelty's threshold; none where groups are few."""
    test: NDArray[np.int64]
    """Links to judge the exported network on; none where folds gave the figures."""
    evaluations: tuple[Evaluation, ...]
    """Figures by folds."""
    seeds: tuple[SeedFigures, ...]
    curve: tuple[CurvePoint, ...]
    split: str
    """How links were divided, for the card."""
    epochs: int
    """Epochs (or folds) done in this run."""


def from_many(
    data: LinkData,
    options: TrainingOptions,
    state: State | None,
    folder: Path,
    fingerprint: str,
    report: Report,
) -> Trained:
    """Early stopping and calibration on held-back groups; the seed with the least loss is kept."""
    training, validation, test = split_by_group(data, options.shares, options.seed)
    counts = [None, 1] if int(data.packets.max()) > 1 else [None]
    truth = np.tile(data.is_los[validation], len(counts))
    weight = even_weights(truth)
    best: tuple[float, int, CnnLstm, Calibration] | None = None
    seeds: list[SeedFigures] = []
    epochs = 0
    for seed in range(options.seed, options.seed + options.seeds):
        label = f"seed {seed}, " if options.seeds > 1 else ""

        def on_epoch(epoch: int, training_loss: float, validation_loss: float, label: str = label) -> None:
            nonlocal epochs
            epochs += 1
            detail = f"{label}loss {training_loss:.4f}, validation {validation_loss:.4f}"
            report(TrainingProgress("training", epoch, options.epochs, detail))

        model = fit(
            data,
            training,
            validation,
            _fit_options(options, seed),
            folder / f"checkpoint-{seed}.npz",
            fingerprint,
            on_epoch,
            state,
        )
        logit = np.concatenate([logits(model, data, validation, count) for count in counts])
        calibration = fit_calibration(logit, truth, weight)
        loss = float(np.mean(np.logaddexp(0, -np.where(truth, 1, -1) * logit)))
        now = figures(calibration.probability(logits(model, data, test)), data.is_los[test])
        seeds.append(SeedFigures(seed, loss, now.accuracy, now.balanced_accuracy, now.auc, now.ece))
        if best is None or loss < best[0]:
            best = (loss, seed, model, calibration)
    assert best is not None
    curve = _curve_of_many(data, options, state, folder, fingerprint, (training, validation, test), report)
    kind = (
        "Whole groups in one part"
        if data.grouped
        else "No `log_id` in the file: rows are apart, figures flatter"
    )
    return Trained(
        model=best[2],
        calibration=best[3],
        seed=best[1],
        training=training,
        validation=validation,
        test=test,
        evaluations=(),
        seeds=tuple(seeds),
        curve=curve,
        split=(
            f"{kind}: {len(training):,} links trained on, {len(validation):,} for early stopping and "
            f"calibration, {len(test):,} held out for the figures."
        ),
        epochs=epochs,
    )


def from_few(
    data: LinkData,
    options: TrainingOptions,
    state: State | None,
    folder: Path,
    fingerprint: str,
    report: Report,
) -> Trained:
    """Figures and calibration by folds over groups; the network kept has seen all of them."""
    evaluations: list[Evaluation] = []
    seeds: list[SeedFigures] = []
    kept: NDArray[np.float64] | None = None
    for seed in range(options.seed, options.seed + options.seeds):
        logit, probability = _by_folds(data, options, state, folder, fingerprint, seed, 1.0, report)
        kept = logit if kept is None else kept
        title = f"logs held out in {options.folds} folds, dealt with seed {seed}"
        now = evaluation(title, probability, data.is_los, data.group)
        evaluations.append(now)
        f = now.figures
        seeds.append(SeedFigures(seed, math.nan, f.accuracy, f.balanced_accuracy, f.auc, f.ece))
    assert kept is not None
    curve: list[CurvePoint] = []
    if options.learning_curve:
        fold = deal_groups(data, options.folds, options.seed)
        for share in (1 / 3, 2 / 3):
            logit, probability = _by_folds(
                data, options, state, folder, fingerprint, options.seed, share, report
            )
            curve.append(_point(data, share, fold, probability))
        first = evaluations[0].figures
        curve.append(CurvePoint(_groups(data, 1.0, fold), first.auc, first.balanced_accuracy))
    everything = np.arange(len(data))
    return Trained(
        model=adapt(state, data, everything, _adapt_options(options, options.seed)),
        calibration=fit_calibration(kept, data.is_los, _log_weights(data)),
        seed=options.seed,
        training=everything,
        validation=everything[:0],
        test=everything[:0],
        evaluations=tuple(evaluations),
        seeds=tuple(seeds),
        curve=tuple(curve),
        split=(
            f"Few groups: the figures are of {options.folds} networks, each judged on logs that neither it "
            "nor its calibration saw; the network kept was trained on all logs in the same way."
        ),
        epochs=options.folds * options.seeds,
    )


def _by_folds(
    data: LinkData,
    options: TrainingOptions,
    state: State | None,
    folder: Path,
    fingerprint: str,
    seed: int,
    share: float,
    report: Report,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(links,) logits and probabilities, each by a network and a calibration of other folds."""
    fold = deal_groups(data, options.folds, seed)
    checkpoint = folder / f"checkpoint-{seed}-{round(100 * share)}.npz"
    label = f"folds of seed {seed}" + (f", {100 * share:.0f} % of the logs" if share < 1 else "")
    logit = cross_fit(
        state,
        data,
        fold,
        _adapt_options(options, seed),
        checkpoint,
        fingerprint,
        lambda done, total: report(TrainingProgress("training", done, total, label)),
        share=share,
    )
    weight = _log_weights(data)
    probability = np.empty(len(data))
    for number in range(options.folds):
        held_out = fold == number
        calibration = fit_calibration(logit[~held_out], data.is_los[~held_out], weight[~held_out])
        probability[held_out] = calibration.probability(logit[held_out])
    return logit, probability


def _curve_of_many(
    data: LinkData,
    options: TrainingOptions,
    state: State | None,
    folder: Path,
    fingerprint: str,
    parts: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
    report: Report,
) -> tuple[CurvePoint, ...]:
    if not options.learning_curve:
        return ()
    training, validation, test = parts
    groups = np.random.default_rng([options.seed, 29]).permutation(np.unique(data.group[training]))
    points = []
    for share in (0.1, 1 / 3, 1.0):
        some = training[np.isin(data.group[training], groups[: max(2, round(share * len(groups)))])]
        model = fit(
            data,
            some,
            validation,
            _fit_options(options, options.seed),
            folder / f"checkpoint-{options.seed}{'' if share == 1 else f'-{round(100 * share)}'}.npz",
            fingerprint,
            lambda epoch, *_: report(TrainingProgress("training", epoch, options.epochs, "learning curve")),
            state,
        )
        logit = logits(model, data, test)
        now = figures(Calibration().probability(logit), data.is_los[test])
        points.append(CurvePoint(len(np.unique(data.group[some])), now.auc, now.balanced_accuracy))
    return tuple(points)


def _groups(data: LinkData, share: float, fold: NDArray[np.int64]) -> int:
    total = len(np.unique(data.group))
    return round(share * total * (1 - 1 / (int(fold.max()) + 1)))


def _point(
    data: LinkData, share: float, fold: NDArray[np.int64], probability: NDArray[np.float64]
) -> CurvePoint:
    now = figures(probability, data.is_los)
    return CurvePoint(_groups(data, share, fold), auc(probability, data.is_los), now.balanced_accuracy)


def _log_weights(data: LinkData) -> NDArray[np.float64]:
    """(links,) every log of a class alike, both classes alike; they sum to the number of groups."""
    _, index, count = np.unique(data.group, return_inverse=True, return_counts=True)
    weight = 1 / count[index]
    for state in (True, False):
        part = data.is_los == state
        weight[part] *= 0.5 * len(count) / weight[part].sum()
    return np.asarray(weight, np.float64)


def _fit_options(options: TrainingOptions, seed: int) -> FitOptions:
    return FitOptions(
        seed=seed,
        epochs=options.epochs,
        patience=options.patience,
        batch_links=options.batch_links,
        learning_rate=options.learning_rate,
        weight_decay=options.weight_decay,
        crop_probability=options.crop_probability,
    )


def _adapt_options(options: TrainingOptions, seed: int) -> AdaptOptions:
    defaults = AdaptOptions(seed=seed, steps=options.adapt_steps)
    return replace(defaults, crop_probability=options.crop_probability)


def novelty_inputs(
    model: CnnLstm, data: LinkData, links: NDArray[np.int64], captures_max: int = 20_000
) -> torch.Tensor:
    """(n, EMBEDDING) of the first captures of ``links``, at most so many."""
    step = max(1, math.ceil(len(links) / captures_max))
    parts = []
    with torch.no_grad():
        for start in range(0, len(links), 512 * step):
            some = links[start : start + 512 * step : step]
            batch = torch.from_numpy(data.batch(some, 1, np.zeros(len(some), np.int64)))
            parts.append(model.embed(batch))
    return torch.cat(parts)
