"""The piece of a study that one worker does: draw some trials of a case, solve them, compare.

Exists so that a study is a list of pieces that know nothing of each other. Rule: what a
piece gives depends on the study's seed, its case's name, its number and its size alone: not
on the worker, the other pieces, or which methods run on it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any

import numpy as np
from scipy.special import chdtri

from groundstation.localization.environment import Choice
from groundstation.localization.locate import locate_batch
from groundstation.localization.problem import Estimate, FloatArray, SearchArea
from groundstation.localization.solvers import SOLVERS
from sim_sitl.studies.cases import CASES, Case
from sim_sitl.studies.scoring import COVERAGE, Outcome, case_key
from sim_sitl.studies.trials import Trials

CENTRE = "centre"
"""The method that always answers the middle of the search area: what any other must beat."""
SOUND = Choice("wls-taylor-bounded", "posterior", "posterior")
"""Algorithm 1's decision with the best solver of each environment: what deciding by labels costs."""
ADAPTIVE: dict[str, Choice] = {"adaptive": Choice(), "adaptive-sound": SOUND}
"""Algorithm 1 as printed, and with ``SOUND``."""
CHUNK_TRIALS = 250
_ELLIPSE, _ELLIPSOID = float(chdtri(2, 1.0 - COVERAGE)), float(chdtri(3, 1.0 - COVERAGE))
"""Squared radii that hold 90 % of a normal error in two and in three dimensions."""
_SMALLEST_VARIANCE_M2 = 1e-9


@dataclass(frozen=True, slots=True)
class Chunk:
    """Some trials of one case, for one worker."""

    case: Case
    """What to draw; it travels to the worker."""
    methods: tuple[str, ...]
    """What to run on every trial."""
    number: int
    """0 for the case's first trials, 1 for the next, …"""
    count: int
    """Trials."""
    seed: int
    """The study's."""

    def __str__(self) -> str:
        first = self.number * CHUNK_TRIALS
        return f"case {self.case.name}, trials {first} to {first + self.count - 1}, seed {self.seed}"


@dataclass(frozen=True, slots=True, eq=False)
class ChunkResult:
    """What came of a chunk."""

    outcomes: dict[str, Outcome]
    """By method."""
    limit_square_m2: FloatArray
    """(N,) squared error of the case's limit on each trial, m²; NaN where it has none."""
    stages_cpu_s: dict[str, float]
    """Processor time of what is no solve, seconds: ``draw``, ``score``, ``limit``."""

    @classmethod
    def joined(cls, parts: Sequence[ChunkResult]) -> ChunkResult:
        """The chunks of one case, in their order."""
        stages = dict.fromkeys(name for part in parts for name in part.stages_cpu_s)
        return cls(
            {name: Outcome.joined([part.outcomes[name] for part in parts]) for name in parts[0].outcomes},
            np.concatenate([part.limit_square_m2 for part in parts]),
            {name: sum(part.stages_cpu_s.get(name, 0.0) for part in parts) for name in stages},
        )


@dataclass(slots=True)
class Stopwatch:
    """Processor time by stage; of the calling thread, so that neighbours do not count."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add what happens inside to ``name``."""
        began = time.thread_time()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.thread_time() - began


def chunks_of(
    case: Case, methods: Sequence[str], trials: int, seed: int, size: int = CHUNK_TRIALS
) -> list[Chunk]:
    """The pieces of ``trials`` trials of one case."""
    return [
        Chunk(case, tuple(methods), number, min(size, trials - number * size), seed)
        for number in range(-(-trials // size))
    ]


def schedule(runs: Mapping[str, Sequence[str]], trials: int, seed: int) -> list[Chunk]:
    """The pieces of all cases in ``runs`` (case → methods), the first of each before the second of any.

    So interleaved, the share that is done tells the time that is left.
    """
    pieces = [chunks_of(CASES[case], methods, trials, seed) for case, methods in runs.items()]
    return [chunk for row in zip_longest(*pieces) for chunk in row if chunk is not None]


def joined_by_case(chunks: Sequence[Chunk], results: Sequence[ChunkResult]) -> dict[str, ChunkResult]:
    """The cases' results, trials in their order."""
    parts: dict[str, list[tuple[int, ChunkResult]]] = {}
    for chunk, result in zip(chunks, results, strict=True):
        parts.setdefault(chunk.case.name, []).append((chunk.number, result))
    return {
        case: ChunkResult.joined([result for _, result in sorted(pieces, key=lambda piece: piece[0])])
        for case, pieces in parts.items()
    }


def run_chunk(chunk: Chunk) -> ChunkResult:
    """Draw, solve, compare: what a worker calls."""
    sequence = np.random.SeedSequence(chunk.seed, spawn_key=(case_key(chunk.case.name), chunk.number))
    draw_rng, limit_rng = (np.random.default_rng(child) for child in sequence.spawn(2))
    watch = Stopwatch()
    with watch.stage("draw"):
        trials = chunk.case.draw(chunk.count, draw_rng)
    with watch.stage("score"):
        outcomes = {name: run_method(name, trials) for name in chunk.methods}
    watch.seconds["score"] -= sum(outcome.cpu_s for outcome in outcomes.values())
    with watch.stage("limit"):
        limit = chunk.case.limit_square_m2(trials, limit_rng)
    return ChunkResult(outcomes, limit, watch.seconds)


def area_middle(area: SearchArea) -> FloatArray:
    """(3,) the area's centre, halfway between its heights, metres ENU."""
    height = 0.5 * (area.height_min_m + area.height_max_m)
    return np.array([area.center_enu_m[0], area.center_enu_m[1], height])


def run_method(name: str, trials: Trials) -> Outcome:
    """One method on all trials, in one batch."""
    count = trials.truth_enu_m.shape[0]
    middle = area_middle(trials.area)
    if name == CENTRE:
        nothing = np.full(count, np.nan)
        yes = np.ones(count, dtype=np.bool_)
        return Outcome(middle - trials.truth_enu_m, yes, yes, nothing, nothing, nothing, 0.0)
    began = time.thread_time()
    estimates = _solve(name, trials)
    cpu_s = time.thread_time() - began
    position = np.array([estimate.position_enu_m for estimate in estimates])
    covariance = np.array([estimate.covariance_m2 for estimate in estimates])
    answered = np.isfinite(position).all(axis=1)
    error = np.where(answered[:, None], position, middle) - trials.truth_enu_m
    return Outcome(
        error,
        answered,
        np.array([estimate.status == "ok" for estimate in estimates]),
        _held(error[:, :2], covariance[:, :2, :2], answered, _ELLIPSE),
        _held(error, covariance, answered, _ELLIPSOID),
        # Of Algorithm 1 only some trials have a belief, and it is another method's.
        np.full(count, np.nan) if name in ADAPTIVE else _in_regions(estimates, trials.truth_enu_m),
        cpu_s,
    )


def _solve(name: str, trials: Trials) -> list[Estimate]:
    truths: dict[str, Any] = {}
    method = SOLVERS.get(name)
    # What only an ideal reference may know is kept from every other method.
    if method is not None and method.known_power:
        truths = {"truth_enu_m": trials.truth_enu_m, "transmit_power_dbm": trials.transmit_power_dbm}
    return locate_batch(
        trials.links,
        trials.area,
        "adaptive" if name in ADAPTIVE else name,
        trials.model,
        ADAPTIVE.get(name),
        covariance=False,
        bias_max_db=trials.bias_max_db,
        on_error="status",
        **truths,
    )


def _held(error: FloatArray, covariance: FloatArray, answered: Any, squared_radius: float) -> FloatArray:
    """(N,) 1 where the ellipsoid of ``covariance`` round the answer holds the truth; NaN without one."""
    held = np.full(error.shape[0], np.nan)
    usable = answered & np.isfinite(covariance).all(axis=(1, 2))
    if usable.any():
        # A height on its bound has no variance left: an ellipsoid without thickness, not an error.
        variance, axes = np.linalg.eigh(covariance[usable])
        along = np.einsum("nji,nj->ni", axes, error[usable])
        distance = (np.square(along) / np.maximum(variance, _SMALLEST_VARIANCE_M2)).sum(axis=1)
        held[usable] = distance <= squared_radius
    return held


def _in_regions(estimates: Sequence[Estimate], truth_enu_m: FloatArray) -> FloatArray:
    """(N,) 1 where the belief's 90 % highest-density region holds the truth; NaN without a belief."""
    inside = np.full(len(estimates), np.nan)
    for row, estimate in enumerate(estimates):
        if estimate.belief is not None:
            inside[row] = estimate.belief.credible_level(truth_enu_m[row])[0] <= COVERAGE
    return inside
