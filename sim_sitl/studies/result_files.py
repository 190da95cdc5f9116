"""A study's CSV files: results, profile, distributions.

Rule: what a clock gave is in the profile alone, so that the same seed gives the same results
file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from sim_sitl.studies import paper
from sim_sitl.studies.cases import CASES
from sim_sitl.studies.results import Results
from sim_sitl.studies.scoring import EXCLUDED_ABOVE_M, Figure, Score
from sim_sitl.studies.study import Section, Study
from sim_sitl.studies.tables import csv_text, number

COLUMNS = (
    "section", "case", "environment", "vehicles", "radius_m", "method", "trials", "seed", "rmse_m",
    "rmse_low_m", "rmse_high_m", "rmse_horizontal_m", "median_m", "p90_m", "failed_trials",
    "unsettled_trials", "excluded_trials", "rmse_kept_m", "rmse_kept_low_m", "rmse_kept_high_m",
    "limit_name", "rmse_over_limit", "rmse_over_limit_low", "rmse_over_limit_high", "posterior_over_rmse",
    "posterior_over_rmse_low", "posterior_over_rmse_high", "share_in_90_ellipse", "share_in_90_ellipsoid",
    "share_in_90_region", "paper_rmse_m",
)  # fmt: skip
PROFILE_COLUMNS = ("case", "stage", "trials", "cpu_s", "ms_per_trial", "share")
CDF_COLUMNS = ("case", "method", "share_of_trials", "error_m", "error_kept_m")


def results_csv(study: Study, results: Results) -> str:
    """A row a case and method."""
    rows = (
        _csv_row(section, score, results.provenance.seed)
        for section in study.sections
        for case in section.cases
        for score in results.rows(section, case)
    )
    return _csv(COLUMNS, rows)


def _csv_row(section: Section, score: Score, seed: int) -> list[object]:
    case = CASES[score.case]
    published = paper_figure(section, score)
    return [
        section.key, case.name, case.environment, case.vehicles, case.radius_m, score.method, score.trials,
        seed, *_three(score.rmse_m), score.rmse_horizontal_m, score.median_m, score.p90_m, score.failed,
        score.unsettled, score.excluded, *_three(score.rmse_kept_m), case.limit_name,
        *_three(score.limit_ratio), *_three(score.reference_ratio), score.in_ellipse, score.in_ellipsoid,
        score.in_region, math.nan if published is None else published.rmse_m,
    ]  # fmt: skip


def profile_csv(study: Study, results: Results) -> str:
    """A row a case and stage: where the time went."""
    rows = []
    for case in cases_of(study):
        stages = stages_of(study, results, case)
        total = sum(stages.values()) or math.nan
        trials = results.provenance.trials
        rows += [[case, name, trials, s, 1e3 * s / trials, s / total] for name, s in stages.items()]
    return _csv(PROFILE_COLUMNS, rows)


def cdf_csv(section: Section, results: Results) -> str:
    """Percentiles of the error, of all trials and of those that the paper's rule keeps."""
    rows: list[list[object]] = []
    shares = np.linspace(0.0, 1.0, 101)
    for case in section.cases:
        for method in section.methods:
            outcome = results.chunks[case].outcomes[method]
            error = np.sqrt(outcome.square_m2)
            kept = error[outcome.answered & (error <= EXCLUDED_ABOVE_M)]
            kept_m = np.quantile(kept, shares) if kept.size else np.full(shares.size, math.nan)
            for share, all_m, some_m in zip(shares, np.quantile(error, shares), kept_m, strict=True):
                rows.append([case, method, float(share), float(all_m), float(some_m)])
    return _csv(CDF_COLUMNS, rows)


def _csv(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    return csv_text(columns, [[_cell(value) for value in row] for row in rows])


def _cell(value: object) -> object:
    return number(value) if isinstance(value, float) else value


def _three(figure: Figure) -> tuple[float, float, float]:
    return figure.value, figure.low, figure.high


def stages_of(study: Study, results: Results, case: str) -> dict[str, float]:
    """Processor time of each stage and method of the study on one case, seconds."""
    methods = dict.fromkeys(name for s in study.sections if case in s.cases for name in s.methods)
    chunk = results.chunks[case]
    return chunk.stages_cpu_s | {name: chunk.outcomes[name].cpu_s for name in methods}


def cases_of(study: Study) -> list[str]:
    """Each once, in the study's order."""
    return list(dict.fromkeys(case for section in study.sections for case in section.cases))


def paper_figure(section: Section, score: Score) -> paper.PaperFigure | None:
    """What the paper has to set beside a row; None: nothing that is alike."""
    if section.paper is None or score.case != section.paper_case:
        return None
    return paper.TABLE_IV[section.paper].get(score.method)
