"""Table III's files: CSV for programs, Markdown for people, one picture.

Rules: the CSV holds nothing that a clock gave, so that the same rows and seed give the same
file; the paper's figures stand beside ours only where the comparison is like with like enough
to say so; every mean over splits comes with its range.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np

from groundstation.channel.training.metrics import Figures, reliability, roc
from groundstation.store.snapshots import write_atomically
from sim_sitl.studies.table3 import CAPTURE, CAUTIOUS, LINK, PAPER, PAPER_ROWS, Outcome, Section, Table3
from sim_sitl.studies.tables import csv_text, number

METRICS = (
    "accuracy", "balanced_accuracy", "precision", "recall", "f1", "auc", "auc_hard", "ece", "nlos_called_los",
    "los_called_nlos",
)  # fmt: skip
COLUMNS = (
    "section", "bandwidth_mhz", "tap_spacing_ns", "equal_noise", "split_by", "method", "instance",
    "rows", "seed", "splits", "tested",
    *(f"{name}{end}" for name in METRICS for end in ("", "_low", "_high")),
    *(f"{name}_at_{CAUTIOUS:g}" for name in ("accuracy", "nlos_called_los", "los_called_nlos")),
    "los_called_los_count", "los_called_nlos_count", "nlos_called_los_count", "nlos_called_nlos_count",
    "paper_accuracy", "paper_precision", "paper_auc",
)  # fmt: skip
PROFILE_COLUMNS = ("section", "method", "instance", "fit_cpu_s", "ms_per_instance", "paper_ms")
_COLORS = ("#E69F00", "#B8A800", "#009E73", "#CC79A7", "#0072B2", "#56B4E9", "#000000")
_MARKERS = ("s", "D", "^", "P", "o", "v", ".")
_INSTANCES = {CAPTURE: "single captures, as the paper's rows", LINK: "links of four captures"}


def write_table3(table: Table3, out: Path) -> list[Path]:
    """Write all files into ``out``; the report first."""
    files = {
        "table3.md": markdown(table).encode(),
        "table3.csv": results_csv(table).encode(),
        "table3-profile.csv": profile_csv(table).encode(),
    }
    pictured = [section for section in table.sections if section.paper]
    for section in pictured:
        files[f"table3-{section.key}.png"] = plot(table, section)
    for name, data in files.items():
        write_atomically(out / name, data)
    return [out / name for name in files]


# ── CSV ───────────────────────────────────────────────────────────────────────────────────────


def results_csv(table: Table3) -> str:
    """A row a section, classifier and instance."""

    def row(section: Section, name: str, instance: str) -> list[object]:
        outcomes = table.of(section.key, name, instance)
        paper = PAPER.get(name) if section.paper and instance == CAPTURE else None
        spread = [
            number(value)
            for metric in METRICS
            for value in _spread([getattr(outcome.figures, metric) for outcome in outcomes])
        ]
        cautious = [
            number(_mean([getattr(outcome.cautious, metric) for outcome in outcomes]))
            for metric in ("accuracy", "nlos_called_los", "los_called_nlos")
        ]
        counts = [
            sum(getattr(outcome.counts, count) for outcome in outcomes)
            for count in ("los_called_los", "los_called_nlos", "nlos_called_los", "nlos_called_nlos")
        ]
        return [
            section.key, section.bandwidth_mhz, section.tap_spacing_ns, int(section.equal_noise),
            section.split, name, instance, table.rows, table.seed, len(outcomes),
            sum(outcome.figures.links for outcome in outcomes),
            *spread, *cautious, *counts,
            *((paper.accuracy, paper.precision, paper.auc) if paper else ("", "", "")),
        ]  # fmt: skip

    return csv_text(COLUMNS, [row(*key) for key in _keys(table)])


def profile_csv(table: Table3) -> str:
    """CPU times; the only file whose bytes differ from run to run."""
    rows = []
    for section, name, instance in _keys(table):
        outcomes = table.of(section.key, name, instance)
        paper = PAPER.get(name)
        rows.append(
            [
                section.key, name, instance, number(_mean([outcome.fit_s for outcome in outcomes])),
                number(min(outcome.predict_ms for outcome in outcomes)), paper.time_ms if paper else "",
            ]
        )  # fmt: skip
    return csv_text(PROFILE_COLUMNS, rows)


def _keys(table: Table3) -> list[tuple[Section, str, str]]:
    return [
        (section, entry.name, instance)
        for section in table.sections
        for instance in section.instances
        for entry in section.entries
    ]


# ── Markdown ──────────────────────────────────────────────────────────────────────────────────


def markdown(table: Table3) -> str:
    """The report."""
    lines = [
        "# Table III: channel classifiers",
        "",
        f"{table.rows:,} rows a data set (the paper: {PAPER_ROWS:,}), seed {table.seed}, four consecutive "
        "captures of each geometry, LOS and NLOS in equal parts; `sim-sitl dataset` makes the same data. LOS "
        "is the positive class; P ≥ 0.5 is called LOS.",
        "",
        f"    {table.command}",
        "",
        *_left_out(table),
    ]
    for section in table.sections:
        lines += _section(table, section)
    lines += [
        "## How to read this beside the paper",
        "",
        "- The paper does not say how its rows were split; consecutive rows of a moving user are alike, and "
        "a split by row lets a classifier meet nearly the same response twice. *Split by row* shows what "
        "that does here.",
        "- Its AUCs of RF, GPC and SVM lie just under their accuracies, as AUCs of hard labels do; ours of "
        "hard labels are in the column *AUC (labels)*.",
        "- Its SVM and GPC lie 24 points under its RF. Compare ours with standardised features (as its text "
        "says they were) and in *Features as they come*, at both bandwidths.",
        "- Noise follows from the link budget, and obstructed links are weaker: *The same noise for both "
        "labels* shows what is left when that is taken away.",
        "- GPC is trained on 1,000 captures (its cost grows with their cube), SVM on at most 12,000, RF and "
        "the network on all. scikit-learn's GPC has a logistic link, the paper's a probit.",
        "- Times are CPU time of one thread of this machine in batches, of the classification alone, "
        "features or inputs given; the paper's are of another machine.",
        "",
        f"Made in {table.wall_s:.0f} s.",
        "",
    ]
    return "\n".join(lines)


def _left_out(table: Table3) -> list[str]:
    if not table.left_out:
        return []
    told = ", ".join(f"{count} {reason}" for reason, count in sorted(table.left_out.items()))
    return [f"Captures of which no input can be made, left out for all alike: {told}.", ""]


def _section(table: Table3, section: Section) -> list[str]:
    lines = [f"## {section.title}", "", section.note, ""]
    if section.splits > 1:
        lines += [f"Mean of {section.splits} splits (least to greatest).", ""]
    for instance in section.instances:
        if len(section.instances) > 1:
            lines += [f"### {_INSTANCES[instance][0].upper()}{_INSTANCES[instance][1:]}", ""]
        with_paper = section.paper and instance == CAPTURE
        heads = [
            "", "accuracy", *(["paper"] if with_paper else []), "precision",
            *(["paper"] if with_paper else []), "recall", "F1", "AUC", "AUC (labels)",
            *(["paper's AUC"] if with_paper else []), "ECE",
            "NLOS called LOS", f"at {CAUTIOUS:g}", "LOS called NLOS", f"at {CAUTIOUS:g}", "ms",
            *(["paper's"] if with_paper else []),
        ]  # fmt: skip
        lines += [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
        for entry in section.entries:
            cells = _cells(table.of(section.key, entry.name, instance), entry.name, with_paper)
            lines.append(f"| {entry.name} | {' | '.join(cells)} |")
        lines.append("")
    if section.paper:
        lines += [f"![ROC, reliability, accuracy](table3-{section.key}.png)", ""]
    return lines


def _cells(outcomes: Sequence[Outcome], name: str, with_paper: bool) -> list[str]:
    def of(metric: Callable[[Figures], float]) -> str:
        return _ranged([metric(outcome.figures) for outcome in outcomes])

    def printed(value: float | None) -> list[str]:
        return [("–" if value is None else f"{value:.4f}")] if with_paper else []

    paper = PAPER.get(name)
    cautious = [outcome.cautious for outcome in outcomes]
    return [
        of(lambda f: f.accuracy), *printed(paper.accuracy if paper else None),
        of(lambda f: f.precision), *printed(paper.precision if paper else None),
        of(lambda f: f.recall), of(lambda f: f.f1), of(lambda f: f.auc), of(lambda f: f.auc_hard),
        *printed(paper.auc if paper else None), of(lambda f: f.ece), of(lambda f: f.nlos_called_los),
        f"{_mean([f.nlos_called_los for f in cautious]):.3f}", of(lambda f: f.los_called_nlos),
        f"{_mean([f.los_called_nlos for f in cautious]):.3f}",
        f"{min(outcome.predict_ms for outcome in outcomes):.3g}", *printed(paper.time_ms if paper else None),
    ]  # fmt: skip


# ── picture ───────────────────────────────────────────────────────────────────────────────────


def plot(table: Table3, section: Section) -> bytes:
    """PNG: ROC and reliability of the first split, accuracy beside the paper's with its range."""
    # Not pyplot: no global state, no window system.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14.0, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3)
    instance = section.instances[0]
    names = [entry.name for entry in section.entries]
    for place, name in enumerate(names):
        first = table.of(section.key, name, instance)[0]
        color, marker = _COLORS[place % len(_COLORS)], _MARKERS[place % len(_MARKERS)]
        false_los, true_los = roc(first.probability, first.is_los)
        left.plot(false_los, true_los, color=color, label=name)
        left.plot(first.figures.nlos_called_los, first.figures.recall, color=color, marker=marker)
        mean, share, _ = reliability(first.probability, first.is_los)
        middle.plot(mean, share, color=color, marker=marker, markersize=4, label=name)
        values = [outcome.figures.accuracy for outcome in table.of(section.key, name, instance)]
        centre = _mean(values)
        right.barh(
            place,
            centre,
            color=color,
            xerr=[[centre - min(values)], [max(values) - centre]],
            height=0.6,
            capsize=3,
        )
        if name in PAPER:
            right.plot(
                PAPER[name].accuracy,
                place,
                marker="d",
                color="#000000",
                fillstyle="none",
                markersize=9,
                linestyle="",
            )
    left.set(
        xlim=(0, 0.4), ylim=(0.6, 1), xlabel="share of NLOS called LOS", ylabel="share of LOS called LOS"
    )
    left.set_title("ROC, first split (mark: P ≥ 0.5)", fontsize=9)
    middle.plot([0, 1], [0, 1], color="#7F7F7F", linestyle="--", linewidth=1)
    middle.set(
        xlim=(0, 1), ylim=(0, 1), xlabel="P(line of sight), mean of a bin", ylabel="share of LOS in the bin"
    )
    middle.set_title("reliability, first split", fontsize=9)
    right.plot([], [], marker="d", color="#000000", fillstyle="none", linestyle="", label="paper, Table III")
    right.set_yticks(range(len(names)), names, fontsize=8)
    right.set(xlim=(0.6, 1.0), xlabel="accuracy (bar: range over splits)")
    right.invert_yaxis()
    for axes in (left, middle, right):
        axes.grid(alpha=0.3)
    handles, labels = left.get_legend_handles_labels()
    more, texts = right.get_legend_handles_labels()
    figure.legend(
        handles + more, labels + texts, loc="outside lower center", ncols=4, fontsize=8, frameon=False
    )
    figure.suptitle(
        f"{section.title}: {_INSTANCES[instance]}, {table.rows:,} rows, seed {table.seed}", fontsize=10
    )
    stream = BytesIO()
    # Without the date and the program's version: the same figures give the same picture.
    figure.savefig(stream, format="png", dpi=130, metadata={"Software": None})
    return stream.getvalue()


# ── numbers ───────────────────────────────────────────────────────────────────────────────────


def _spread(values: Sequence[float]) -> tuple[float, float, float]:
    return _mean(values), min(values), max(values)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def _ranged(values: Sequence[float]) -> str:
    mean, low, high = _spread(values)
    if math.isnan(mean):
        return "–"
    return f"{mean:.4f}" if len(values) == 1 else f"{mean:.4f} ({low:.3f}–{high:.3f})"
