"""The files of the study of measured logs: a report, two tables for programs, one picture.

Rule kept here: every figure with its interval, and the differences that it is judged by beside it.
"""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path

from groundstation.store.snapshots import write_atomically
from sim_sitl.studies.measured import FOLDS, RESAMPLES, TREES, CurvePoint, Interval, Measured, Score
from sim_sitl.studies.tables import csv_text, number

_FIGURES = ("auc", "balanced", "auc_gain", "balanced_gain")
COLUMNS = (
    "method", "captures", "logs", "los_logs", "deals", "folds",
    *(f"{name}{end}" for name in _FIGURES for end in ("", "_low", "_high")),
    "auc_least", "auc_most", "balanced_least", "balanced_most", "auc_mean_of_folds",
    "balanced_mean_of_folds",
)  # fmt: skip
CURVE_COLUMNS = (
    "method", "logs_trained_on", "auc", "auc_low", "auc_high", "balanced", "balanced_low", "balanced_high",
)  # fmt: skip
_COLORS = ("#0072B2", "#56B4E9", "#E69F00", "#B8A800", "#009E73", "#CC79A7", "#000000", "#999999")


def write_measured(found: Measured, out: Path) -> list[Path]:
    """Write all files into ``out``; the report first."""
    files = {
        "measured.md": markdown(found).encode(),
        "measured.csv": csv_text(COLUMNS, [_row(found, score) for score in found.scores]).encode(),
        "measured-curve.csv": csv_text(CURVE_COLUMNS, [_point(point) for point in found.curve]).encode(),
        "measured.png": plot(found),
    }
    for name, data in files.items():
        write_atomically(out / name, data)
    return [out / name for name in files]


def markdown(found: Measured) -> str:
    """The report."""
    lines = [
        f"# Measured logs: {found.name}",
        "",
        f"{found.captures:,} responses of {found.logs} logs, {found.los_logs} with a line of sight. Whole "
        f"logs held out in {FOLDS} folds, dealt {found.deals} times; every method got the same folds. "
        "Figures are over all held-out responses of a deal, the mean over deals; balanced accuracy at "
        f"P = 0.5. Brackets: 95 % by bootstrap over logs ({RESAMPLES:,} resamples, all deals of a resample "
        "together); gains are taken resample by resample.",
        "",
        f"Best tree by AUC: {found.best_auc}; by balanced accuracy: {found.best_balanced}.",
        "",
        "| method | AUC | over deals | gain on the best tree | balanced | over deals | gain on the best tree "
        "| mean of folds: AUC / balanced |",
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {one.method} | {_shown(one.auc)} | {_range(one.auc_deals)} | {_signed(one.auc_gain)} "
        f"| {_shown(one.balanced)} | {_range(one.balanced_deals)} | {_signed(one.balanced_gain)} "
        f"| {one.auc_folds:.3f} / {one.balanced_folds:.3f} |"
        for one in found.scores
    ]
    if not math.isnan(found.network_taken):
        lines += [
            "",
            f"`groundstation train` took the network's logit in {100 * found.network_taken:.0f} % of the "
            "trainings (learning curve included); logs left out within the training part decide.",
        ]
    lines += [
        "",
        "## Learning curve",
        "",
        "![learning curve](measured.png)",
        "",
        "| method | logs trained on | AUC | balanced |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| {point.method} | {point.logs:.1f} | {_shown(point.auc)} | {_shown(point.balanced)} |"
        for point in found.curve
    ]
    lines += [
        "",
        "## What this does not say",
        "",
        f"{found.logs} logs are {found.logs} channels of one campaign: an interval holds for further logs of "
        "the same kind, not for another building, another receiver or another way to choose places.",
        "",
        f"Command: `{found.command}`",
        "",
    ]
    return "\n".join(lines)


def plot(found: Measured) -> bytes:
    """PNG: AUC and balanced accuracy over the logs trained on."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 2, sharex=True)
    for axes, name, title in zip(panels, ("auc", "balanced"), ("AUC", "balanced accuracy"), strict=True):
        for place, method in enumerate(dict.fromkeys(point.method for point in found.curve)):
            points = [point for point in found.curve if point.method == method]
            values: list[Interval] = [getattr(point, name) for point in points]
            axes.errorbar(
                [point.logs * (1 + 0.012 * (place - 3)) for point in points],
                [one.value for one in values],
                yerr=[
                    [max(one.value - one.low, 0) for one in values],
                    [max(one.high - one.value, 0) for one in values],
                ],
                label=method, color=_COLORS[place % len(_COLORS)], marker="o", ms=4, capsize=2, lw=1.2,
                ls="--" if method in TREES else "-",
            )  # fmt: skip
        axes.set(xlabel="logs trained on", title=f"{title} on logs never seen (bar: 95 %, over logs)")
        axes.grid(alpha=0.3)
    if found.curve:
        panels[0].legend(fontsize=8, frameon=False)
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=130, metadata={"Software": None})
    return stream.getvalue()


def _row(found: Measured, score: Score) -> list[object]:
    values: list[object] = [score.method, found.captures, found.logs, found.los_logs, found.deals, FOLDS]
    for name in _FIGURES:
        one: Interval = getattr(score, name)
        values += [number(one.value), number(one.low), number(one.high)]
    rest = (*score.auc_deals, *score.balanced_deals, score.auc_folds, score.balanced_folds)
    return values + [number(value) for value in rest]


def _point(point: CurvePoint) -> list[object]:
    figures = (value for one in (point.auc, point.balanced) for value in (one.value, one.low, one.high))
    return [point.method, number(point.logs), *(number(value) for value in figures)]


def _shown(one: Interval) -> str:
    return f"{one.value:.3f} [{one.low:.3f}, {one.high:.3f}]"


def _signed(one: Interval) -> str:
    return f"{one.value:+.3f} [{one.low:+.3f}, {one.high:+.3f}]"


def _range(pair: tuple[float, float]) -> str:
    return f"{pair[0]:.3f}…{pair[1]:.3f}"
