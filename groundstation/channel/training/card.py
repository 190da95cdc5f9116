"""The model card: what a classifier was trained on and how far to trust it.

Rule kept here: figures as measured, the command and the seed that give them again, and what
was not measured said as plainly. Markdown for people, the same content as JSON for programs.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from groundstation.channel.training.evaluation import CAUTIOUS_THRESHOLD, Evaluation, Interval

CARD_FILE = "card.md"
CARD_JSON_FILE = "card.json"


@dataclass(frozen=True, slots=True)
class SeedFigures:
    """What one seed came to."""

    seed: int
    validation_loss: float
    """Cross-entropy on the links of early stopping; NaN where folds stood in for them."""
    accuracy: float
    balanced_accuracy: float
    auc: float
    ece: float


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """One point of the learning curve."""

    groups: int
    """Groups trained on (the mean over folds)."""
    auc: float
    balanced_accuracy: float


@dataclass(frozen=True, slots=True)
class Card:
    """Everything the card says."""

    version: str
    parameters: int
    model_bytes: int
    temperature: float
    bias: float
    novelty_max: float
    los_threshold: float
    data_name: str
    data_sha256: str
    start: str
    """What the training began with."""
    groups: int
    split: str
    """How links were divided."""
    left_out: Mapping[str, int]
    options: Mapping[str, object]
    command: str
    evaluations: Sequence[Evaluation]
    seeds: Sequence[SeedFigures] = ()
    learning_curve: Sequence[CurvePoint] = ()
    novelty_rate: float = field(default=math.nan)
    """Share of the held-out links called unlike anything seen."""
    notes: str = ""
    """``notes.md`` of the folder, as it is."""
    method: str = ""
    """What it is, where it is not the paper's network alone."""


def write_card(folder: Path, card: Card) -> None:
    """Write ``card.md`` and ``card.json``."""
    (folder / CARD_FILE).write_text("\n".join(_lines(card)), encoding="utf-8")
    text = json.dumps(_plain(asdict(card)), indent=2, ensure_ascii=False)
    (folder / CARD_JSON_FILE).write_text(text + "\n", encoding="utf-8")


def _lines(card: Card) -> list[str]:
    dropped = ", ".join(f"{count} {reason}" for reason, count in card.left_out.items()) or "none"
    settings = ", ".join(f"{name} {value}" for name, value in card.options.items())
    lines = [
        f"# Channel classifier {card.version}",
        "",
        "P(line of sight) of a radio link from its channel impulse responses: "
        + (card.method or "the CNN–LSTM of the paper (Gao & Sadjadpour, 2026), III-B")
        + f"; {card.parameters:,} parameters, "
        f"{card.model_bytes / 1e3:.0f} kB ONNX, ONNX Runtime on one thread.",
        "",
        f"- Data: `{card.data_name}` (SHA-256 {card.data_sha256[:16]}…), {card.groups:,} groups. "
        f"{card.split}",
        f"- Began with {card.start}.",
        f"- Captures left out as unusable: {dropped}.",
        _calibration(card),
        _novelty(card),
        f"- Options: {settings}.",
        f"- Command: `{card.command}`",
        "",
        "Brackets: 95 % by bootstrap over groups. ECE: as the data are / with both classes weighted alike.",
        "",
        "| links | n | groups | accuracy | balanced | AUC | ECE |",
        "|---|---|---|---|---|---|---|",
    ]
    for item in card.evaluations:
        now = item.figures
        lines.append(
            f"| {item.title} | {now.links:,} | {item.groups:,} | {now.accuracy:.3f} "
            f"| {now.balanced_accuracy:.3f} {_bracket(item.balanced_interval)} "
            f"| {now.auc:.3f} {_bracket(item.auc_interval)} | {now.ece:.3f} / {item.ece_even:.3f} |"
        )
    lines += ["", *_mistakes(card)]
    if card.seeds:
        lines += ["", *_seeds(card)]
    if card.learning_curve:
        lines += ["", "## Learning curve", "", "| groups trained on | AUC | balanced |", "|---|---|---|"]
        lines += [f"| {p.groups} | {p.auc:.3f} | {p.balanced_accuracy:.3f} |" for p in card.learning_curve]
    lines.append("")
    if card.notes:
        lines.append(card.notes)
    return lines


def _calibration(card: Card) -> str:
    fitted = (
        "P = σ(logit), every log counted once"
        if card.method
        else f"P = σ(logit / {card.temperature:.3f} {card.bias:+.3f}), fitted on links that the "
        "network was not trained on"
    )
    return f"- Calibration: {fitted}, LOS and NLOS weighted alike: shift the log odds where you know better."


def _novelty(card: Card) -> str:
    if not math.isfinite(card.novelty_max):
        return "- Links unlike the training data are not told apart: too few groups to learn what is usual."
    rate = "" if math.isnan(card.novelty_rate) else f" ({100 * card.novelty_rate:.2f} % of the held-out ones)"
    return f"- Links whose novelty passes {card.novelty_max:.2f}{rate} are `unknown`: unlike anything seen."


def _mistakes(card: Card) -> list[str]:
    if not card.evaluations:
        return []
    first = card.evaluations[0]
    lines = [
        "## Mistakes and the threshold",
        "",
        f"Confusion on: {first.title}. A NLOS link taken for LOS pulls an estimate by its excess loss; a LOS "
        "link taken for NLOS only costs its angles. A threshold t costs least where the first mistake weighs "
        f"t / (1 − t) times the second: 0.5 alike, {CAUTIOUS_THRESHOLD} three times. The model's own "
        f"threshold is {card.los_threshold}; localisation weighs by the probability itself.",
        "",
        "| threshold | LOS called LOS | LOS called NLOS | NLOS called LOS | NLOS called NLOS "
        "| NLOS called LOS, share |",
        "|---|---|---|---|---|---|",
    ]
    for threshold, counts, now in (
        (0.5, first.confusion, first.figures),
        (CAUTIOUS_THRESHOLD, first.cautious_confusion, first.cautious),
    ):
        lines.append(
            f"| {threshold} | {counts.los_called_los:,} | {counts.los_called_nlos:,} "
            f"| {counts.nlos_called_los:,} | {counts.nlos_called_nlos:,} | {now.nlos_called_los:.3f} |"
        )
    return lines


def _seeds(card: Card) -> list[str]:
    lines = [
        "## Seeds",
        "",
        "| seed | validation loss | accuracy | balanced | AUC | ECE |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {one.seed} | {one.validation_loss:.4f} | {one.accuracy:.3f} | {one.balanced_accuracy:.3f} "
        f"| {one.auc:.3f} | {one.ece:.3f} |"
        for one in card.seeds
    ]
    if len(card.seeds) > 1:
        areas = [one.auc for one in card.seeds]
        mean = sum(areas) / len(areas)
        deviation = math.sqrt(sum((area - mean) ** 2 for area in areas) / (len(areas) - 1))
        lines += ["", f"AUC over seeds: {mean:.3f} ± {deviation:.3f} (standard deviation)."]
    else:
        lines += ["", "One seed: how much the figures owe to it was not measured."]
    return lines


def _bracket(interval: Interval) -> str:
    return "" if math.isnan(interval.low) else f"[{interval.low:.3f}, {interval.high:.3f}]"


def _plain(value: object) -> object:
    """JSON has no NaN and no infinity: null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value if isinstance(value, int | str | bool) or value is None else str(value)
