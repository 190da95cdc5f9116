"""The training loop: seeded, early-stopped, resumable.

Rules kept here: every epoch draws from a generator of (seed, epoch), so that a resumed
run does what the uninterrupted one would have done; checkpoints are plain arrays, never pickle.
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

from groundstation.channel.preprocess import FINE_TAPS, INPUT_BINS, LEAD_TAPS, time_channel
from groundstation.channel.training.data import LinkData
from groundstation.channel.training.files import UNKNOWN_SPACING_NS
from groundstation.channel.training.model import CnnLstm

_WARM_UP_EPOCHS = 1


@dataclass(frozen=True, slots=True)
class FitOptions:
    """How to train."""

    seed: int
    epochs: int
    patience: int
    """Epochs without a better validation loss before stopping."""
    batch_links: int
    learning_rate: float
    weight_decay: float
    crop_probability: float
    """Chance that a batch is cropped to a window round the first path, as small sensors send it."""
    blind_probability: float = 0.0
    """Chance that a batch is seen as if its tap spacing had not been told."""


@dataclass(slots=True)
class _Best:
    loss: float
    epoch: int
    state: dict[str, torch.Tensor]


def fit(
    data: LinkData,
    training: NDArray[np.int64],
    validation: NDArray[np.int64],
    options: FitOptions,
    checkpoint: Path,
    fingerprint: str,
    on_epoch: Callable[[int, float, float], None],
    start: dict[str, torch.Tensor] | None = None,
) -> CnnLstm:
    """Train a network, from ``start`` on where it is given.

    The one with the least validation loss comes back, in evaluation mode.

    ``on_epoch(epoch, training loss, validation loss)``, epochs from 1. ``checkpoint`` is
    written after each epoch and gone on from where ``fingerprint`` (data and options) matches.
    """
    torch.manual_seed(options.seed)
    model = CnnLstm()
    if start is not None:
        model.load_state_dict(start)
    optimiser = torch.optim.AdamW(
        model.parameters(), lr=options.learning_rate, weight_decay=options.weight_decay
    )
    best = _Best(math.inf, 0, _copy(model))
    first = _resume(checkpoint, fingerprint, model, optimiser, best)
    for epoch in range(first, options.epochs + 1):
        if epoch - best.epoch > options.patience:
            break
        training_loss = _train_epoch(model, optimiser, data, training, options, epoch)
        validation_loss = _loss(model, data, validation)
        if validation_loss < best.loss:
            best.loss, best.epoch, best.state = validation_loss, epoch, _copy(model)
        _save(checkpoint, fingerprint, epoch, model, optimiser, best)
        on_epoch(epoch, training_loss, validation_loss)
    model.load_state_dict(best.state)
    return model.eval()


def logits(
    model: nn.Module, data: LinkData, links: NDArray[np.int64], packets: int | None = None
) -> NDArray[np.float64]:
    """(links,) logits; each link with all its captures, or with its first ``packets``."""
    model.eval()
    count = data.packets[links] if packets is None else np.minimum(data.packets[links], packets)
    result = np.empty(len(links))
    with torch.no_grad():
        for packets_here in np.unique(count):
            members = np.flatnonzero(count == packets_here)
            for start in range(0, len(members), 512):
                part = members[start : start + 512]
                batch = data.batch(links[part], int(packets_here), np.zeros(len(part), np.int64))
                result[part] = model(torch.from_numpy(batch)).double().numpy()
    return result


def _train_epoch(
    model: CnnLstm,
    optimiser: torch.optim.Optimizer,
    data: LinkData,
    training: NDArray[np.int64],
    options: FitOptions,
    epoch: int,
) -> float:
    rng = np.random.default_rng([options.seed, epoch])
    torch.manual_seed(int(rng.integers(2**31)))
    model.train()
    counts = rng.integers(1, data.packets[training] + 1)
    batches = _batches(training, counts, options.batch_links, rng)
    total = 0.0
    for number, (links, packets) in enumerate(batches):
        skip = rng.integers(0, data.packets[links] - packets + 1)
        batch = torch.from_numpy(data.batch(links, packets, skip))
        if rng.random() < options.crop_probability:
            batch = crop(batch, rng)
        if rng.random() < options.blind_probability:
            batch = blind(batch)
        progress = (epoch - 1 + number / len(batches)) / options.epochs
        warm_up = min(1.0, (epoch - 1 + (number + 1) / len(batches)) / _WARM_UP_EPOCHS)
        for group in optimiser.param_groups:
            group["lr"] = options.learning_rate * warm_up * 0.5 * (1 + math.cos(math.pi * progress))
        target = torch.from_numpy(data.is_los[links].astype(np.float32))
        weight = None if data.weight is None else torch.from_numpy(data.weight[links].astype(np.float32))
        loss = nn.functional.binary_cross_entropy_with_logits(model(batch), target, weight)
        optimiser.zero_grad()
        # torch itself leaves this one without types.
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()
        total += float(loss.detach()) * len(links)
    return total / sum(len(links) for links, _ in batches)


def _batches(
    links: NDArray[np.int64], counts: NDArray[np.int64], size: int, rng: np.random.Generator
) -> list[tuple[NDArray[np.int64], int]]:
    """(links, number of captures) of each batch, in random order; each link is in one, unless it is alone."""
    batches = []
    for count in np.unique(counts):
        members = rng.permutation(links[counts == count])
        if len(members) > 1:
            parts = np.array_split(members, math.ceil(len(members) / size))
            batches += [(part, int(count)) for part in parts]
    return [batches[place] for place in rng.permutation(len(batches))]


def blind(batch: torch.Tensor) -> torch.Tensor:
    """As if the file had not said its tap spacing."""
    seen = batch.clone()
    seen[:, :, 2] = torch.from_numpy(time_channel(np.array([UNKNOWN_SPACING_NS]))[0])
    return seen


def crop(batch: torch.Tensor, rng: np.random.Generator) -> torch.Tensor:
    """As if the sensor had sent a window only: data and mask outside it become zero."""
    keep = torch.zeros(INPUT_BINS)
    lead, rest = int(rng.integers(0, LEAD_TAPS + 1)), int(rng.integers(24, FINE_TAPS + 1))
    keep[LEAD_TAPS - lead : LEAD_TAPS + rest] = 1
    cropped = batch * keep
    cropped[:, :, 2] = batch[:, :, 2]
    return cropped


def _loss(model: nn.Module, data: LinkData, links: NDArray[np.int64]) -> float:
    sign = np.where(data.is_los[links], 1.0, -1.0)
    weight = None if data.weight is None else data.weight[links]
    losses = [
        np.average(np.logaddexp(0, -sign * logits(model, data, links, packets)), weights=weight)
        for packets in (None, 1)
    ]
    return float(np.mean(losses))


def _copy(model: nn.Module) -> dict[str, torch.Tensor]:
    return {name: value.detach().clone() for name, value in model.state_dict().items()}


def _save(
    path: Path, fingerprint: str, epoch: int, model: nn.Module, optimiser: torch.optim.Optimizer, best: _Best
) -> None:
    arrays: dict[str, NDArray[np.generic]] = {
        "header": np.array(
            json.dumps({"fingerprint": fingerprint, "epoch": epoch, "best": best.epoch, "loss": best.loss})
        )
    }
    arrays |= {f"model/{name}": value.numpy() for name, value in model.state_dict().items()}
    arrays |= {f"best/{name}": value.numpy() for name, value in best.state.items()}
    for index, slots in optimiser.state_dict()["state"].items():
        arrays |= {f"adam/{index}/{name}": value.numpy() for name, value in slots.items()}
    partial = path.with_name(path.name + ".partial")
    with partial.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
    os.replace(partial, path)


def _resume(
    path: Path, fingerprint: str, model: nn.Module, optimiser: torch.optim.Optimizer, best: _Best
) -> int:
    """The epoch to go on with: 1 where there is no checkpoint of this very training."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: np.array(archive[name]) for name in archive.files}
        header = json.loads(str(arrays["header"]))
        if header["fingerprint"] != fingerprint:
            return 1
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return 1

    def part(prefix: str) -> dict[str, torch.Tensor]:
        return {
            name.removeprefix(prefix): torch.from_numpy(value)
            for name, value in arrays.items()
            if name.startswith(prefix)
        }

    model.load_state_dict(part("model/"))
    best.loss, best.epoch, best.state = header["loss"], header["best"], part("best/")
    state = optimiser.state_dict()
    slots: dict[int, dict[str, torch.Tensor]] = {}
    for name, value in part("adam/").items():
        index, _, slot = name.partition("/")
        slots.setdefault(int(index), {})[slot] = value
    optimiser.load_state_dict({"state": slots, "param_groups": state["param_groups"]})
    return int(header["epoch"]) + 1
