"""One command from a file to a calibrated, exported classifier with its card.

Rule kept here: nothing is trained before the file was read and found sound, and the
figures of the card come from the exported network through the service's own code.
"""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.channel.calibration import fit_temperature
from groundstation.channel.classifier import MODEL_FILE, Classifier, load_classifier
from groundstation.channel.training.card import Evaluation, write_card
from groundstation.channel.training.data import LinkData, read_links, split_by_group
from groundstation.channel.training.metrics import Figures, figures
from groundstation.domain.errors import InputError, ResourceError

BANDWIDTH_BANDS_MHZ = ((0, 50), (50, 150), (150, 450), (450, 1000))
CHECKPOINT_FILE = "checkpoint.npz"


@dataclass(frozen=True, slots=True)
class TrainingOptions:
    """How to train."""

    seed: int = 0
    epochs: int = 40
    patience: int = 10
    """Epochs without a better validation loss before stopping."""
    batch_links: int = 128
    learning_rate: float = 2e-3
    weight_decay: float = 1e-3
    crop_probability: float = 0.3
    """Chance that a batch is cropped to a window round the first path."""
    shares: tuple[float, float, float] = (0.7, 0.15, 0.15)
    """Of the groups: training, validation (early stopping, calibration), test."""
    threads: int = 1


@dataclass(frozen=True, slots=True)
class TrainingProgress:
    """Where a training stands; for a progress bar."""

    stage: str
    """``reading``, ``training`` or ``evaluating``."""
    done: int
    total: int
    detail: str = ""


@dataclass(frozen=True, slots=True)
class TrainingReport:
    """What came of it."""

    out: Path
    version: str
    parameters: int
    epochs: int
    """Epochs trained, a resumed run's earlier ones not counted."""
    temperature: float
    test: Figures
    evaluations: tuple[Evaluation, ...]


def train(
    data: Path,
    out: Path,
    *,
    options: TrainingOptions | None = None,
    evaluate: Sequence[tuple[str, Path]] = (),
    command: str | None = None,
    progress: Callable[[TrainingProgress], None] | None = None,
) -> TrainingReport:
    """Train, calibrate and export a classifier from ``data`` (NPZ or CSV) into folder ``out``.

    ``evaluate`` lists further files, with titles, that the card gives figures on. An
    interrupted run with the same file and options goes on at its last epoch. Raises
    InputError on unusable data, ResourceError where the ``train`` extra is missing.
    """
    options = options or TrainingOptions()
    report = progress or (lambda _: None)
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out} is a file; a folder is needed")
    links = read_links(data, lambda done, total: report(TrainingProgress("reading", done, total)))
    training, validation, test = split_by_group(links, options.shares, options.seed)
    others = [(title, path, read_links(path)) for title, path in evaluate]
    for module in ("torch", "onnx", "onnxscript"):
        if importlib.util.find_spec(module) is None:
            raise ResourceError(f"training needs {module}: pip install 'groundstation[train]'")

    import torch

    from groundstation.channel.training.export import export_onnx, write_metadata
    from groundstation.channel.training.fit import FitOptions, fit, logits
    from groundstation.channel.training.model import parameter_count

    torch.set_num_threads(options.threads)
    out.mkdir(parents=True, exist_ok=True)
    fingerprint = _fingerprint(links, options)
    epochs_trained: list[int] = []

    def on_epoch(epoch: int, training_loss: float, validation_loss: float) -> None:
        epochs_trained.append(epoch)
        detail = f"loss {training_loss:.4f}, validation {validation_loss:.4f}"
        report(TrainingProgress("training", epoch, options.epochs, detail))

    model = fit(
        links,
        training,
        validation,
        FitOptions(
            seed=options.seed,
            epochs=options.epochs,
            patience=options.patience,
            batch_links=options.batch_links,
            learning_rate=options.learning_rate,
            weight_decay=options.weight_decay,
            crop_probability=options.crop_probability,
        ),
        out / CHECKPOINT_FILE,
        fingerprint,
        on_epoch,
    )
    # Calibrated over all numbers of packets that the service will see.
    counts = [None, 1] if int(links.packets.max()) > 1 else [None]
    validation_logits = np.concatenate([logits(model, links, validation, count) for count in counts])
    calibration = fit_temperature(validation_logits, np.tile(links.is_los[validation], len(counts)))
    model_path = export_onnx(model, out)
    version = f"1-{hashlib.sha256(model_path.read_bytes()).hexdigest()[:8]}"
    write_metadata(
        out, version=version, temperature=calibration.temperature, los_threshold=0.5, seed=options.seed
    )

    classifier = load_classifier(out)
    held_out, evaluations = evaluate_splits(classifier, links, test)
    report(TrainingProgress("evaluating", 1, 1 + len(others)))
    for number, (title, _, other) in enumerate(others):
        everything = np.arange(len(other))
        evaluations.append(_evaluation(classifier, other, everything, title, None))
        if int(other.packets.max()) > 1:
            evaluations.append(_evaluation(classifier, other, everything, f"{title}, first capture only", 1))
        report(TrainingProgress("evaluating", 2 + number, 1 + len(others)))
    result = TrainingReport(
        out=out,
        version=version,
        parameters=parameter_count(model),
        epochs=len(epochs_trained),
        temperature=calibration.temperature,
        test=held_out,
        evaluations=tuple(evaluations),
    )
    write_card(
        out,
        version=version,
        parameters=result.parameters,
        model_bytes=(out / MODEL_FILE).stat().st_size,
        temperature=calibration.temperature,
        data_name=data.name,
        counts=(len(training), len(validation), len(test)),
        grouped=links.grouped,
        left_out=links.left_out,
        options=asdict(options),
        command=command or f"groundstation train --data {data.name} --out {out.name}",
        evaluations=evaluations,
    )
    (out / CHECKPOINT_FILE).unlink(missing_ok=True)
    return result


def evaluate_splits(
    classifier: Classifier, data: LinkData, links: NDArray[np.int64]
) -> tuple[Figures, list[Evaluation]]:
    """Figures on ``links``: over all, by captures, by bandwidth, by window."""
    overall = _evaluation(classifier, data, links, "held out, all captures of a link", None)
    result = [overall]
    if int(data.packets.max()) > 1:
        result.append(_evaluation(classifier, data, links, "held out, first capture only", 1))
    for low, high in BANDWIDTH_BANDS_MHZ:
        inside = (data.bandwidth_hz[links] >= low * 1e6) & (data.bandwidth_hz[links] < high * 1e6)
        if np.any(inside):
            title = f"held out, bandwidth {low}–{high} MHz"
            result.append(_evaluation(classifier, data, links[inside], title, None))
    for taps in np.unique(data.window_taps[links]):
        inside = data.window_taps[links] == taps
        if not np.all(inside):
            title = f"held out, window of {taps} taps"
            result.append(_evaluation(classifier, data, links[inside], title, None))
    return overall.figures, result


def _evaluation(
    classifier: Classifier, data: LinkData, links: NDArray[np.int64], title: str, packets: int | None
) -> Evaluation:
    """Through the exported network, as the service does it."""
    count = data.packets[links] if packets is None else np.minimum(data.packets[links], packets)
    logit = np.empty(len(links))
    for here in np.unique(count):
        members = np.flatnonzero(count == here)
        for start in range(0, len(members), 256):
            part = members[start : start + 256]
            logit[part] = classifier.logits(data.batch(links[part], int(here), np.zeros(len(part), np.int64)))
    probability = 0.5 * (1 + np.tanh(0.5 * logit / classifier.metadata.temperature))
    is_los = data.is_los[links]
    return Evaluation(title, figures(probability, is_los), figures(probability, is_los, 0.75))


def _fingerprint(data: LinkData, options: TrainingOptions) -> str:
    digest = hashlib.sha256(repr(options).encode())
    for array in (data.inputs, data.first, data.packets, data.is_los, data.group):
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
