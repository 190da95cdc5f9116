"""The model card: what a classifier was trained on and how far to trust it.

Rule kept here: figures as measured, the command and the seed that give them again, and what
was not measured said as plainly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from groundstation.channel.training.metrics import Figures

CARD_FILE = "card.md"


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Figures on one set of links."""

    title: str
    figures: Figures
    """At P ≥ 0.5."""
    cautious: Figures
    """At P ≥ 0.75, where a NLOS called LOS costs three times the opposite."""


def write_card(
    folder: Path,
    *,
    version: str,
    parameters: int,
    model_bytes: int,
    temperature: float,
    data_name: str,
    counts: tuple[int, int, int],
    grouped: bool,
    left_out: Mapping[str, int],
    options: Mapping[str, object],
    command: str,
    evaluations: Sequence[Evaluation],
) -> None:
    """Write ``card.md``; a ``notes.md`` in the folder is appended to it as it is."""
    split = "geometry (`log_id`)" if grouped else "row: the file has no `log_id`, so the figures flatter"
    dropped = ", ".join(f"{count} {reason}" for reason, count in left_out.items()) or "none"
    settings = ", ".join(f"{name} {value}" for name, value in options.items())
    lines = [
        f"# Channel classifier {version}",
        "",
        "P(line of sight) of a radio link from its channel impulse responses: the CNN–LSTM of "
        f"the paper (Gao & Sadjadpour, 2026), III-B; {parameters:,} parameters, "
        f"{model_bytes / 1e3:.0f} kB ONNX, ONNX Runtime on one thread.",
        "",
        f"- Trained on `{data_name}`: {counts[0]:,} links; {counts[1]:,} for early stopping and calibration; "
        f"{counts[2]:,} held out for the figures. Split by {split}.",
        f"- Captures left out as unusable: {dropped}.",
        f"- Temperature {temperature:.3f}, fitted on the validation links.",
        f"- Options: {settings}.",
        f"- Command: `{command}`",
        "",
        "| links | n | accuracy | balanced | AUC | ECE | NLOS called LOS at P ≥ 0.5 "
        "| at 0.75 | LOS called NLOS at 0.5 | at 0.75 |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for evaluation in evaluations:
        now, cautious = evaluation.figures, evaluation.cautious
        lines.append(
            f"| {evaluation.title} | {now.links:,} | {now.accuracy:.3f} | {now.balanced_accuracy:.3f} "
            f"| {now.auc:.3f} | {now.ece:.3f} | {now.nlos_called_los:.3f} | {cautious.nlos_called_los:.3f} "
            f"| {now.los_called_nlos:.3f} | {cautious.los_called_nlos:.3f} |"
        )
    lines += [
        "",
        "One seed, one split: no interval is given. Probabilities assume LOS and NLOS in the proportion of "
        "the training data.",
        "",
    ]
    notes = folder / "notes.md"
    if notes.is_file():
        lines.append(notes.read_text(encoding="utf-8"))
    (folder / CARD_FILE).write_text("\n".join(lines), encoding="utf-8")
