"""How much of a response is worth sending: AUC against bytes per link over MAVLink.

Why: the default window of SAR_CIR (64 taps round the first path, one frame) is chosen by this
curve. Rules kept here: what is classified is what came out of the wire's encoding, at one
byte a tap; all windows and numbers of packets are cut from the same responses; a loss is
paired, link by link, and has its interval.
"""

from __future__ import annotations

import importlib.util
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from groundstation.channel import load_classifier
from groundstation.channel.training.classical import LinkClassifier, random_forest
from groundstation.channel.training.data import LinkData, joined, read_links, split_by_group
from groundstation.channel.training.metrics import auc, figures
from groundstation.channel.training.network import NetworkClassifier, ShippedClassifier
from groundstation.domain.errors import ResourceError, UsageError
from groundstation.store.snapshots import write_atomically
from sim_sitl.cir_encoding import (
    LOG_STEP_DB,
    MAX_DATA_BYTES,
    WINDOW_TAPS,
    CirEncoding,
    quantise,
    window_round_first_path,
)
from sim_sitl.dataset import DatasetOptions, write_dataset
from sim_sitl.studies.table3 import ROWS_MIN, TEST_SHARE, Increments, Steps
from sim_sitl.studies.tables import csv_text, number

if TYPE_CHECKING:
    from sim_sitl.studies.commands import ProgressReport, StudyOptions

WINDOWS = (1016, 256, 128, 64, 32)
"""Taps sent; the first is the full response."""
PACKETS = (1, 2, 4)
FRAME_BYTES = 52
"""Of a SAR_CIR frame beside its data: MAVLink 2's 12, and the fields before ``data``."""
LOSS_ALLOWED = 0.01
EPOCHS = 40
RESAMPLES = 400
SHIPPED, TRAINED, FOREST = "shipped CNN–LSTM", "CNN–LSTM trained on this data", "RF, a forest a window"
COLUMNS = (
    "classifier", "window_taps", "packets", "frames_a_packet", "bytes_per_link", "links", "auc", "auc_low",
    "auc_high", "accuracy", "auc_loss", "auc_loss_low", "auc_loss_high",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Point:
    """One classifier at one window and number of packets."""

    classifier: str
    window_taps: int
    packets: int
    links: int
    auc: tuple[float, float, float]
    """Value and 95 % interval, by bootstrap over links."""
    accuracy: float
    loss: tuple[float, float, float]
    """AUC of the full response with as many packets, less this one; with its interval."""

    @property
    def frames(self) -> int:
        """Of one packet."""
        return math.ceil(self.window_taps / MAX_DATA_BYTES)

    @property
    def bytes_per_link(self) -> int:
        """On the wire, at one byte a tap."""
        return self.packets * (self.window_taps + FRAME_BYTES * self.frames)


def run(options: StudyOptions, progress: ProgressReport | None = None, *, epochs: int = EPOCHS) -> list[Path]:
    """``sim-sitl study bandwidth``: ``options.trials`` rows. Returns the files, the report first.

    Raises UsageError or ResourceError before any work.
    """
    from sim_sitl.studies.commands import make_folder

    if options.trials < ROWS_MIN:
        raise UsageError(f"--trials {options.trials}; bandwidth counts rows: {ROWS_MIN} or more")
    if options.scheduler is not None:
        raise UsageError("--scheduler does not go with bandwidth: it runs on this machine")
    for module, extra in (("matplotlib", "study"), ("sklearn", "train"), ("torch", "train")):
        if importlib.util.find_spec(module) is None:
            raise ResourceError(f"bandwidth needs {module}: pip install 'groundstation[{extra}]'")
    make_folder(options.out)
    began = time.monotonic()
    points = compute(options, Steps(progress), epochs)
    files = {
        "bandwidth.md": markdown(points, options, time.monotonic() - began).encode(),
        "bandwidth.csv": csv_text(COLUMNS, [_row(point) for point in points]).encode(),
        "bandwidth.png": plot(points),
    }
    for name, data in files.items():
        write_atomically(options.out / name, data)
    return [options.out / name for name in files]


def compute(options: StudyOptions, steps: Steps, epochs: int) -> list[Point]:
    """Every point, the full response first."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    steps.expect(options.trials * (1 + len(WINDOWS)), 1 + len(WINDOWS), options.trials // 4)
    try:
        with tempfile.TemporaryDirectory() as folder:
            whole = Path(folder) / "channels.npz"
            write_dataset(options.trials, options.seed, whole, Increments(steps.rows), DatasetOptions())
            windowed = [_windowed(whole, taps, steps.rows) for taps in WINDOWS]
        shares = (1 - 1.5 * TEST_SHARE, 0.5 * TEST_SHARE, TEST_SHARE)
        training, rest, test = split_by_group(windowed[0], shares, options.seed)
        training = np.sort(np.concatenate([training, rest]))
        trained = NetworkClassifier(
            options.seed,
            epochs,
            on_epoch=lambda epoch, _training, _validation: steps.epoch(epoch, epochs),
        )
        # One network for any window, as the service has it: each training link is seen in all of them.
        count = len(windowed[0])
        trained.fit(
            joined(windowed), np.concatenate([training + count * place for place in range(len(WINDOWS))])
        )
        steps.entry()
        shipped = ShippedClassifier(load_classifier())
        everything = np.arange(len(windowed[0]))
        probability: dict[tuple[str, int, int], NDArray[np.float64]] = {}
        for taps, data in zip(WINDOWS, windowed, strict=True):
            forest = random_forest(options.seed)
            forest.fit(data, training)
            steps.entry()
            judges: list[tuple[str, LinkClassifier, NDArray[np.int64]]] = [
                (SHIPPED, shipped, everything), (TRAINED, trained, test), (FOREST, forest, test),
            ]  # fmt: skip
            for name, classifier, links in judges:
                for packets in PACKETS:
                    probability[name, taps, packets] = classifier.predict_proba(data, links, packets)
    finally:
        torch.set_num_threads(threads)
    truth = {SHIPPED: windowed[0].is_los, TRAINED: windowed[0].is_los[test], FOREST: windowed[0].is_los[test]}
    return [
        _point(name, taps, packets, probability, truth[name], options.seed)
        for name in (SHIPPED, TRAINED, FOREST)
        for packets in PACKETS
        for taps in WINDOWS
    ]


def _windowed(whole: Path, taps: int, on_rows: Callable[[int], None]) -> LinkData:
    """The data set as a station decodes it when ``taps`` round the first path are sent."""
    with np.load(whole, allow_pickle=False) as archive:
        columns = {name: archive[name] for name in ("label", "log_id", "packet", "tap_spacing_ns")}
        magnitude, first_path = archive["cir_magnitude"], float(archive["first_path_index"][0])
    first, count = window_round_first_path(magnitude.shape[1], first_path, taps)
    decoded = np.array([_decoded(row[first : first + count]) for row in magnitude], np.float32)
    path = whole.with_name(f"window-{taps}.npz")
    told = np.full(len(decoded), first_path - first)
    np.savez(path, allow_pickle=False, cir_magnitude=decoded, first_path_index=told, **columns)
    return read_links(path, Increments(on_rows), with_features=True, keep_noise=True)


def _decoded(magnitude: NDArray[np.float32]) -> NDArray[np.float64]:
    _, payload = quantise(magnitude.astype(np.float64), CirEncoding.U8_LOG_MAGNITUDE)
    # Times the step first: the counts are unsigned bytes, which a minus sign would wrap.
    below_peak_db = np.frombuffer(payload, np.uint8) * LOG_STEP_DB
    decoded: NDArray[np.float64] = 10.0 ** (-below_peak_db / 20)
    return decoded


def _point(
    name: str,
    taps: int,
    packets: int,
    probability: dict[tuple[str, int, int], NDArray[np.float64]],
    is_los: NDArray[np.bool_],
    seed: int,
) -> Point:
    score, full = probability[name, taps, packets], probability[name, WINDOWS[0], packets]
    own = auc(score, is_los)
    rng = np.random.default_rng([seed, packets])
    values, losses = [], []
    for _ in range(RESAMPLES):
        drawn = rng.integers(0, len(is_los), len(is_los))
        value = auc(score[drawn], is_los[drawn])
        values.append(value)
        losses.append(auc(full[drawn], is_los[drawn]) - value)
    low, high = np.nanpercentile(values, [2.5, 97.5])
    least, most = np.nanpercentile(losses, [2.5, 97.5])
    return Point(
        name, taps, packets, len(is_los), (own, float(low), float(high)), figures(score, is_los).accuracy,
        (auc(full, is_los) - own, float(least), float(most)),
    )  # fmt: skip


def _row(point: Point) -> list[object]:
    return [
        point.classifier, point.window_taps, point.packets, point.frames, point.bytes_per_link, point.links,
        *(number(value) for value in (*point.auc, point.accuracy, *point.loss)),
    ]  # fmt: skip


def markdown(points: Sequence[Point], options: StudyOptions, wall_s: float) -> str:
    """The report."""
    lines = [
        "# AUC against bytes per link",
        "",
        f"{options.trials:,} rows of the plain data set (500 MHz, 1.0016 ns a tap), seed {options.seed}, as "
        "decoded from `U8_LOG_MAGNITUDE` at one byte a tap; a SAR_CIR frame has "
        f"{FRAME_BYTES} bytes beside its data. The shipped classifier is judged on all links (it was not "
        "trained on them), the others on a fifth of the geometries. 95 % intervals by bootstrap over links; "
        "losses are paired.",
        "",
        f"    {options.command}",
        "",
        "| classifier | taps | packets | bytes a link | links | AUC | accuracy | AUC lost against all taps |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for point in points:
        value, low, high = point.auc
        lost, least, most = point.loss
        loss = "" if point.window_taps == WINDOWS[0] else f"{lost:+.4f} ({least:+.4f} to {most:+.4f})"
        lines.append(
            f"| {point.classifier} | {point.window_taps:,} | {point.packets} | {point.bytes_per_link:,} "
            f"| {point.links:,} | {value:.4f} ({low:.4f}–{high:.4f}) | {point.accuracy:.4f} | {loss} |"
        )
    default = [p for p in points if p.window_taps == WINDOW_TAPS and p.classifier != FOREST]
    worst = max(default, key=lambda point: point.loss[0])
    kept = "within" if worst.loss[0] <= LOSS_ALLOWED else "beyond"
    lines += [
        "",
        "![AUC against bytes](bandwidth.png)",
        "",
        f"The default window of {WINDOW_TAPS} taps costs the networks at most {worst.loss[0]:.4f} of AUC "
        f"({worst.classifier}, {worst.packets} packet{'s' if worst.packets > 1 else ''}): {kept} the "
        f"{LOSS_ALLOWED:g} allowed.",
        "",
        f"Made in {wall_s:.0f} s.",
        "",
    ]
    return "\n".join(lines)


def plot(points: Sequence[Point]) -> bytes:
    """PNG: a panel a classifier, a line a number of packets."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(point.classifier for point in points))
    figure = Figure(figsize=(13.0, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(names), sharey=True)
    for axes, name in zip(panels, names, strict=True):
        for packets, color, marker in zip(PACKETS, ("#0072B2", "#E69F00", "#009E73"), "osD", strict=True):
            line = [point for point in points if point.classifier == name and point.packets == packets]
            value = np.array([point.auc for point in line])
            axes.errorbar(
                [point.bytes_per_link for point in line], value[:, 0],
                yerr=[value[:, 0] - value[:, 1], value[:, 2] - value[:, 0]], color=color, marker=marker,
                capsize=2, label=f"{packets} packet{'s' if packets > 1 else ''}",
            )  # fmt: skip
            for point in line:
                axes.annotate(
                    str(point.window_taps), (point.bytes_per_link, point.auc[0]), textcoords="offset points",
                    xytext=(4, -10), fontsize=7, color=color,
                )  # fmt: skip
        axes.set_xscale("log")
        axes.set(xlabel="bytes a link on the wire (beside the marks: taps)", title=name)
        axes.grid(alpha=0.3, which="both")
    panels[0].set_ylabel("AUC (bar: 95 % interval)")
    panels[-1].legend(fontsize=8, frameon=False)
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=130, metadata={"Software": None})
    return stream.getvalue()
