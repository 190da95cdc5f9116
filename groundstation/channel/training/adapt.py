"""From few real channels to a classifier: the shipped network adapted, judged on logs it never saw.

Why: a measuring campaign yields thousands of responses of a few dozen places, and all
responses of one log are one channel: two dozen examples, not thousands. Trained from
nothing on them a network learns places by heart. What helps (measured, see the model's
card): to start from a network that knows many simulated channels and move it little; to
draw classes and logs equally often; to fade each tap anew, for a step to the side would leave the
envelope and change the fading; soft labels. Rules kept here: every figure is of links whose log had no
part in the training or in the choice of anything; logs are dealt out by class.
"""

from __future__ import annotations

import json
import math
import os
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from groundstation.channel.preprocess import DYNAMIC_RANGE_DB
from groundstation.channel.training.data import LinkData
from groundstation.channel.training.fit import crop, logits
from groundstation.channel.training.model import CnnLstm

State = dict[str, torch.Tensor]


@dataclass(frozen=True, slots=True)
class AdaptOptions:
    """How to adapt."""

    seed: int = 0
    steps: int = 200
    batch_links: int = 64
    learning_rate: float = 3e-4
    weight_decay: float = 1e-2
    dropout: float = 0.3
    fade_db: float = 3.0
    """Standard deviation of the new fading of each tap, dB."""
    shift_bins: int = 2
    """The alignment moves by at most so much."""
    label_smoothing: float = 0.05
    crop_probability: float = 0.3


def deal_groups(data: LinkData, folds: int, seed: int) -> NDArray[np.int64]:
    """(links,) fold of each link: whole groups, dealt round by their class (of most links)."""
    rng = np.random.default_rng([seed, 17])
    groups, index = np.unique(data.group, return_inverse=True)
    los = np.bincount(index, weights=data.is_los) / np.bincount(index) > 0.5
    fold = np.empty(len(groups), np.int64)
    dealt = 0
    for members in (np.flatnonzero(los), np.flatnonzero(~los)):
        fold[rng.permutation(members)] = (dealt + np.arange(len(members))) % folds
        dealt += len(members)
    return fold[index]


def adapt(state: State | None, data: LinkData, links: NDArray[np.int64], options: AdaptOptions) -> CnnLstm:
    """A network that began as ``state`` (None: untrained) and saw ``links``; in evaluation mode."""
    torch.manual_seed(options.seed)
    rng = np.random.default_rng([options.seed, 23])
    model = CnnLstm(options.dropout)
    if state is not None:
        model.load_state_dict(state)
    model.train()
    if state is not None:  # few channels would spoil the statistics of many
        for module in model.modules():
            if isinstance(module, nn.BatchNorm1d):
                module.eval()
    optimiser = torch.optim.AdamW(
        model.parameters(), lr=options.learning_rate, weight_decay=options.weight_decay
    )
    classes = [_by_group(data, links[data.is_los[links] == state_]) for state_ in (True, False)]
    half = options.batch_links // 2
    target = torch.cat([torch.ones(half), torch.zeros(half)])
    target = target * (1 - 2 * options.label_smoothing) + options.label_smoothing
    for step in range(options.steps):
        drawn = np.array([rng.choice(of[int(rng.integers(len(of)))]) for of in classes for _ in range(half)])
        count = int(rng.integers(1, int(data.packets[drawn].min()) + 1))
        batch = data.batch(drawn, count, rng.integers(0, data.packets[drawn] - count + 1))
        tensor = _shift(_fade(torch.from_numpy(batch), options.fade_db, rng), options.shift_bins, rng)
        if rng.random() < options.crop_probability:
            tensor = crop(tensor, rng)
        for group in optimiser.param_groups:
            group["lr"] = options.learning_rate * 0.5 * (1 + math.cos(math.pi * step / options.steps))
        loss = nn.functional.binary_cross_entropy_with_logits(model(tensor), target)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()
    return model.eval()


def cross_fit(
    state: State | None,
    data: LinkData,
    fold: NDArray[np.int64],
    options: AdaptOptions,
    checkpoint: Path,
    fingerprint: str,
    on_fold: Callable[[int, int], None],
    share: float = 1.0,
) -> NDArray[np.float64]:
    """(links,) logits, each from a network that saw no link of the same fold.

    Of the other folds' groups it saw ``share``, of each class at least one.

    ``checkpoint`` is written after each fold and gone on from where ``fingerprint`` matches.
    """
    folds = int(fold.max()) + 1
    result = np.full(len(data), np.nan)
    done = _resume(checkpoint, fingerprint, result)
    for number in range(folds):
        if number >= done:
            model = adapt(
                state, data, _some(data, np.flatnonzero(fold != number), share, options.seed), options
            )
            held_out = np.flatnonzero(fold == number)
            result[held_out] = logits(model, data, held_out)
            partial = checkpoint.with_name(checkpoint.name + ".partial")
            with partial.open("wb") as file:
                header = json.dumps({"fingerprint": fingerprint, "folds": number + 1})
                np.savez(file, allow_pickle=False, header=np.array(header), logit=result)
            os.replace(partial, checkpoint)
        on_fold(number + 1, folds)
    return result


def _some(data: LinkData, links: NDArray[np.int64], share: float, seed: int) -> NDArray[np.int64]:
    if share >= 1:
        return links
    rng = np.random.default_rng([seed, 31])
    kept: list[NDArray[np.int64]] = []
    for state in (True, False):
        groups = rng.permutation(np.unique(data.group[links][data.is_los[links] == state]))
        kept.append(groups[: math.ceil(share * len(groups))])
    return links[np.isin(data.group[links], np.concatenate(kept))]


def _resume(checkpoint: Path, fingerprint: str, result: NDArray[np.float64]) -> int:
    """Folds done by an interrupted run of the very same kind; fills ``result``."""
    try:
        with np.load(checkpoint, allow_pickle=False) as archive:
            header = json.loads(str(archive["header"]))
            if header["fingerprint"] != fingerprint:
                return 0
            result[:] = archive["logit"]
            return int(header["folds"])
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return 0


def _by_group(data: LinkData, links: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    return [links[data.group[links] == group] for group in np.unique(data.group[links])]


def _fade(batch: torch.Tensor, sigma_db: float, rng: np.random.Generator) -> torch.Tensor:
    """New fading of each tap, alike in neighbours, on channels 0 and 1; what is near the floor stays."""
    links, packets, _, bins = batch.shape
    white = rng.normal(0, sigma_db / DYNAMIC_RANGE_DB, (links, packets, 1, bins)).astype(np.float32)
    fading = torch.from_numpy((white + np.roll(white, 1, -1)) / np.float32(math.sqrt(2)))
    level, known = batch[:, :, 1:2], batch[:, :, 3:4]
    level = level + fading * (level > 0.15)
    level = (level - (level.amax(-1, keepdim=True) - 1)).clamp(0, 1) * known
    faded = batch.clone()
    faded[:, :, 1:2] = level
    faded[:, :, 0:1] = torch.pow(10.0, (level - 1) * (DYNAMIC_RANGE_DB / 20)) * known
    return faded


def _shift(batch: torch.Tensor, bins_max: int, rng: np.random.Generator) -> torch.Tensor:
    """The alignment off by a few bins; the times stay with the bins."""
    moved = torch.roll(batch, int(rng.integers(-bins_max, bins_max + 1)), -1)
    moved[:, :, 2] = batch[:, :, 2]
    return moved
