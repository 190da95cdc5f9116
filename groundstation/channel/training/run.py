"""One command from a file to a calibrated, exported classifier with its card.

Rule kept here: nothing is trained before the file was read and found sound, and the
figures of the card come from the exported network through the service's own code (from folds
where the groups are few).
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from groundstation.channel.classifier import MODEL_FILE, WEIGHTS_DIR, load_classifier
from groundstation.channel.training.card import Card, write_card
from groundstation.channel.training.data import LinkData, joined, read_links, read_windows, split_by_group
from groundstation.channel.training.evaluation import Evaluation, evaluate, evaluate_splits, judged
from groundstation.channel.training.metrics import Figures
from groundstation.channel.training.options import TrainingOptions, TrainingProgress
from groundstation.domain.errors import InputError, ResourceError

__all__ = ["TrainingOptions", "TrainingProgress", "TrainingReport", "train"]

NOVELTY_QUANTILE = 0.999
"""Of the validation links' novelty …"""
NOVELTY_MARGIN = 1.25
"""… times this is the most that is not called unlike anything seen."""


@dataclass(frozen=True, slots=True)
class TrainingReport:
    """What came of it."""

    out: Path
    version: str
    parameters: int
    epochs: int
    """Epochs trained (folds, where groups are few), a resumed run's earlier ones not counted."""
    temperature: float
    test: Figures
    evaluations: tuple[Evaluation, ...]
    method: str = ""
    """What was made of few logs instead of a newly trained network, and why."""


def train(
    data: Path,
    out: Path,
    *,
    options: TrainingOptions | None = None,
    also: Sequence[Path] = (),
    evaluate: Sequence[tuple[str, Path]] = (),
    tap_spacing_ns: float | None = None,
    command: str | None = None,
    progress: Callable[[TrainingProgress], None] | None = None,
) -> TrainingReport:
    """Train, calibrate and export a classifier from ``data`` (NPZ or CSV) into folder ``out``.

    ``also`` lists further files to train on, each with groups of its own; ``evaluate`` lists
    further files, with titles, that the card gives figures on; ``tap_spacing_ns`` holds for all files
    that do not tell theirs. An interrupted run with the same
    files and options goes on at its last epoch or fold. Raises InputError on unusable data,
    ResourceError where the ``train`` extra is missing.
    """
    options = options or TrainingOptions()
    report = progress or (lambda _: None)
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out} is a file; a folder is needed")
    existing = next((folder for folder in (out, *out.absolute().parents) if folder.exists()), out)
    if not (existing.is_dir() and os.access(existing, os.W_OK)):
        raise InputError(f"--out {out}: {existing} is no folder that can be written to")
    if options.seeds < 1:
        raise InputError(f"{options.seeds} seeds; at least 1 is needed")
    links = read_links(
        data,
        lambda done, total: report(TrainingProgress("reading", done, total)),
        tap_spacing_ns=tap_spacing_ns,
    )
    parts = [links, *(read_links(path, tap_spacing_ns=tap_spacing_ns) for path in also)]
    links = merged(parts)
    if not is_few(links, options):
        split_by_group(links, options.shares, options.seed)
        links = merged(
            [
                _with_windows(part, path, options, tap_spacing_ns)
                for part, path in zip(parts, [data, *also], strict=True)
            ]
        )
    others = [(title, read_links(path, tap_spacing_ns=tap_spacing_ns)) for title, path in evaluate]
    for module in ("torch", "onnx", "onnxscript"):
        if importlib.util.find_spec(module) is None:
            raise ResourceError(f"training needs {module}: pip install 'groundstation[train]'")
    return _train([data, *also], links, out, options, others, command, report)


def _with_windows(
    part: LinkData, path: Path, options: TrainingOptions, tap_spacing_ns: float | None
) -> LinkData:
    """The links of a file, and those that are long enough once more as a sensor's window."""
    if not options.windows:
        return part
    cut = read_windows(path, options.windows, options.seed, tap_spacing_ns=tap_spacing_ns)
    return replace(joined([part, cut]), left_out=part.left_out)


def is_few(data: LinkData, options: TrainingOptions) -> bool:
    """Whether the groups are so few and pure that folds must do: measured logs."""
    _, index = np.unique(data.group, return_inverse=True)
    share = np.bincount(index, weights=data.is_los) / np.bincount(index)
    pure = np.mean((share == 0) | (share == 1)) >= 0.9
    enough = min(np.count_nonzero(share > 0.5), np.count_nonzero(share <= 0.5)) >= 2
    return data.grouped and len(share) < options.few_groups and bool(pure) and bool(enough)


def merged(parts: Sequence[LinkData]) -> LinkData:
    """The links of several files as of one; no group is in two of them, and all files weigh alike."""
    if len(parts) == 1:
        return parts[0]
    lengths = np.array([len(part) for part in parts])
    captures = np.cumsum([0, *(len(part.inputs) for part in parts)])
    groups = np.cumsum([0, *(int(part.group.max()) + 1 for part in parts)])
    return LinkData(
        inputs=np.concatenate([part.inputs for part in parts]),
        first=np.concatenate([part.first + n for part, n in zip(parts, captures, strict=False)]),
        packets=np.concatenate([part.packets for part in parts]),
        is_los=np.concatenate([part.is_los for part in parts]),
        group=np.concatenate([part.group + n for part, n in zip(parts, groups, strict=False)]),
        bandwidth_hz=np.concatenate([part.bandwidth_hz for part in parts]),
        window_taps=np.concatenate([part.window_taps for part in parts]),
        left_out=dict(sorted(sum((Counter(part.left_out) for part in parts), Counter()).items())),
        grouped=all(part.grouped for part in parts),
        source=np.repeat(np.arange(len(parts)), lengths),
        weight=np.repeat(lengths.sum() / len(parts) / lengths, lengths),
    )


def _train(
    data: Sequence[Path],
    links: LinkData,
    out: Path,
    options: TrainingOptions,
    others: Sequence[tuple[str, LinkData]],
    command: str | None,
    report: Callable[[TrainingProgress], None],
) -> TrainingReport:
    import torch

    from groundstation.channel.training import export, measured_recipe, recipes
    from groundstation.channel.training.model import WithNovelty, novelty_statistics, parameter_count

    torch.set_num_threads(options.threads)
    few = is_few(links, options)
    start = options.start or (WEIGHTS_DIR if few else None)
    state = None if start is None else export.load_weights(start)
    out.mkdir(parents=True, exist_ok=True)
    if few:
        assert state is not None
        trained = measured_recipe.from_few(links, options, state, report)
    else:
        trained = recipes.from_many(links, options, state, out, _fingerprint(links, options), report)

    calibration = trained.calibration
    network = trained.exported
    if network is None:
        embedding = recipes.novelty_inputs(trained.model, links, trained.training)
        network = WithNovelty(trained.model, *novelty_statistics(embedding))
    model_path = export.export_onnx(network, out)
    version = f"1-{hashlib.sha256(model_path.read_bytes()).hexdigest()[:8]}"

    def write_metadata(novelty_max: float) -> None:
        export.write_metadata(
            out,
            version=version,
            temperature=calibration.temperature,
            bias=calibration.bias,
            los_threshold=0.5,
            seed=trained.seed,
            novelty_max=novelty_max,
        )

    write_metadata(math.inf)
    export.save_weights(trained.model, out)
    classifier = load_classifier(out)
    novelty_max = novelty_rate = math.nan
    if not few:
        _, usual = judged(classifier, links, trained.validation, 1)
        novelty_max = NOVELTY_MARGIN * float(np.quantile(usual, NOVELTY_QUANTILE))
        novelty_rate = float(np.mean(judged(classifier, links, trained.test)[1] > novelty_max))
        write_metadata(novelty_max)
    evaluations = list(trained.evaluations)
    if len(trained.test):
        evaluations += evaluate_splits(classifier, links, trained.test, names=[path.name for path in data])
    report(TrainingProgress("evaluating", 1, 1 + len(others)))
    for number, (title, other) in enumerate(others):
        everything = np.arange(len(other))
        evaluations.append(evaluate(classifier, other, everything, title, None))
        if int(other.packets.max()) > 1:
            evaluations.append(evaluate(classifier, other, everything, f"{title}, first capture only", 1))
        report(TrainingProgress("evaluating", 2 + number, 1 + len(others)))

    parameters = parameter_count(network)
    notes = out / "notes.md"
    write_card(
        out,
        Card(
            version=version,
            parameters=parameters,
            model_bytes=(out / MODEL_FILE).stat().st_size,
            temperature=calibration.temperature,
            bias=calibration.bias,
            novelty_max=math.inf if few else novelty_max,
            los_threshold=0.5,
            data_name=", ".join(path.name for path in data),
            data_sha256=_sha256(data),
            start=_named_start(start),
            groups=len(np.unique(links.group)),
            split=trained.split,
            left_out=links.left_out,
            options={name: value for name, value in asdict(options).items() if name != "start"},
            command=command or f"groundstation train --data {data[0].name} --out {out.name}",
            evaluations=evaluations,
            seeds=trained.seeds,
            learning_curve=trained.curve,
            novelty_rate=novelty_rate,
            notes=notes.read_text(encoding="utf-8") if notes.is_file() else "",
            method=trained.method,
        ),
    )
    for checkpoint in out.glob("checkpoint-*.npz"):
        checkpoint.unlink()
    return TrainingReport(
        out=out,
        version=version,
        parameters=parameters,
        epochs=trained.epochs,
        temperature=calibration.temperature,
        test=evaluations[0].figures,
        evaluations=tuple(evaluations),
        method=trained.method,
    )


def _named_start(start: Path | None) -> str:
    if start is None:
        return "random weights"
    return f"the weights of model {load_classifier(start).version}"


def _sha256(paths: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def _fingerprint(data: LinkData, options: TrainingOptions) -> str:
    digest = hashlib.sha256(repr(options).encode())
    for array in (data.inputs, data.first, data.packets, data.is_los, data.group):
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
