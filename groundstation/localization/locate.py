"""The door of the room: ``locate`` and ``locate_batch``.

Exists so that one snapshot and a study's thousands come in and go out the same way. Rules: a
single snapshot that cannot be solved is an InputError which says what was seen and what is
needed; of many, the first such problem is (``on_error="raise"``), or each is marked in its
estimate's ``status`` with a NaN position (``on_error="status"``) and none is dropped.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from groundstation.domain.errors import InputError
from groundstation.domain.target import Environment
from groundstation.localization.batch import Answers, Batch
from groundstation.localization.environment import Choice, adaptive, environments_of
from groundstation.localization.methods import Method, solve
from groundstation.localization.posterior import posterior_batch, spread_about
from groundstation.localization.problem import Estimate, FloatArray, Links, SearchArea, SignalModel
from groundstation.localization.solvers import SOLVERS

METHODS: tuple[str, ...] = (*(name for name in SOLVERS if name != "posterior"), "adaptive", "posterior")
"""Names that ``locate`` takes."""


def method_named(name: str) -> Method:
    """What there is to know of a solver; raises InputError for a name that is not there."""
    method = SOLVERS.get(name)
    if method is None:
        if name == "adaptive":
            raise InputError("adaptive is no solver but chooses between them; a solver's name is needed")
        near = difflib.get_close_matches(name, METHODS, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ";"
        raise InputError(f"unknown method {name!r}{hint} there are: {', '.join(METHODS)}")
    return method


def answer_batch(batch: Batch, method: str, choice: Choice | None = None) -> tuple[Answers, list[str]]:
    """Answers as arrays, and the name of the solver that gave each: for studies, which need no more.

    What a method could not solve has a NaN position and a status that says why. Raises
    InputError for an unknown method (or one that ``choice`` names).
    """
    if method == "adaptive":
        choice = Choice() if choice is None else choice
        for name in (choice.los, choice.mixed, choice.nlos):
            method_named(name)
        return adaptive(batch, choice, SOLVERS)
    return solve(method, method_named(method), batch), [method] * batch.size


def locate(
    links: Links,
    area: SearchArea,
    method: str = "adaptive",
    model: SignalModel | None = None,
    choice: Choice | None = None,
    clock: Callable[[], float] | None = None,
    *,
    covariance: bool = True,
    truth_enu_m: FloatArray | None = None,
    transmit_power_dbm: float | None = None,
) -> Estimate:
    """Where the beacon is, from one snapshot of K links.

    ``method``: one of ``METHODS``; ``choice``: what ``adaptive`` applies where, Algorithm 1 to
    the letter unless told. ``clock`` (seconds, ``time.perf_counter`` for one) times the solve,
    without a covariance that is no part of it, for ``solve_time_s``, which is NaN without it,
    and enters nothing else. ``covariance``: whether
    to work out ``covariance_m2`` where the method has none of its own (costs a posterior).
    ``truth_enu_m`` (3,) and ``transmit_power_dbm``: the truth, for ``wls-ideal`` in a study.
    Raises InputError with what was seen and what is needed: too few links, positions that are
    not finite, all vehicles in one place, an unknown method.
    """
    if links.position_enu_m.ndim != 2:
        raise InputError(
            f"{method} got positions of shape {links.position_enu_m.shape}; (K, 3) is needed"
            " (locate_batch takes a leading axis)"
        )
    truth = None if truth_enu_m is None else np.asarray(truth_enu_m, dtype=np.float64)[None]
    power = None if transmit_power_dbm is None else np.array([transmit_power_dbm], dtype=np.float64)
    return _estimates(
        Batch.of(links.as_batch(), area, model or SignalModel(), None, truth, power),
        method, choice, clock, covariance=covariance, on_error="raise",
    )[0]  # fmt: skip


def locate_batch(
    links: Links,
    area: SearchArea,
    method: str = "adaptive",
    model: SignalModel | None = None,
    choice: Choice | None = None,
    clock: Callable[[], float] | None = None,
    *,
    covariance: bool = True,
    bias_max_db: Any = None,
    truth_enu_m: FloatArray | None = None,
    transmit_power_dbm: Any = None,
    on_error: Literal["raise", "status"] = "raise",
) -> list[Estimate]:
    """``locate`` for N problems with a leading axis, in array operations where the method allows it.

    ``solve_time_s`` of an estimate is its share of the batch. ``bias_max_db`` (N,): b_max of
    each problem, the model's unless given. ``truth_enu_m`` (N, 3) and ``transmit_power_dbm``
    (N,): the truth, for ``wls-ideal`` in a study.
    ``on_error``: see the module's header.
    """
    batch = Batch.of(links, area, model or SignalModel(), bias_max_db, truth_enu_m, transmit_power_dbm)
    return _estimates(batch, method, choice, clock, covariance=covariance, on_error=on_error)


def _estimates(
    batch: Batch,
    method: str,
    choice: Choice | None,
    clock: Callable[[], float] | None,
    *,
    covariance: bool,
    on_error: Literal["raise", "status"],
) -> list[Estimate]:
    began = math.nan if clock is None else clock()
    answers, names = answer_batch(batch, method, choice)
    share = math.nan if clock is None or not batch.size else (clock() - began) / batch.size
    solved = np.isfinite(answers.position_enu_m).all(axis=1)
    if on_error == "raise" and not solved.all():
        row = int(np.argmin(solved))
        where = "" if batch.size == 1 else f"problem {row}: "
        raise InputError(where + answers.status[row])
    spread = _covariances(batch, answers, solved) if covariance else np.full((batch.size, 3, 3), np.nan)
    if answers.covariance_m2 is not None and not covariance:
        spread = answers.covariance_m2
    cost = batch.rss_cost_db2(answers.position_enu_m, answers.transmit_power_dbm, answers.path_loss_exponent)
    environments: list[Environment] = environments_of(batch)
    return [
        Estimate(
            answers.position_enu_m[row], spread[row], environments[row], names[row],
            float(answers.transmit_power_dbm[row]), answers.path_loss_exponent[row], float(cost[row]),
            int(answers.iterations[row]), answers.status[row], share,
            None if answers.beliefs is None else answers.beliefs[row],
        )
        for row in range(batch.size)
    ]  # fmt: skip


def _covariances(batch: Batch, answers: Answers, solved: Any) -> FloatArray:
    """(N, 3, 3): the method's own where it has one, else the posterior's spread about its answer."""
    spread = np.full((batch.size, 3, 3), np.nan)
    if answers.covariance_m2 is not None:
        spread[:] = answers.covariance_m2
    rows = np.flatnonzero(solved & ~np.isfinite(spread[:, 0, 0]))
    if rows.size:
        beliefs = posterior_batch(batch.rows(rows)).beliefs or ()
        for row, belief in zip(rows, beliefs, strict=True):
            if belief is not None:
                spread[row] = spread_about(belief, answers.position_enu_m[row])
    return spread
