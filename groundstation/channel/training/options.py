"""What a training is asked for and what it tells while it runs. No torch here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class TrainingOptions:
    """How to train."""

    seed: int = 0
    seeds: int = 1
    """Trainings with seeds from ``seed`` on; the card tells of each, the one with the least validation
    loss is kept. With few groups: ways to deal them into folds."""
    epochs: int = 40
    patience: int = 10
    """Epochs without a better validation loss before stopping."""
    batch_links: int = 128
    learning_rate: float = 2e-3
    weight_decay: float = 1e-3
    crop_probability: float = 0.15
    """Chance that a batch is cropped to a window round the first path."""
    blind_probability: float = 0.15
    """Chance that a batch is seen as if its tap spacing had not been told."""
    windows: tuple[int, ...] = (64, 64, 128, 256)
    """Of a response at least twice as long as the shortest of these, training sees such a window round the
    first path too, as a station asks for it, mostly the one that fits one frame; where groups are many."""
    shares: tuple[float, float, float] = (0.7, 0.15, 0.15)
    """Of the groups: training, validation (early stopping, calibration), test."""
    threads: int = 1
    few_groups: int = 200
    """Fewer logs of one class each than this weigh known statistics (and the network of ``start`` as it is)
    instead of training a network, and are judged by folds."""
    folds: int = 6
    """Folds over groups then."""
    start: Path | None = None
    """Folder of the model to begin with; None = the shipped one where groups are few, else none."""
    learning_curve: bool = False
    """Train on a third and two thirds of the groups too (a tenth and a third where they are many)."""


@dataclass(frozen=True, slots=True)
class TrainingProgress:
    """Where a training stands; for a progress bar."""

    stage: str
    """``reading``, ``training`` or ``evaluating``."""
    done: int
    total: int
    detail: str = ""
