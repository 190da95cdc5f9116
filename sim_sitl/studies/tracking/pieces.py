"""The piece of the study that one worker does: some runs of a case, each by every method.

Rule: what a run gives depends on the study's seed, the case and the run's number alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from groundstation.localization.problem import FloatArray
from sim_sitl.studies.scoring import case_key
from sim_sitl.studies.tracking.answers import SHARES, Answers
from sim_sitl.studies.tracking.cases import CASES, Case
from sim_sitl.studies.tracking.methods import EXACT, METHODS
from sim_sitl.studies.tracking.world import draw_run

PIECE_RUNS = 5


@dataclass(frozen=True, slots=True)
class Piece:
    """Some runs of one case, for one worker."""

    case: Case
    """What to draw; it travels to the worker."""
    methods: tuple[str, ...]
    """Who is put to it."""
    first: int
    """Number of the first run."""
    count: int
    """Runs."""
    seed: int
    """The study's."""

    def __str__(self) -> str:
        last = self.first + self.count - 1
        return f"case {self.case.name}, runs {self.first} to {last}, seed {self.seed}"


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """One method on N runs of a case, R times each."""

    error_enu_m: FloatArray
    """(N, R, 3) answer minus truth, metres."""
    level: FloatArray
    """(N, R) credible level of the truth; NaN: no region."""
    area_m2: FloatArray
    """(N, R, 3) of the regions."""
    drawn: FloatArray
    """(N, R, 3) whether the drawn polygons hold the truth; NaN: none are drawn."""
    walking: FloatArray
    """(N, R) P(the person walks); NaN: not asked."""
    cpu_s: FloatArray
    """(N,) processor time."""

    @property
    def square_m2(self) -> FloatArray:
        """(N, R) squared error in three dimensions."""
        result: FloatArray = np.square(self.error_enu_m).sum(axis=-1)
        return result

    @classmethod
    def of(cls, truth_enu_m: FloatArray, answers: Sequence[Answers]) -> Outcome:
        """N runs' answers beside the truth (N, R, 3)."""
        return cls(
            np.stack([answer.mean_enu_m for answer in answers]) - truth_enu_m,
            np.stack([answer.level for answer in answers]),
            np.stack([answer.area_m2 for answer in answers]),
            np.stack([answer.drawn for answer in answers]),
            np.stack([answer.walking for answer in answers]),
            np.array([answer.cpu_s for answer in answers]),
        )

    @classmethod
    def joined(cls, parts: Sequence[Outcome]) -> Outcome:
        """The runs of several pieces, one after the other."""
        return cls(
            np.concatenate([part.error_enu_m for part in parts]),
            np.concatenate([part.level for part in parts]),
            np.concatenate([part.area_m2 for part in parts]),
            np.concatenate([part.drawn for part in parts]),
            np.concatenate([part.walking for part in parts]),
            np.concatenate([part.cpu_s for part in parts]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class CaseResult:
    """All runs of one case."""

    truth_enu_m: FloatArray
    """(N, R, 3)"""
    outcomes: dict[str, Outcome]
    """By method."""

    @classmethod
    def joined(cls, parts: Sequence[CaseResult]) -> CaseResult:
        """Several pieces, in their order."""
        names = list(parts[0].outcomes)
        return cls(
            np.concatenate([part.truth_enu_m for part in parts]),
            {name: Outcome.joined([part.outcomes[name] for part in parts]) for name in names},
        )


def pieces_of(
    names: Sequence[str], methods: Sequence[str], runs: int, seed: int, size: int = PIECE_RUNS
) -> list[Piece]:
    """The pieces of all cases, the first of each before the second of any.

    ``methods`` empty: each case's own. A method that its case does not run of itself can be asked for,
    but ``exact`` where it would not be exact.
    """
    columns = []
    for name in names:
        case = CASES[name]
        fitting = [name for name in METHODS if name != EXACT or EXACT in case.methods]
        chosen = tuple(name for name in fitting if name in (methods or case.methods))
        if chosen:
            columns.append(
                [Piece(case, chosen, first, min(size, runs - first), seed) for first in range(0, runs, size)]
            )
    return [piece for row in zip_longest(*columns) for piece in row if piece is not None]


def run_piece(piece: Piece) -> CaseResult:
    """Draw and answer: what a worker calls."""
    case = piece.case
    ticks = np.array([round(time_s) for time_s in case.times_s])
    answers: dict[str, list[Answers]] = {name: [] for name in piece.methods}
    truths = []
    for number in range(piece.first, piece.first + piece.count):
        run = draw_run(case.world, case.path, case.window_s, piece.seed, number)
        truths.append(run.truth_enu_m[ticks])
        own = int(
            np.random.SeedSequence(
                piece.seed, spawn_key=(case_key(case.name), number, 1)
            ).generate_state(1)[0]
        )  # fmt: skip
        for name in piece.methods:
            answers[name].append(METHODS[name][0](case, run, ticks, own))
    truth = np.stack(truths)
    assert all(answer.area_m2.shape[1] == len(SHARES) for rows in answers.values() for answer in rows)
    return CaseResult(truth, {name: Outcome.of(truth, rows) for name, rows in answers.items()})


def joined_by_case(pieces: Sequence[Piece], results: Sequence[CaseResult]) -> Mapping[str, CaseResult]:
    """The cases' results, runs in their order, cases in the study's."""
    parts: dict[str, list[tuple[int, CaseResult]]] = {}
    for piece, result in zip(pieces, results, strict=True):
        parts.setdefault(piece.case.name, []).append((piece.first, result))
    return {
        name: CaseResult.joined([part for _, part in sorted(rows, key=lambda row: row[0])])
        for name, rows in sorted(parts.items(), key=lambda item: list(CASES).index(item[0]))
    }
