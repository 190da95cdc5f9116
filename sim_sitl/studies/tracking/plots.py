"""The tracking study's pictures: error against time, and how honest the regions are.

Rules: every axis has its unit; intervals are drawn; a method has one colour and marker in all pictures,
told apart without colour too (Okabe and Ito's palette, markers, line styles).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

import numpy as np

from sim_sitl.studies.tracking.answers import SHARES
from sim_sitl.studies.tracking.pieces import CaseResult
from sim_sitl.studies.tracking.scores import Score, share_figure

_DPI = 130


@dataclass(frozen=True, slots=True)
class _Style:
    color: str
    marker: str
    line: str = "-"
    width: float = 1.3


_STYLES = {
    "tracker": _Style("#0072B2", "o", "-", 2.4),
    "tracker-service": _Style("#56B4E9", "v", "--"),
    "still": _Style("#009E73", "^", ":"),
    "particles": _Style("#D55E00", "s"),
    "least-squares": _Style("#E69F00", "D"),
    "centre": _Style("#7F7F7F", "|", ":"),
    "exact": _Style("#000000", "", "--", 2.0),
}


def error_and_honesty(
    title: str, scores: Sequence[Score], result: CaseResult, times_s: tuple[float, ...]
) -> bytes:
    """PNG: RMSE over time; of the tracker and others, the share of truths in regions of every content."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3)
    for method in result.outcomes:
        style = _STYLES[method]
        rows = [row for row in scores if row.method == method]
        value = np.array([row.rmse_m.value for row in rows])
        low, high = (np.array([getattr(row.rmse_m, end) for row in rows]) for end in ("low", "high"))
        left.errorbar(
            [row.time_s for row in rows], value, yerr=np.maximum([value - low, high - value], 0.0),
            color=style.color, marker=style.marker, linestyle=style.line, linewidth=style.width,
            markersize=5, capsize=2, label=method,
        )  # fmt: skip
    left.set(xlabel="time since the first window, s", ylabel="RMSE, m (bar: 95 % interval)", yscale="log")
    left.yaxis.set_major_formatter("{x:g}")
    left.yaxis.set_minor_formatter("{x:g}")
    left.tick_params(axis="y", which="minor", labelsize=7)
    nominal = np.linspace(0.0, 1.0, 201)
    for axes, at in ((middle, times_s.index(10.0)), (right, len(times_s) - 1)):
        for method, outcome in result.outcomes.items():
            level = np.sort(outcome.level[:, at])
            if method == "centre" or not np.isfinite(level).all():
                continue
            style = _STYLES[method]
            actual = np.searchsorted(level, nominal, side="right") / level.size
            axes.plot(nominal, actual, color=style.color, linestyle=style.line, linewidth=style.width)
        count = result.truth_enu_m.shape[0]
        bands = [share_figure(share * count, count) for share in nominal]
        axes.fill_between(
            nominal, [b.low for b in bands], [b.high for b in bands], color="#000000", alpha=0.10, linewidth=0
        )
        axes.plot([0, 1], [0, 1], color="#000000", linewidth=0.6)
        for share in SHARES:
            axes.axvline(share, color="#7F7F7F", linewidth=0.6, linestyle=":")
        axes.set(
            xlabel="content of the region", ylabel="share of runs whose truth it holds",
            xlim=(0, 1), ylim=(0, 1),
        )  # fmt: skip
        axes.set_title(f"at {times_s[at]:g} s (grey: 95 % of honest ones)", fontsize=9)
    for axes in (left, middle, right):
        axes.grid(alpha=0.3)
    figure.suptitle(title, fontsize=10)
    figure.legend(loc="outside lower center", ncols=7, fontsize=8, frameon=False)
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    return buffer.getvalue()
