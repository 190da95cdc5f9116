"""Pictures: axes carry units, intervals and the paper's figures are drawn, nothing hides another."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure as Picture

from sim_sitl.studies import plots
from sim_sitl.studies.commands import STUDIES
from sim_sitl.studies.scoring import Figure, Outcome, Score
from sim_sitl.studies.study import Axis

NONE = Figure(math.nan, math.nan, math.nan)


def score(method: str, rmse_m: float, ratio: Figure = NONE, failed: int = 0) -> Score:
    spread = Figure(rmse_m, 0.9 * rmse_m, 1.2 * rmse_m)
    return Score(
        "case", method, 10, spread, rmse_m, rmse_m, rmse_m, failed, 0, 0, spread, NONE, ratio, math.nan,
        math.nan, math.nan, 0.0,
    )  # fmt: skip


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Picture]:
    """The figures that were drawn, kept for a look at what is on them."""
    kept: list[Picture] = []
    real = plots._png

    def keep(figure: Picture) -> bytes:
        kept.append(figure)
        return real(figure)

    monkeypatch.setattr(plots, "_png", keep)
    return kept


def texts(picture: Picture) -> list[str]:
    return [text.get_text() for legend in picture.legends for text in legend.get_texts()]


def test_dots_show_intervals_limit_and_paper(drawn: list[Picture]) -> None:
    rows = [score("wls-taylor", 2.0), score("posterior", 1.9)]
    png = plots.dots("LOS", rows, score("limit", 1.8), "CRLB", {"wls-taylor": 2.33})
    assert png.startswith(b"\x89PNG")
    axes = drawn[0].axes[0]
    assert axes.get_xlabel() == "RMSE, m (bar: 95 % interval)"
    assert [label.get_text() for label in axes.get_yticklabels()] == ["wls-taylor", "posterior"]
    bars = [container for container in axes.containers if container.has_xerr]
    assert len(bars) == 2
    assert set(texts(drawn[0])) == {"paper, Table IV", "limit: CRLB"}


def test_a_method_far_off_does_not_squeeze_the_others(drawn: list[Picture]) -> None:
    rows = [score("wls-taylor", 2.0), score("posterior", 1.9), score("centre", 70.0)]
    plots.dots("LOS", rows, None, "CRLB", {})
    axes = drawn[0].axes[0]
    assert axes.get_xlim()[1] < 10.0
    assert any("70 m, off the axis" in text.get_text() for text in axes.texts)


def test_a_series_has_a_line_a_method_and_the_limit(drawn: list[Picture]) -> None:
    rows = {
        name: [score(name, value * factor) for value in (10.0, 20.0, 40.0)]
        for name, factor in (("posterior", 1.0), ("lsre-socp", 2.0))
    }
    limits = [score("limit", value) for value in (9.0, 18.0, 36.0)]
    axis = Axis("radius R₀, m", (100.0, 200.0, 400.0))
    plots.series("NLOS", axis, rows, limits, "exact posterior mean", {"lsre-socp": 57.5}, 100.0)
    axes = drawn[0].axes[0]
    assert axes.get_xlabel() == "radius R₀, m"
    assert axes.get_ylabel().startswith("RMSE, m")
    assert axes.get_yscale() == "log"
    assert texts(drawn[0]) == [
        "hollow: paper, Table IV", "limit: exact posterior mean", "posterior", "lsre-socp",
    ]  # fmt: skip
    hollow = [line for line in axes.lines if line.get_fillstyle() == "none" and len(line.get_xdata()) == 1]
    assert [float(line.get_ydata()[0]) for line in hollow] == [57.5]


def outcome(error_m: Any) -> Outcome:
    error = np.zeros((len(error_m), 3))
    error[:, 0] = error_m
    yes, nothing = np.ones(len(error_m), dtype=bool), np.full(len(error_m), np.nan)
    return Outcome(error, yes, yes, nothing, nothing, nothing, 0.0)


def test_a_distribution_stands_by_both_rules_with_the_limit(drawn: list[Picture]) -> None:
    found = {"posterior": outcome([10.0, 20.0, 30.0, 40.0]), "rwls-sdp": outcome([50.0, 60.0, 900.0, 1.0])}
    plots.distribution("end to end", found, np.array([9.0, 19.0]), "exact posterior mean")
    left, right = drawn[0].axes
    assert left.get_xlabel() == "error, m"
    assert left.get_ylabel() == "share of trials"
    sizes = [[len(line.get_xdata()) for line in axes.lines] for axes in (left, right)]
    assert sizes == [[4, 4, 2], [4, 3, 2]]
    assert texts(drawn[0]) == ["posterior", "rwls-sdp", "limit: exact posterior mean"]


def test_rivals_stand_beside_the_posterior_and_who_never_answered_does_not(drawn: list[Picture]) -> None:
    rows = {
        "NLOS: an uneven ring": [
            score("posterior", 10.0, Figure(1.0, 1.0, 1.0)),
            score("lsre-socp", 20.0, Figure(0.5, 0.4, 0.6)),
            score("lsre-ccp", 10.0, Figure(1.0, 1.0, 1.0), failed=10),
        ]
    }
    plots.rivals("hard", rows)
    axes = drawn[0].axes[0]
    assert set(texts(drawn[0])) == {"posterior", "within 5 %", "lsre-socp"}
    (bar,) = axes.containers
    assert float(bar.lines[0].get_xdata()[0]) == pytest.approx(2.0)
    assert [label.get_text() for label in axes.get_yticklabels()] == ["an uneven ring"]


def test_every_method_of_a_picture_can_be_told_from_the_others_without_colour() -> None:
    for study in STUDIES.values():
        for section in study.sections:
            shown = [plots._STYLES[name] for name in section.methods]
            assert len({(style.marker, style.line) for style in shown}) == len(shown), section.title


def test_the_same_scores_give_the_same_bytes() -> None:
    rows = [score("wls-taylor", 2.0)]
    assert plots.dots("a", rows, None, "", {}) == plots.dots("a", rows, None, "", {})
