"""What a study found, in one value that tables, plots and reports read.

Rule: a score is worked out once, from all trials of its case, whatever is shown of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_sitl.studies.cases import CASES
from sim_sitl.studies.chunks import ChunkResult
from sim_sitl.studies.scoring import Score, score_case
from sim_sitl.studies.study import Section

LIMIT = "limit"
"""Name of the limit's row."""


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where the figures come from: enough to make them again."""

    command: str
    """As it was given."""
    trials: int
    """Of each case."""
    seed: int
    """Of all draws and of the bootstrap."""
    workers: str
    """Where it ran."""
    wall_s: float
    """How long all of it took, seconds."""
    versions: Mapping[str, str]
    """Program → version."""


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """All cases of a run."""

    chunks: Mapping[str, ChunkResult]
    """By case: outcomes, the limit, times."""
    scores: Mapping[str, Mapping[str, Score]]
    """By case and method; the limit's row is ``LIMIT``."""
    provenance: Provenance
    """Of all of them."""

    @classmethod
    def of(cls, chunks: Mapping[str, ChunkResult], provenance: Provenance) -> Results:
        """Score every case."""
        scores = {}
        for case, chunk in chunks.items():
            limit = chunk.limit_square_m2 if np.isfinite(chunk.limit_square_m2).all() else None
            rows = score_case(
                case, chunk.outcomes, limit, provenance.seed, LIMIT, chunk.stages_cpu_s.get("limit", 0.0)
            )
            scores[case] = {row.method: row for row in rows}
        return cls(chunks, scores, provenance)

    def rows(self, section: Section, case: str) -> list[Score]:
        """The section's methods on one case, the limit (where there is one) last."""
        scores = self.scores[case]
        return [scores[name] for name in (*section.methods, LIMIT) if name in scores]

    def limit(self, case: str) -> Score | None:
        """The limit's row."""
        return self.scores[case].get(LIMIT)


def limit_name(case: str) -> str:
    """What the limit of a case is."""
    return CASES[case].limit_name
