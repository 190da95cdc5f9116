"""From many groups to a calibrated network; what both recipes give.

Why: with thousands of geometries a part can be held back for early stopping, calibration
and figures (few measured logs: :mod:`.measured_recipe`). Rule kept here: no figure and
no calibration from links that the network in question was trained on.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from groundstation.channel.calibration import Calibration, even_weights, fit_calibration
from groundstation.channel.training.card import CurvePoint, SeedFigures
from groundstation.channel.training.data import LinkData, split_by_group
from groundstation.channel.training.evaluation import Evaluation
from groundstation.channel.training.fit import FitOptions, fit, logits
from groundstation.channel.training.metrics import figures
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
    exported: nn.Module | None = None
    """What is exported instead of ``model``; None where that is it."""
    method: str = ""
    """What was trained and why, where it is not the network."""


def from_many(
    data: LinkData,
    options: TrainingOptions,
    state: dict[str, torch.Tensor] | None,
    folder: Path,
    fingerprint: str,
    report: Report,
) -> Trained:
    """Early stopping and calibration on held-back groups; the seed with the least loss is kept."""
    training, validation, test = split_by_group(data, options.shares, options.seed)
    counts = [None, 1] if int(data.packets.max()) > 1 else [None]
    truth = np.tile(data.is_los[validation], len(counts))
    weight = even_weights(truth)
    if data.weight is not None:
        weight = weight * np.tile(data.weight[validation], len(counts))
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
        loss = float(np.average(np.logaddexp(0, -np.where(truth, 1, -1) * logit), weights=weight))
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


def _curve_of_many(
    data: LinkData,
    options: TrainingOptions,
    state: dict[str, torch.Tensor] | None,
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


def _fit_options(options: TrainingOptions, seed: int) -> FitOptions:
    return FitOptions(
        seed=seed,
        epochs=options.epochs,
        patience=options.patience,
        batch_links=options.batch_links,
        learning_rate=options.learning_rate,
        weight_decay=options.weight_decay,
        crop_probability=options.crop_probability,
        blind_probability=options.blind_probability,
    )


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
