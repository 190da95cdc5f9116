"""``sim-sitl study tracking`` end to end, small: the files, the same figures anywhere, honest counting."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.domain.errors import UsageError
from sim_sitl.studies import commands
from sim_sitl.studies.commands import StudyOptions, run_study
from sim_sitl.studies.tracking import cases, pieces, plots
from sim_sitl.studies.tracking.cases import CASES, SECTIONS
from sim_sitl.studies.tracking.methods import METHODS
from sim_sitl.studies.tracking.pieces import CaseResult, Outcome, pieces_of, run_piece
from sim_sitl.studies.tracking.scores import scores_of, share_figure

SHORT = ("nlos-orbit", "mixed-snapshot", "wrong-labels")


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Short flights in this process, small pictures."""
    short = {
        name: replace(case, times_s=tuple(t for t in case.times_s if t <= 10.0))
        for name, case in CASES.items()
    }
    for name, case in short.items():
        monkeypatch.setitem(CASES, name, case)
    monkeypatch.setattr(plots, "_DPI", 40)

    @contextmanager
    def one_thread(options: StudyOptions) -> Iterator[tuple[Executor, str]]:
        with ThreadPoolExecutor(1) as pool:
            yield pool, "this process"

    monkeypatch.setattr(commands, "open_executor", one_thread)


@pytest.mark.usefixtures("small")
def test_files_and_figures(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    options = StudyOptions("tracking", 2, 1, tmp_path / "out", cases=SHORT)
    files = run_study(options, lambda done, total: told.append((done, total)))
    assert told[0] == (0, 6)
    assert told[-1] == (6, 6)
    assert files[0].name == "tracking.md"
    assert {path.name for path in files} == {path.name for path in (tmp_path / "out").iterdir()}
    with (tmp_path / "out" / "tracking.csv").open() as file:
        rows = list(csv.DictReader(file))
    wanted = {
        (name, method, f"{time_s:g}")
        for name in SHORT
        for method in CASES[name].methods
        for time_s in CASES[name].times_s
    }
    assert {(row["case"], row["method"], row["time_s"]) for row in rows} == wanted
    for row in rows:
        assert float(row["rmse_low_m"]) <= float(row["rmse_m"]) <= float(row["rmse_high_m"])
        if row["method"] == "exact":
            assert float(row["rmse_over_exact"]) == 1.0
        if row["method"] == "tracker":
            assert 0.0 <= float(row["held_drawn_90"]) <= 1.0
    report = (tmp_path / "out" / "tracking.md").read_text()
    for name in SHORT:
        assert f"### {CASES[name].title}" in report
    assert "## One window of each vehicle, no movement" in report
    assert "14.1 m" in report
    with (tmp_path / "out" / "tracking-runs.csv").open() as file:
        runs = list(csv.DictReader(file))
    of_one = [
        float(run["error_east_m"]) ** 2 + float(run["error_north_m"]) ** 2 + float(run["error_up_m"]) ** 2
        for run in runs
        if (run["case"], run["method"], run["time_s"]) == ("nlos-orbit", "tracker", "10")
    ]
    score = next(r for r in rows if (r["case"], r["method"], r["time_s"]) == ("nlos-orbit", "tracker", "10"))
    assert len(of_one) == 2
    assert math.sqrt(np.mean(of_one)) == pytest.approx(float(score["rmse_m"]), rel=1e-4)


@pytest.mark.usefixtures("small")
def test_the_same_seed_gives_the_same_answers_however_the_runs_are_cut() -> None:
    whole = [run_piece(piece) for piece in pieces_of(["nlos-orbit"], ["tracker", "particles"], 2, 5)]
    cut = [run_piece(piece) for piece in pieces_of(["nlos-orbit"], ["tracker", "particles"], 2, 5, size=1)]
    one, two = CaseResult.joined(whole), CaseResult.joined(cut)
    for name in ("tracker", "particles"):
        np.testing.assert_array_equal(one.outcomes[name].error_enu_m, two.outcomes[name].error_enu_m)
        np.testing.assert_array_equal(one.outcomes[name].level, two.outcomes[name].level)


@pytest.mark.usefixtures("small")
def test_the_tracker_is_close_to_the_exact_filter_at_once() -> None:
    result = CaseResult.joined(
        [run_piece(piece) for piece in pieces_of(["nlos-snapshot"], ["tracker", "exact"], 12, 3)]
    )
    score = {row.method: row for row in scores_of("nlos-snapshot", (0.0,), result, 3)}
    assert score["tracker"].exact_ratio.value < 1.05
    assert score["exact"].held[2].value > 0.6


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        ({"cases": ("nlos-obit",)}, ("no 'nlos-obit'", "nlos-orbit")),
        ({"methods": ("trakcer",)}, ("no 'trakcer'", "tracker-service")),
        ({"cases": ("wrong-ruined",), "methods": ("exact",)}, ("has any of them",)),
        ({"name": "table4", "cases": ("nlos-orbit",)}, ("--case goes with tracking only",)),
    ],
)
def test_what_is_wrong_is_told_before_any_work(
    change: dict[str, object], parts: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commands, "open_executor", lambda *_: pytest.fail("work was begun"))
    asked = {"name": "tracking", "trials": 2, "seed": 1, "out": tmp_path, **change}
    with pytest.raises(UsageError) as refused:
        run_study(StudyOptions(**asked))  # type: ignore[arg-type]
    for part in parts:
        assert part in str(refused.value)


def test_every_case_has_a_section_and_known_methods() -> None:
    for name, case in CASES.items():
        assert case.name == name
        assert case.section in SECTIONS
        assert set(case.methods) <= set(METHODS)
        assert set(METHODS) == set(plots._STYLES)
    wrong = [case for case in CASES.values() if case.section == "wrong"]
    assert all("exact" not in case.methods for case in wrong)
    assert CASES["wrong-correlation-low"].told.settings.correlation_m == pytest.approx(25.0 / cases.FACTOR)
    assert CASES["wrong-exponent-high"].told.model.nlos_exponent_max == pytest.approx(5.25)


def test_the_yardstick_cannot_be_asked_for_where_it_is_not_exact() -> None:
    chosen = pieces.pieces_of(["wrong-ruined"], ["exact", "still"], 3, 1)
    assert [piece.methods for piece in chosen] == [("still",)]


def test_scores_count_every_run() -> None:
    error = np.zeros((4, 1, 3))
    error[:, 0, 0] = [3.0, 4.0, 1.0, 12.0]
    error[:, 0, 2] = [4.0, 3.0, 0.0, 5.0]
    nothing = np.full((4, 1, 3), np.nan)
    level = np.array([[0.2], [0.6], [0.93], [0.99]])
    ours = Outcome(error, level, np.ones((4, 1, 3)), np.ones((4, 1, 3)), np.ones((4, 1)), np.ones(4))
    exact = Outcome(0.5 * error, level, np.ones((4, 1, 3)), nothing, nothing[..., 0], np.ones(4))
    result = CaseResult(np.zeros((4, 1, 3)), {"tracker": ours, "exact": exact})
    first, second = scores_of("nlos-orbit", (10.0,), result, 1)
    assert first.rmse_m.value == pytest.approx(math.sqrt((25 + 25 + 1 + 169) / 4))
    assert first.rmse_horizontal_m.value == pytest.approx(math.sqrt((9 + 16 + 1 + 144) / 4))
    assert (first.exact_ratio.value, first.exact_ratio.low, first.exact_ratio.high) == pytest.approx(
        (2, 2, 2)
    )
    assert second.ours_ratio.value == pytest.approx(0.5)
    assert [figure.value for figure in first.held] == [0.25, 0.5, 0.75]
    assert first.held_drawn[1].value == 1.0
    assert math.isnan(second.held_drawn[1].value)
    assert (first.worst_run, first.worst_m) == (3, 13.0)


def test_wilsons_interval() -> None:
    figure = share_figure(270, 300)
    assert (figure.value, figure.low, figure.high) == pytest.approx((0.9, 0.861, 0.929), abs=1e-3)
    assert share_figure(10, 10).high == pytest.approx(1.0)
