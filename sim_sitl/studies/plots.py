"""The studies' pictures: RMSE with its intervals, the limit and the paper's figure beside it.

Rules: every axis has its unit; every interval that was computed is drawn; a method has one
colour and marker in all pictures, told apart without colour too (Okabe and Ito's palette,
markers, line styles); the legend stands beside the axes, never on them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from groundstation.localization.problem import FloatArray
from sim_sitl.studies.scoring import EXCLUDED_ABOVE_M, REFERENCE, Outcome, Score
from sim_sitl.studies.study import Axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BLACK, _ORANGE, _SKY, _GREEN, _YELLOW, _BLUE, _RED, _PURPLE, _GREY = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#B8A800", "#0072B2", "#D55E00", "#CC79A7", "#7F7F7F",
)  # fmt: skip
_LOG_FROM = 6.0
"""A range of values with this ratio or more gets a logarithmic axis."""
_DPI = 150


@dataclass(frozen=True, slots=True)
class _Style:
    color: str
    marker: str
    line: str = "-"
    width: float = 1.3


_STYLES: dict[str, _Style] = {
    "posterior": _Style(_BLUE, "o", "-", 2.4),
    "wls-ideal": _Style(_SKY, "v", "--"),
    "wls-taylor": _Style(_RED, "s"),
    "wls-taylor-bounded": _Style(_ORANGE, "D"),
    "sdp-socp": _Style(_GREEN, "^"),
    "sr-wls": _Style(_PURPLE, "P"),
    "rwls-sdp": _Style(_GREEN, "v"),
    "lsre-sdp": _Style(_YELLOW, "<", "--"),
    "lsre-sdp-iterative": _Style(_YELLOW, ">"),
    "lsre-socp": _Style(_RED, "s", "--"),
    "lsre-socp-iterative": _Style(_RED, "s"),
    "lsre-ccp": _Style(_ORANGE, "D"),
    "1aoa-nrss": _Style(_PURPLE, "X", ":"),
    "projection-3nlos": _Style(_SKY, "^"),
    "angle-reconstruction": _Style(_PURPLE, "P"),
    "projection-label-aware": _Style(_SKY, "h", "--"),
    "projection-label-aware-literal": _Style(_GREEN, "d", "--"),
    "adaptive": _Style(_PURPLE, "*"),
    "adaptive-sound": _Style(_SKY, "p", "--"),
    "centre": _Style(_GREY, "|", ":"),
}


def _style(method: str) -> _Style:
    return _STYLES.get(method, _Style(_BLACK, "."))


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    # Not pyplot: no global state, no window system.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


def _png(figure: Figure) -> bytes:
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    return buffer.getvalue()


def _scale(axes: Axes, axis: str, values: Sequence[float]) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    positive = [value for value in values if math.isfinite(value) and value > 0.0]
    if not positive or max(positive) < _LOG_FROM * min(positive):
        return
    (axes.set_xscale if axis == "x" else axes.set_yscale)("log")
    ticks = axes.xaxis if axis == "x" else axes.yaxis
    ticks.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ticks.set_major_formatter(StrMethodFormatter("{x:g}"))
    ticks.set_minor_formatter(NullFormatter())


def _spread(score: Score) -> FloatArray:
    figure = score.rmse_m
    return np.array([[max(figure.value - figure.low, 0.0)], [max(figure.high - figure.value, 0.0)]])


def dots(
    title: str, scores: Sequence[Score], limit: Score | None, limit_name: str, paper_m: Mapping[str, float]
) -> bytes:
    """PNG: RMSE of each method with its interval, the limit as a line, the paper's figure as a diamond."""
    figure, axes = _figure(8.0, 1.4 + 0.36 * len(scores))
    beyond = _beyond(scores)
    for row, score in enumerate(scores):
        if score.method in paper_m:
            axes.plot(
                paper_m[score.method], row, marker="D", color=_BLACK, fillstyle="none", linestyle="",
                label="paper, Table IV", zorder=2,
            )  # fmt: skip
        if score in beyond:
            continue
        style = _style(score.method)
        axes.errorbar(
            score.rmse_m.value, row, xerr=_spread(score), fmt=style.marker, color=style.color, capsize=3,
            markersize=7, zorder=3,
        )  # fmt: skip
        axes.annotate(
            f"{score.rmse_m.value:.4g}", (score.rmse_m.value, row), (0, 6), textcoords="offset points",
            ha="center", fontsize=8,
            bbox={"facecolor": "white", "alpha": 0.7, "linewidth": 0, "pad": 0.5},
        )  # fmt: skip
    if limit is not None:
        axes.axvline(limit.rmse_m.value, color=_BLACK, linestyle="--", label=f"limit: {limit_name}")
        axes.axvspan(limit.rmse_m.low, limit.rmse_m.high, color=_BLACK, alpha=0.12, linewidth=0)
    shown = [score for score in scores if score not in beyond]
    _scale(axes, "x", [score.rmse_m.value for score in shown] + list(paper_m.values()))
    for score in beyond:
        axes.annotate(
            f"{score.rmse_m.value:.3g} m, off the axis →", (1.0, scores.index(score)), (-6, 10),
            xycoords=axes.get_yaxis_transform(), textcoords="offset points", ha="right", va="center",
            fontsize=8, color=_style(score.method).color,
        )  # fmt: skip
    axes.set_yticks(range(len(scores)), [score.method for score in scores])
    axes.set_ylim(len(scores) - 0.4, -0.8)
    axes.set_xlabel("RMSE, m (bar: 95 % interval)")
    axes.grid(axis="x", alpha=0.3)
    axes.set_title(_titled(title), fontsize=10)
    _legend(figure, axes)
    return _png(figure)


def _beyond(scores: Sequence[Score]) -> list[Score]:
    """The scores that would squeeze all others into a corner: far above the next."""
    ordered = sorted(scores, key=lambda score: score.rmse_m.value)
    for number, (score, above) in enumerate(pairwise(ordered)):
        if number >= 1 and above.rmse_m.value > _LOG_FROM * score.rmse_m.value:
            return ordered[number + 1 :]
    return []


def series(
    title: str,
    axis: Axis,
    rows: Mapping[str, Sequence[Score]],
    limits: Sequence[Score],
    limit_name: str,
    paper_m: Mapping[str, float],
    paper_x: float | None,
) -> bytes:
    """PNG: RMSE over K or R₀, one line a method (``rows``: method → a score a point), and the limit's."""
    figure, axes = _figure(9.0, 5.0)
    x = np.array(axis.values)
    apart = 0.12 * float(np.diff(x).min()) if x.size > 1 else 0.0
    for number, (method, scores) in enumerate(rows.items()):
        style = _style(method)
        axes.errorbar(
            x + apart * _dodge(number, len(rows)), [score.rmse_m.value for score in scores],
            yerr=np.hstack([_spread(score) for score in scores]), color=style.color, marker=style.marker,
            linestyle=style.line, linewidth=style.width, markersize=5, capsize=2, label=method,
        )  # fmt: skip
        if paper_x is not None and method in paper_m:
            axes.plot(
                paper_x, paper_m[method], marker=style.marker, color=style.color, fillstyle="none",
                markersize=10, linestyle="",
            )  # fmt: skip
    if paper_x is not None and paper_m:
        axes.plot([], [], marker="o", color=_BLACK, fillstyle="none", markersize=10, linestyle="",
                  label="hollow: paper, Table IV")  # fmt: skip
    if limits:
        axes.plot(
            x,
            [score.rmse_m.value for score in limits],
            color=_BLACK,
            linestyle="--",
            label=f"limit: {limit_name}",
        )
        low, high = [s.rmse_m.low for s in limits], [s.rmse_m.high for s in limits]
        axes.fill_between(x, low, high, color=_BLACK, alpha=0.12, linewidth=0)
    values = [score.rmse_m.value for scores in rows.values() for score in scores]
    _scale(axes, "y", values + [score.rmse_m.value for score in limits] + list(paper_m.values()))
    axes.set_xticks(x, [f"{value:g}" for value in x])
    axes.set_xlabel(axis.label)
    axes.set_ylabel("RMSE, m (bar: 95 % interval)")
    axes.grid(alpha=0.3)
    axes.set_title(_titled(title), fontsize=10)
    _legend(figure, axes)
    return _png(figure)


def distribution(
    title: str, outcomes: Mapping[str, Outcome], limit_m: FloatArray | None, limit_name: str
) -> bytes:
    """PNG: share of trials with at most some error: of all, and of those that the paper's rule keeps."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True)
    errors = {method: np.sqrt(outcome.square_m2) for method, outcome in outcomes.items()}
    shown = max(float(np.percentile(error, 95.0)) for error in errors.values())
    for method, error in errors.items():
        style = _style(method)
        ordered = np.sort(error)
        kept = np.sort(error[outcomes[method].answered & (error <= EXCLUDED_ABOVE_M)])
        for axes, values in ((left, ordered), (right, kept)):
            if values.size:
                axes.plot(
                    values, np.arange(1, values.size + 1) / values.size, color=style.color,
                    linestyle=style.line, linewidth=style.width, marker=style.marker,
                    markevery=max(values.size // 8, 1), markersize=5,
                    label=method if axes is left else "_",
                )  # fmt: skip
    if limit_m is not None:
        for axes in (left, right):
            axes.plot(
                np.sort(limit_m), np.arange(1, limit_m.size + 1) / limit_m.size, color=_BLACK, linestyle="--",
                label=f"limit: {limit_name}" if axes is left else "_",
            )  # fmt: skip
    for axes, text in (
        (left, "all trials; no answer counts as the centre"),
        (right, f"the paper's rule: errors above {EXCLUDED_ABOVE_M:g} m dropped"),
    ):
        axes.set_xlim(0.0, min(shown, EXCLUDED_ABOVE_M))
        axes.set_ylim(0.0, 1.0)
        axes.set_xlabel("error, m")
        axes.grid(alpha=0.3)
        axes.set_title(text, fontsize=9)
    left.set_ylabel("share of trials")
    figure.suptitle(_titled(title), fontsize=10)
    _legend(figure, left)
    return _png(figure)


def rivals(title: str, rows: Mapping[str, Sequence[Score]]) -> bytes:
    """PNG: RMSE of every other method over ``posterior``'s, a row a case (``rows``: what it is → scores)."""
    figure, axes = _figure(10.0, 1.8 + 0.5 * len(rows))
    seen: set[str] = set()
    values: list[float] = []
    methods = list(dict.fromkeys(score.method for scores in rows.values() for score in scores))
    for row, scores in enumerate(rows.values()):
        for score in scores:
            ratio = score.reference_ratio
            if score.method == REFERENCE or not math.isfinite(ratio.value) or score.failed == score.trials:
                continue
            style = _style(score.method)
            value = 1.0 / ratio.value
            height = row + 0.6 * _dodge(methods.index(score.method), len(methods))
            span = np.array([[max(value - 1.0 / ratio.high, 0.0)], [max(1.0 / ratio.low - value, 0.0)]])
            axes.errorbar(
                value, height, xerr=span, fmt=style.marker, color=style.color, capsize=2, markersize=6,
                fillstyle="none" if style.line == "--" else "full",
                label="_" if score.method in seen else score.method,
            )  # fmt: skip
            seen.add(score.method)
            values.append(value)
    axes.axvline(1.0, color=_BLUE, linewidth=2.0, label=REFERENCE)
    axes.axvspan(1.0 / 1.05, 1.0, color=_BLUE, alpha=0.15, linewidth=0, label="within 5 %")
    _scale(axes, "x", values)
    axes.set_yticks(
        range(len(rows)), [_wrapped(title.partition(": ")[2] or title) for title in rows], fontsize=8
    )
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlabel(f"RMSE over that of {REFERENCE}, same trials (bar: 95 % interval)")
    axes.grid(alpha=0.3)
    axes.set_title(_titled(title), fontsize=10)
    _legend(figure, axes)
    return _png(figure)


def _dodge(number: int, count: int) -> float:
    """−0.5 to 0.5: what sets marks at one place apart, so that none hides another."""
    return (number + 0.5) / count - 0.5


def _wrapped(text: str) -> str:
    return _symbols("\n".join(wrap(text, 40)))


def _titled(text: str) -> str:
    return _symbols("\n".join(part for line in text.split("\n") for part in wrap(line, 64)))


def _symbols(text: str) -> str:
    return text.replace("σ_θ", r"$\sigma_\theta$").replace("σ_φ", r"$\sigma_\varphi$")


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    if unique:
        names = ["\n".join(wrap(label, 32)) for label in unique]
        figure.legend(unique.values(), names, loc="outside right upper", fontsize=8, frameon=False)
