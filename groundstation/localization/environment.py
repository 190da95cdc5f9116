"""Algorithm 1: from labels to an environment, from the environment to a solver.

Exists as the paper's decision, apart from the solvers it chooses between. Rule: ``adaptive``
is Algorithm 1 to the letter (four or more links; two or more LOS links: LOS; one: mixed;
none: NLOS; the paper's literal solver for each) unless a ``Choice`` names other solvers; the
service names sound ones (``SOUND_CHOICE``). What the paper leaves open, a LOS label without
angles, which the LOS and mixed solvers cannot use: the solver is chosen by the LOS links that
have angles, and the link still counts for the environment that is reported.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from groundstation.domain.target import Environment
from groundstation.localization.batch import Answers, Batch, scattered
from groundstation.localization.methods import Method, solve
from groundstation.localization.problem import Links, SignalModel

_BY_COUNT = (Environment.NLOS, Environment.MIXED, Environment.LOS)


@dataclass(frozen=True, slots=True)
class Choice:
    """Which solver Algorithm 1 applies in each environment; the default is the paper's, as printed."""

    los: str = "wls-taylor"
    """Two or more LOS links with angles."""
    mixed: str = "projection-label-aware-literal"
    """One LOS link with angles."""
    nlos: str = "lsre-socp-iterative"
    """No LOS link with angles."""


SOUND_CHOICE = Choice("posterior", "posterior", "posterior")
"""What the service uses. ``posterior`` weighs labels by their probability instead of choosing by them:
with a classifier's labels Algorithm 1 with the best solvers errs by 46 m where ``posterior`` alone errs
by 26 m, and in no environment is another method ahead of it (docs/decisions.md)."""


def environments_of(batch: Batch) -> list[Environment]:
    """Algorithm 1, step 3, by the number of LOS labels of each problem."""
    return [_BY_COUNT[count] for count in np.minimum(batch.los().sum(axis=1), 2).tolist()]


def environment_of(links: Links, model: SignalModel) -> Environment:
    """Algorithm 1, step 3, of a single snapshot."""
    return _BY_COUNT[min(int(links.los(model.los_threshold).sum()), 2)]


def adaptive(batch: Batch, choice: Choice, solvers: Mapping[str, Method]) -> tuple[Answers, list[str]]:
    """Algorithm 1: the answers, and the name of the solver that gave each."""
    needed = batch.model.minimum_links
    size, count = batch.size, batch.links.count
    if count < needed:
        answers = scattered(size, count, [])
        status = [f"adaptive got {count} link(s); it needs {needed} or more"] * size
        return replace(answers, status=status), ["adaptive"] * size
    by_count = (choice.nlos, choice.mixed, choice.los)
    names = [by_count[found] for found in np.minimum(batch.bearing_usable().sum(axis=1), 2).tolist()]
    chosen = sorted(set(names))
    if len(chosen) == 1:
        return solve(chosen[0], solvers[chosen[0]], batch), names
    parts = []
    for name in chosen:
        rows = np.flatnonzero([other == name for other in names])
        parts.append((rows, solve(name, solvers[name], batch.rows(rows))))
    return scattered(size, count, parts), names
