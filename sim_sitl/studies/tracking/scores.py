"""From the answers of many runs to the figures of the report, with their intervals.

Rules: nothing is dropped; a ratio is over the same runs, and so is its interval (paired
bootstrap over runs); a share's interval is Wilson's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from groundstation.localization.problem import FloatArray
from sim_sitl.studies.scoring import Figure, case_key, resampled_means
from sim_sitl.studies.tracking.answers import SHARES
from sim_sitl.studies.tracking.methods import EXACT, OURS
from sim_sitl.studies.tracking.pieces import CaseResult, Outcome

_Z = 1.959964
_NONE = Figure(math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Score:
    """One method on one case at one time."""

    case: str
    """Name of the case."""
    method: str
    """Name of the method."""
    time_s: float
    """Since the first window."""
    runs: int
    """N."""
    rmse_m: Figure
    """In three dimensions, metres."""
    rmse_horizontal_m: Figure
    """In the plane, metres."""
    median_m: float
    """Median error in three dimensions, metres."""
    exact_ratio: Figure
    """RMSE over that of ``exact`` on the same runs."""
    ours_ratio: Figure
    """RMSE over that of ``tracker`` on the same runs: above 1 it is worse than ours."""
    held: tuple[Figure, ...]
    """For each of ``SHARES``: share of runs whose region holds the truth."""
    held_drawn: tuple[Figure, ...]
    """The same of the regions as drawn, polygons."""
    area_m2: tuple[float, ...]
    """Mean areas of the regions."""
    worst_run: int
    """Number of the run with the largest error."""
    worst_m: float
    """That error, metres."""


def scores_of(case: str, times_s: tuple[float, ...], result: CaseResult, seed: int) -> list[Score]:
    """A row a method and time. All ratios use the same resamples of the runs."""
    names = list(result.outcomes)
    rows = []
    for at, time_s in enumerate(times_s):
        squares = {name: result.outcomes[name].square_m2[:, at] for name in names}
        flat = {name: np.square(result.outcomes[name].error_enu_m[:, at, :2]).sum(axis=-1) for name in names}
        table = np.column_stack([*squares.values(), *flat.values()])
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(case_key(case), at, 2**32 - 1)))
        drawn = np.sqrt(resampled_means(table, rng))
        value = np.sqrt(table.mean(axis=0))
        for column, name in enumerate(names):
            outcome = result.outcomes[name]
            worst = int(np.argmax(squares[name]))
            rows.append(
                Score(
                    case, name, time_s, len(table), _figure(value[column], drawn[:, column]),
                    _figure(value[len(names) + column], drawn[:, len(names) + column]),
                    float(np.median(np.sqrt(squares[name]))),
                    _ratio(names, EXACT, column, value, drawn), _ratio(names, OURS, column, value, drawn),
                    _held(outcome.level[:, at]), _drawn(outcome, at),
                    tuple(float(area) for area in outcome.area_m2[:, at].mean(axis=0)),
                    worst, math.sqrt(float(squares[name][worst])),
                )
            )  # fmt: skip
    return sorted(rows, key=lambda row: names.index(row.method))


def score_cases(
    results: Mapping[str, CaseResult], times_s: Mapping[str, tuple[float, ...]], seed: int
) -> dict[str, list[Score]]:
    """Of every case."""
    return {case: scores_of(case, times_s[case], result, seed) for case, result in results.items()}


def _ratio(names: list[str], to: str, column: int, value: FloatArray, drawn: FloatArray) -> Figure:
    if to not in names:
        return _NONE
    base = names.index(to)
    return _figure(value[column] / value[base], drawn[:, column] / drawn[:, base])


def _figure(value: float, drawn: FloatArray) -> Figure:
    low, high = np.percentile(drawn, (2.5, 97.5))
    return Figure(float(value), float(low), float(high))


def share_figure(hits: float, count: int) -> Figure:
    """A share with Wilson's 95 % interval."""
    if count == 0:
        return _NONE
    share = hits / count
    center = (share + _Z**2 / (2 * count)) / (1 + _Z**2 / count)
    half = _Z / (1 + _Z**2 / count) * math.sqrt(share * (1 - share) / count + _Z**2 / (4 * count**2))
    return Figure(share, max(center - half, 0.0), min(center + half, 1.0))


def _held(level: FloatArray) -> tuple[Figure, ...]:
    known = level[np.isfinite(level)]
    return tuple(share_figure(float((known <= share).sum()), known.size) for share in SHARES)


def _drawn(outcome: Outcome, at: int) -> tuple[Figure, ...]:
    columns = outcome.drawn[:, at].T
    return tuple(share_figure(float(np.nansum(column)), int(np.isfinite(column).sum())) for column in columns)
