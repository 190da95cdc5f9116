"""The files of a study: what they hold, beside what, and that a clock never enters the results."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from sim_sitl.studies import paper, report
from sim_sitl.studies.chunks import ChunkResult
from sim_sitl.studies.figures import FIGURES
from sim_sitl.studies.hard import HARD
from sim_sitl.studies.result_files import cdf_csv, profile_csv, results_csv
from sim_sitl.studies.results import Results
from sim_sitl.studies.scoring import Figure, Outcome, Score
from sim_sitl.studies.study import Study
from sim_sitl.studies.table4 import TABLE4

METHODS = ("wls-taylor", "lsre-socp", "lsre-socp-iterative", "adaptive", "posterior", "centre")


def sections(study: Study, *keys: str) -> Study:
    """The study with these sections and cheap methods only."""
    return replace(study, sections=tuple(section for section in study.sections if section.key in keys)).only(
        METHODS
    )


@pytest.fixture(scope="module")
def table4(computed: Callable[..., Results]) -> tuple[Study, Results]:
    study = sections(TABLE4, "los", "nlos-eq8", "nlos-paper")
    return study, computed(study, 20)


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(StringIO(text)))


def test_the_csv_has_a_row_a_case_and_method_and_the_limit(table4: tuple[Study, Results]) -> None:
    study, results = table4
    rows = rows_of(results_csv(study, results))
    assert [(row["case"], row["method"]) for row in rows] == [
        ("los-k4", "wls-taylor"), ("los-k4", "posterior"), ("los-k4", "centre"), ("los-k4", "limit"),
        *((case, name) for case in ("nlos-k4", "nlos-rubble-k4")
          for name in ("lsre-socp-iterative", "lsre-socp", "posterior", "centre", "limit")),
    ]  # fmt: skip
    for row in rows:
        assert float(row["rmse_low_m"]) <= float(row["rmse_m"]) <= float(row["rmse_high_m"])
        assert row["trials"] == "20"
        assert row["seed"] == "7"
        assert row["vehicles"] == "4"


def test_the_csv_gives_what_the_trials_were(table4: tuple[Study, Results]) -> None:
    study, results = table4
    row = rows_of(results_csv(study, results))[0]
    chunk = results.chunks["los-k4"]
    square = chunk.outcomes["wls-taylor"].square_m2
    rmse = math.sqrt(square.mean())
    assert float(row["rmse_m"]) == pytest.approx(rmse, rel=1e-5)
    assert float(row["median_m"]) == pytest.approx(np.median(np.sqrt(square)), rel=1e-5)
    limit = math.sqrt(chunk.limit_square_m2.mean())
    assert float(row["rmse_over_limit"]) == pytest.approx(rmse / limit, rel=1e-5)
    assert row["limit_name"] == "CRLB"


def test_the_papers_figure_stands_beside_its_own_case_only(table4: tuple[Study, Results]) -> None:
    study, results = table4
    published = {
        (row["case"], row["method"]): row["paper_rmse_m"] for row in rows_of(results_csv(study, results))
    }
    assert published["los-k4", "wls-taylor"] == "2.3312"
    assert published["los-k4", "limit"] == "2.2189"
    assert published["los-k4", "posterior"] == ""
    assert published["nlos-k4", "lsre-socp-iterative"] == ""
    assert published["nlos-rubble-k4", "lsre-socp-iterative"] == "57.5073"
    text = report.markdown(study, results)
    start, end = text.index("## NLOS environment, eq. (8)"), text.index("## NLOS environment, the paper")
    rows = [line.split("|") for line in text[start:end].splitlines() if line.startswith("| ")][1:]
    assert {cells[2].strip() for cells in rows} == {"–"}


def test_the_results_hold_no_clock(computed: Callable[..., Results], table4: tuple[Study, Results]) -> None:
    study, first = table4
    slower = {
        case: ChunkResult(
            {name: replace(outcome, cpu_s=99.0) for name, outcome in chunk.outcomes.items()},
            chunk.limit_square_m2,
            dict.fromkeys(chunk.stages_cpu_s, 99.0),
        )
        for case, chunk in first.chunks.items()
    }
    second = Results.of(slower, replace(first.provenance, wall_s=1e6))
    assert results_csv(study, second) == results_csv(study, first)
    assert profile_csv(study, second) != profile_csv(study, first)


def test_the_profile_shares_add_up(table4: tuple[Study, Results]) -> None:
    study, results = table4
    rows = rows_of(profile_csv(study, results))
    for case in ("los-k4", "nlos-k4", "nlos-rubble-k4"):
        mine = [row for row in rows if row["case"] == case]
        assert {"draw", "score", "limit", "posterior"} <= {row["stage"] for row in mine}
        assert sum(float(row["share"]) for row in mine) == pytest.approx(1.0, abs=1e-4)


def test_the_report_says_how_to_make_it_again(table4: tuple[Study, Results]) -> None:
    study, results = table4
    text = report.markdown(study, results)
    assert "20 trials a case, seed 7" in text
    assert "`sim-sitl study table4 --trials 20 --seed 7 --out out`" in text
    assert "numpy" in text
    assert "Where the time went" in text
    assert "| LOS environment |" in text
    for section in study.sections:
        assert f"![{section.title}](table4-{section.key}.png)" in text
    assert paper.NOTES["LOS"] in text
    lines = text.splitlines()
    row = next(line for line in lines if line.startswith("| wls-taylor |"))
    heading = next(line for line in lines if line.startswith("| method | paper"))
    assert row.count("|") == heading.count("|")
    assert "| 2.331 |" in row
    limit = next(line for line in lines if line.startswith("| **limit**"))
    assert limit.count("|") == heading.count("|")


def test_files_are_replaced_and_others_left_alone(tmp_path: Path, table4: tuple[Study, Results]) -> None:
    study, results = table4
    (tmp_path / "table4.csv").write_text("old")
    (tmp_path / "notes.txt").write_text("mine")
    paths = report.write_report(study, results, tmp_path)
    assert paths[0] == tmp_path / "table4.md"
    assert {path.name for path in paths} == {
        "table4.md", "table4.csv", "table4-profile.csv", "table4-los.png", "table4-nlos-eq8.png",
        "table4-nlos-paper.png",
    }  # fmt: skip
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in paths} | {"notes.txt"}
    assert (tmp_path / "table4.csv").read_text().startswith("section,case,")
    for path in paths:
        if path.suffix == ".png":
            assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")


def test_a_series_has_a_column_a_point_and_the_paper_at_its_own(computed: Callable[..., Results]) -> None:
    study = next(study for study in FIGURES if study.name == "fig3").only(METHODS)
    text = report.markdown(study, computed(study, 12))
    assert "| method | 4 | 5 | 6 | 7 |" in text
    row = next(line for line in text.splitlines() if line.startswith("| wls-taylor |"))
    assert row.count("; paper 2.331") == 1
    assert row.index("paper 2.331") < row.index("|", row.index("|", 2) + 1)
    ratios = [line for line in text.splitlines() if line.startswith("| wls-taylor |")][1]
    assert ratios.count("[") == 4


def test_rivals_name_the_best_other_method(computed: Callable[..., Results]) -> None:
    whole = sections(HARD, "nlos")
    study = replace(
        whole, sections=(replace(whole.sections[0], cases=("hard-outside-nlos", "hard-k2-nlos")),)
    )
    results = computed(study, 15)
    text = report.markdown(study, results)
    scores = results.scores["hard-outside-nlos"]
    others = [scores[name] for name in ("lsre-socp", "lsre-socp-iterative", "centre")]
    best = min(others, key=lambda score: score.rmse_m.value)
    row = next(line for line in text.splitlines() if line.startswith("| NLOS: targets outside"))
    cells = [cell.strip() for cell in row.split("|")]
    assert cells[5] == best.method
    expected = scores["posterior"].rmse_m.value / best.rmse_m.value
    assert float(cells[7].split()[0]) == pytest.approx(expected, abs=6e-4)
    # With two links the weighted centroid answers nothing: told, and no rival.
    few = next(line for line in text.splitlines() if line.startswith("| NLOS: two vehicles"))
    assert "(15 no answer)" in few
    assert few.split("|")[5].strip() == "centre"


def score(method: str, rmse_m: float, failed: int = 0) -> Score:
    none = Figure(math.nan, math.nan, math.nan)
    return Score(
        "a", method, 10, Figure(rmse_m, rmse_m, rmse_m), rmse_m, rmse_m, rmse_m, failed, 0, 0, none, none,
        none, math.nan, math.nan, math.nan, 0.0,
    )  # fmt: skip


def test_who_never_answered_is_no_rival() -> None:
    scores = [score("posterior", 1.0), score("limit", 0.5), score("x", 2.0, failed=10), score("y", 3.0, 4)]
    best = report.best_other(scores)
    assert best is not None
    assert best.method == "y"
    assert report.best_other(scores[:3]) is None


def test_who_is_told_the_truth_is_no_rival() -> None:
    best = report.best_other([score("wls-ideal", 1.0), score("wls-taylor", 2.0)])
    assert best is not None
    assert best.method == "wls-taylor"


def test_the_distribution_is_given_in_percentiles(computed: Callable[..., Results]) -> None:
    # The form of fig10 on a cheap case.
    fig10 = next(study for study in FIGURES if study.name == "fig10")
    section = replace(fig10.sections[0], cases=("mixed-k4",), methods=("posterior", "centre"))
    study = replace(fig10, sections=(section,))
    results = computed(study, 30)
    chunk = results.chunks["mixed-k4"]
    far = chunk.outcomes["centre"]
    error = far.error_enu_m.copy()
    error[0] = (3000.0, 0.0, 0.0)
    changed = Outcome(
        error, far.answered, far.settled, far.in_ellipse, far.in_ellipsoid, far.in_region, far.cpu_s
    )
    results = Results.of(
        {"mixed-k4": replace(chunk, outcomes={**chunk.outcomes, "centre": changed})}, results.provenance
    )
    rows = [row for row in rows_of(cdf_csv(section, results)) if row["method"] == "centre"]
    assert len(rows) == 101
    assert float(rows[-1]["share_of_trials"]) == 1.0
    assert float(rows[-1]["error_m"]) == pytest.approx(3000.0)
    assert float(rows[-1]["error_kept_m"]) < 500.0
    assert float(rows[50]["error_m"]) == pytest.approx(np.median(np.linalg.norm(error, axis=1)), rel=1e-5)
    assert "(1)" in next(
        line for line in report.markdown(study, results).splitlines() if "| centre |" in line
    )


@pytest.mark.parametrize(
    ("value", "text"), [(2.33123, "2.331"), (57.5073, "57.5"), (math.nan, "–"), (123456.0, "1.23e+05")]
)
def test_numbers_are_short(value: float, text: str) -> None:
    assert report.number(value) == text


def test_intervals_and_shares_are_readable() -> None:
    assert report.interval(Figure(2.0, 1.9, 2.1)) == "2.000 [1.900, 2.100]"
    assert report.interval(Figure(math.nan, math.nan, math.nan)) == "–"
    assert report.percent(0.9012) == "90.1 %"
