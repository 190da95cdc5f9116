"""From the errors of thousands of trials to the figures of a table, with their intervals.

Exists so that every study counts alike. Rules: nothing is dropped (a trial that a method did
not answer is scored as if it had answered the area's centre, and is counted); the paper's own
rule (errors above 500 m excluded) stands beside it with how many it excludes; a ratio to the
limit is over the same trials, and so is its interval (paired bootstrap).
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.localization.problem import BoolArray, FloatArray

RESAMPLES = 1000
"""Bootstrap resamples of an interval."""
EXCLUDED_ABOVE_M = 500.0
"""The paper (Gao & Sadjadpour, 2026), V-D: "extreme cases were excluded"."""
REFERENCE = "posterior"
"""The method that each other is set beside."""
COVERAGE = 0.9
"""Content of the regions whose honesty is measured."""
_INTERVAL = (2.5, 97.5)
_BLOCK = 100
"""Resamples worked on at once: bounds the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What one method did on N trials of a case."""

    error_enu_m: FloatArray
    """(N, 3) answer minus truth, metres; that of the area's centre where there was no answer."""
    answered: BoolArray
    """(N,) whether the method gave a position."""
    settled: BoolArray
    """(N,) whether its status was ``ok``: neither an iteration limit nor diverging."""
    in_ellipse: FloatArray
    """(N,) 1 where the horizontal 90 % ellipse of its own covariance holds the truth, 0 where not; NaN:
    the method has none."""
    in_ellipsoid: FloatArray
    """(N,) the same of the 90 % ellipsoid in three dimensions."""
    in_region: FloatArray
    """(N,) the same of the 90 % highest-density region of its belief."""
    cpu_s: float
    """Processor time of the N solves, seconds."""

    @property
    def square_m2(self) -> FloatArray:
        """(N,) squared distance to the truth, m²."""
        result: FloatArray = np.square(self.error_enu_m).sum(axis=1)
        return result

    @classmethod
    def joined(cls, parts: Sequence[Outcome]) -> Outcome:
        """The trials of several chunks, one after the other."""
        return cls(
            np.concatenate([part.error_enu_m for part in parts]),
            np.concatenate([part.answered for part in parts]),
            np.concatenate([part.settled for part in parts]),
            np.concatenate([part.in_ellipse for part in parts]),
            np.concatenate([part.in_ellipsoid for part in parts]),
            np.concatenate([part.in_region for part in parts]),
            math.fsum(part.cpu_s for part in parts),
        )


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure and its 95 % bootstrap interval over trials."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Score:
    """One row of a study: a method on a case, or the limit on it."""

    case: str
    """Name of the case."""
    method: str
    """Name of the method."""
    trials: int
    """N."""
    rmse_m: Figure
    """Root mean square of the error in three dimensions, metres."""
    rmse_horizontal_m: float
    """The same in the horizontal plane, metres; NaN for a limit."""
    median_m: float
    """Median error, metres; NaN for a limit."""
    p90_m: float
    """90th percentile of the error, metres; NaN for a limit."""
    failed: int
    """Trials without an answer, scored as the area's centre."""
    unsettled: int
    """Trials with an answer whose status was not ``ok`` (iteration limit, diverging)."""
    excluded: int
    """Trials that the paper's rule drops: no answer, or an error above 500 m."""
    rmse_kept_m: Figure
    """RMSE of the others, metres: the paper's rule."""
    limit_ratio: Figure
    """RMSE over the limit's on the same trials; NaN where the case has no limit."""
    reference_ratio: Figure
    """RMSE of ``REFERENCE`` over this method's on the same trials; NaN where it was not run."""
    in_ellipse: float
    """Share of truths in the horizontal 90 % ellipse of the method's own covariance; NaN: it has none."""
    in_ellipsoid: float
    """Share of truths in its 90 % ellipsoid (three dimensions); NaN: it has none."""
    in_region: float
    """Share of truths in the 90 % highest-density region of its belief; NaN: it has none."""
    cpu_s_per_solve: float
    """Processor time a solve, seconds; for orientation only."""


def case_key(case: str) -> int:
    """A number that is the case's own in every study: its trials do not depend on what else is run."""
    return zlib.crc32(case.encode())


def resampled_means(values: FloatArray, rng: np.random.Generator, resamples: int = RESAMPLES) -> FloatArray:
    """(B, M) means of ``values`` (N, M) over B resamples of the rows, the same for every column."""
    count = values.shape[0]
    means = np.empty((resamples, values.shape[1]))
    for start in range(0, resamples, _BLOCK):
        rows = min(_BLOCK, resamples - start)
        drawn = rng.integers(0, count, (rows, count)) + np.arange(rows)[:, None] * count
        weights = np.bincount(drawn.ravel(), minlength=rows * count).reshape(rows, count)
        means[start : start + rows] = weights @ values / count
    return means


def score_case(
    case: str,
    outcomes: Mapping[str, Outcome],
    limit_square_m2: FloatArray | None,
    seed: int,
    limit_name: str = "limit",
    limit_cpu_s: float = math.nan,
) -> list[Score]:
    """A row for each method, in their order, and last one for the limit where there is one.

    ``limit_square_m2`` (N,): squared error of the limit on each trial. All rows and all ratios
    use the same resamples of the trials.
    """
    names = list(outcomes)
    squares = [outcomes[name].square_m2 for name in names]
    kept = [
        outcomes[name].answered & (square <= EXCLUDED_ABOVE_M**2)
        for name, square in zip(names, squares, strict=True)
    ]
    columns = [*squares, *(np.where(keep, square, 0.0) for keep, square in zip(kept, squares, strict=True))]
    columns += [keep.astype(np.float64) for keep in kept]
    if limit_square_m2 is not None:
        columns.append(limit_square_m2)
    size = len(names)
    table = np.column_stack(columns)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(case_key(case), 2**32 - 1)))
    means, drawn = table.mean(axis=0), resampled_means(table, rng)
    # A resample may keep no trial at all under the paper's rule: then it has no figure.
    with np.errstate(divide="ignore", invalid="ignore"):
        rmse, drawn_rmse = np.sqrt(means[:size]), np.sqrt(drawn[:, :size])
        held = np.sqrt(means[size : 2 * size] / means[2 * size : 3 * size])
        drawn_held = np.sqrt(drawn[:, size : 2 * size] / drawn[:, 2 * size : 3 * size])
    limit = math.nan if limit_square_m2 is None else math.sqrt(means[-1])
    drawn_limit = np.full(RESAMPLES, math.nan) if limit_square_m2 is None else np.sqrt(drawn[:, -1])
    with_reference = REFERENCE in outcomes
    reference = rmse[names.index(REFERENCE)] if with_reference else math.nan
    drawn_reference = (
        drawn_rmse[:, names.index(REFERENCE)] if with_reference else np.full(RESAMPLES, math.nan)
    )
    scores = []
    for column, name in enumerate(names):
        outcome, error = outcomes[name], np.sqrt(squares[column])
        scores.append(
            Score(
                case=case,
                method=name,
                trials=error.size,
                rmse_m=_figure(rmse[column], drawn_rmse[:, column]),
                rmse_horizontal_m=_root_mean(np.square(outcome.error_enu_m[:, :2]).sum(axis=1)),
                median_m=float(np.median(error)),
                p90_m=float(np.percentile(error, 90.0)),
                failed=int((~outcome.answered).sum()),
                unsettled=int((outcome.answered & ~outcome.settled).sum()),
                excluded=int((~kept[column]).sum()),
                rmse_kept_m=_figure(held[column], drawn_held[:, column]),
                limit_ratio=_figure(rmse[column] / limit, drawn_rmse[:, column] / drawn_limit),
                reference_ratio=_figure(reference / rmse[column], drawn_reference / drawn_rmse[:, column]),
                in_ellipse=_share(outcome.in_ellipse),
                in_ellipsoid=_share(outcome.in_ellipsoid),
                in_region=_share(outcome.in_region),
                cpu_s_per_solve=outcome.cpu_s / error.size,
            )
        )
    if limit_square_m2 is not None:
        scores.append(_limit_row(case, limit_name, limit_square_m2, drawn_limit, limit_cpu_s))
    return scores


def _limit_row(case: str, name: str, square: FloatArray, drawn: FloatArray, cpu_s: float) -> Score:
    # A limit bounds the root mean square; it says nothing of the error's median.
    figure = _figure(_root_mean(square), drawn)
    return Score(
        case=case,
        method=name,
        trials=square.size,
        rmse_m=figure,
        rmse_horizontal_m=math.nan,
        median_m=math.nan,
        p90_m=math.nan,
        failed=0,
        unsettled=0,
        excluded=0,
        rmse_kept_m=figure,
        limit_ratio=Figure(1.0, 1.0, 1.0),
        reference_ratio=Figure(math.nan, math.nan, math.nan),
        in_ellipse=math.nan,
        in_ellipsoid=math.nan,
        in_region=math.nan,
        cpu_s_per_solve=cpu_s / square.size,
    )


def _figure(value: float, drawn: FloatArray) -> Figure:
    usable = drawn[np.isfinite(drawn)]
    if not usable.size:
        return Figure(float(value), math.nan, math.nan)
    low, high = np.percentile(usable, _INTERVAL)
    return Figure(float(value), float(low), float(high))


def _root_mean(square: FloatArray) -> float:
    return math.sqrt(float(square.mean()))


def _share(inside: FloatArray) -> float:
    known = inside[np.isfinite(inside)]
    return float(known.mean()) if known.size else math.nan
