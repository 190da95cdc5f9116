"""Algorithm 1: from labels to an environment, from the environment to a solver; ``locate``.

Exists as the one door of the room. Rules: ``METHODS`` names every solver there is; a method
that is not there is an InputError that lists them; ``adaptive`` follows the paper's
Algorithm 1 (two or more LOS links: LOS; one: mixed; none: NLOS) with the solvers that
``Choice`` names, its default being the paper's with height limits and the mended test.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from groundstation.domain.errors import InputError
from groundstation.domain.target import Environment
from groundstation.localization.bounds import crlb
from groundstation.localization.lsre import (
    LsreAnswer,
    first_exponents,
    lsre_ccp,
    lsre_socp,
    lsre_socp_iterative,
    received_dbm,
    rss_cost_db2,
)
from groundstation.localization.posterior import PosteriorAnswer, posterior
from groundstation.localization.problem import (
    Estimate,
    FloatArray,
    Links,
    SearchArea,
    SignalModel,
    check_links,
)
from groundstation.localization.projection import (
    los_anchor,
    projection_label_aware,
    projection_label_aware_literal,
)
from groundstation.localization.wls import strongest_first, wls_taylor


@dataclass(frozen=True, slots=True)
class Choice:
    """Which solver Algorithm 1 applies in each environment."""

    los: str = "wls-taylor-bounded"
    """Two or more LOS links with angles."""
    mixed: str = "projection-label-aware"
    """One LOS link with angles."""
    nlos: str = "lsre-socp-iterative"
    """No LOS link with angles."""


SOUND_CHOICE = Choice("wls-taylor-bounded", "posterior", "posterior")
"""What the service uses. NLOS by RMSE over targets inside and outside the ring, same trials:
``posterior`` is ahead of ``lsre-ccp`` and of the literal program in both (benchmarks/bench_solvers.py)."""

_Solver = Callable[[Links, SearchArea, SignalModel], Estimate]


def environment_of(links: Links, model: SignalModel) -> Environment:
    """Algorithm 1, step 3, by the number of LOS labels."""
    count = int(links.los(model.los_threshold).sum())
    return Environment.LOS if count >= 2 else Environment.MIXED if count == 1 else Environment.NLOS


def _estimate(
    links: Links, model: SignalModel, method: str, position: FloatArray, covariance: FloatArray,
    power: float, exponent: FloatArray, cost: float, iterations: int, status: str,
) -> Estimate:  # fmt: skip
    return Estimate(
        position, covariance, environment_of(links, model), method, power, exponent, cost,
        iterations, status, math.nan,
    )  # fmt: skip


def _wls(bounded: bool) -> _Solver:
    name = "wls-taylor-bounded" if bounded else "wls-taylor"

    def solve(links: Links, area: SearchArea, model: SignalModel) -> Estimate:
        check_links(links, 2, name)
        used = np.flatnonzero(links.los(model.los_threshold) & links.has_angle())
        if used.size < 2:
            raise InputError(
                f"{name} got {used.size} line-of-sight link(s) with angles; it needs two or more"
            )
        chosen = links.subset(used)
        check_links(chosen, 2, name)
        problem = strongest_first(
            chosen.position_enu_m[None],
            chosen.rss_dbm[None],
            chosen.azimuth_rad[None],
            chosen.elevation_rad[None],
        )
        position = wls_taylor(problem, model, area if bounded else None)[0]
        if not np.isfinite(position).all():
            raise InputError(
                f"{name}: the bearings are parallel; vehicles in different directions are needed"
            )
        covariance = crlb(position, chosen.position_enu_m, model)
        if bounded:
            covariance = _within_heights(covariance, area)
        path = (
            10.0
            * model.los_exponent
            * np.log10(np.maximum(np.linalg.norm(chosen.position_enu_m - position, axis=1), 1.0))
        )
        power = float((received_dbm(chosen, model) + path).mean())
        exponent = first_exponents(links, model)
        cost = rss_cost_db2(links, position, power, exponent, model)
        return _estimate(links, model, name, position, covariance, power, exponent, cost, 3, "ok")

    return solve


def _within_heights(covariance: FloatArray, area: SearchArea) -> FloatArray:
    """The bound with what the height limits add, as one more measurement of height."""
    spread = max(area.height_max_m - area.height_min_m, 0.5)
    information = np.linalg.inv(covariance)
    information[2, 2] += 12.0 / spread**2
    result: FloatArray = np.linalg.inv(information)
    return result


def _spread_about(answer: PosteriorAnswer, position: FloatArray) -> FloatArray:
    """Mean squared error of answering ``position`` under the posterior, (3, 3) m²."""
    shift = answer.position_enu_m - position
    result: FloatArray = answer.covariance_m2 + np.outer(shift, shift)
    return result


def _lsre(name: str, solver: Callable[[Links, SearchArea, SignalModel], LsreAnswer]) -> _Solver:
    def solve(links: Links, area: SearchArea, model: SignalModel) -> Estimate:
        check_links(links, 3, name)
        answer = solver(links, area, model)
        return _from_lsre(links, area, model, name, answer)

    return solve


def _from_lsre(links: Links, area: SearchArea, model: SignalModel, name: str, answer: LsreAnswer) -> Estimate:
    covariance = _spread_about(posterior(links, area, model), answer.position_enu_m)
    return _estimate(
        links, model, name, answer.position_enu_m, covariance, answer.transmit_power_dbm,
        answer.path_loss_exponent, answer.rss_cost_db2, answer.iterations, answer.status,
    )  # fmt: skip


def _projection(name: str, solver: Callable[[Links, int, SearchArea, SignalModel], LsreAnswer]) -> _Solver:
    def solve(links: Links, area: SearchArea, model: SignalModel) -> Estimate:
        check_links(links, 3, name)
        index = los_anchor(links, model)
        if index is None:
            raise InputError(f"{name} got no line-of-sight link with angles; it needs one")
        return _from_lsre(links, area, model, name, solver(links, index, area, model))

    return solve


def _posterior(links: Links, area: SearchArea, model: SignalModel) -> Estimate:
    check_links(links, 1, "posterior")
    answer = posterior(links, area, model)
    cost = rss_cost_db2(
        links, answer.position_enu_m, answer.transmit_power_dbm, answer.path_loss_exponent, model
    )
    return _estimate(
        links, model, "posterior", answer.position_enu_m, answer.covariance_m2,
        answer.transmit_power_dbm, answer.path_loss_exponent, cost, 1, "ok",
    )  # fmt: skip


_SOLVERS: dict[str, _Solver] = {
    "wls-taylor": _wls(bounded=False),
    "wls-taylor-bounded": _wls(bounded=True),
    "lsre-socp": _lsre("lsre-socp", lsre_socp),
    "lsre-socp-iterative": _lsre("lsre-socp-iterative", lsre_socp_iterative),
    "lsre-ccp": _lsre("lsre-ccp", lsre_ccp),
    "projection-label-aware": _projection("projection-label-aware", projection_label_aware),
    "projection-label-aware-literal": _projection(
        "projection-label-aware-literal", projection_label_aware_literal
    ),
    "posterior": _posterior,
}

METHODS: tuple[str, ...] = (*_SOLVERS, "adaptive")
"""Names that ``locate`` takes."""


def _adaptive(links: Links, area: SearchArea, model: SignalModel, choice: Choice) -> Estimate:
    check_links(links, model.minimum_links, "adaptive")
    with_angles = int((links.los(model.los_threshold) & links.has_angle()).sum())
    # A LOS label without angles gives the LOS and mixed solvers nothing to work on.
    name = choice.los if with_angles >= 2 else choice.mixed if with_angles == 1 else choice.nlos
    return _solver(name)(links, area, model)


def _solver(method: str) -> _Solver:
    solver = _SOLVERS.get(method)
    if solver is None:
        raise InputError(f"unknown method {method!r}; there are: {', '.join(METHODS)}")
    return solver


def locate(
    links: Links,
    area: SearchArea,
    method: str = "adaptive",
    model: SignalModel | None = None,
    choice: Choice | None = None,
    clock: Callable[[], float] | None = None,
) -> Estimate:
    """Where the beacon is, from one snapshot of K links.

    ``method``: one of ``METHODS``; ``choice``: what ``adaptive`` applies where. ``clock``
    (seconds, ``time.perf_counter`` for one) times the solve for ``solve_time_s``, which is NaN
    without it, and enters nothing else. Raises InputError with what
    was seen and what is needed: too few links, positions that are not finite, all vehicles
    in one place, an unknown method.
    """
    model = SignalModel() if model is None else model
    began = math.nan if clock is None else clock()
    if method == "adaptive":
        estimate = _adaptive(links, area, model, Choice() if choice is None else choice)
    else:
        estimate = _solver(method)(links, area, model)
    return replace(estimate, solve_time_s=math.nan if clock is None else clock() - began)


def locate_batch(
    links: Links,
    area: SearchArea,
    method: str = "adaptive",
    model: SignalModel | None = None,
    choice: Choice | None = None,
    clock: Callable[[], float] | None = None,
) -> list[Estimate]:
    """``locate`` for N problems with a leading axis; WLS-Taylor solves all of one link count at once.

    ``solve_time_s`` of a batched answer is its share of the batch.
    """
    model = SignalModel() if model is None else model
    if links.position_enu_m.ndim != 3:
        raise InputError(
            f"locate_batch got positions of shape {links.position_enu_m.shape}; (N, K, 3) is needed"
        )
    count = links.position_enu_m.shape[0]
    if method in {"wls-taylor", "wls-taylor-bounded"} and count:
        return _wls_batch(links, area, method, model, clock)
    return [locate(links.problem(i), area, method, model, choice, clock) for i in range(count)]


def _wls_batch(
    links: Links, area: SearchArea, method: str, model: SignalModel, clock: Callable[[], float] | None
) -> list[Estimate]:
    bounded = method == "wls-taylor-bounded"
    used = links.los(model.los_threshold) & links.has_angle()
    counts = used.sum(axis=1)
    if (counts < 2).any():
        row = int(np.flatnonzero(counts < 2)[0])
        raise InputError(f"{method}: problem {row} has {counts[row]} LOS link(s) with angles; two are needed")
    if not (np.isfinite(links.position_enu_m).all() and np.isfinite(links.rss_dbm).all()):
        raise InputError(f"{method}: a vehicle position or a received power is not finite")
    began = math.nan if clock is None else clock()
    size = counts.size
    position = np.zeros((size, 3))
    covariance = np.zeros((size, 3, 3))
    power = np.zeros(size)
    order = np.argsort(~used, axis=1, kind="stable")
    for links_used in np.unique(counts):
        rows = np.flatnonzero(counts == links_used)
        pick = order[rows][:, :links_used]
        place = np.take_along_axis(links.position_enu_m[rows], pick[..., None], axis=1)
        rss = np.take_along_axis(links.rss_dbm[rows], pick, axis=1)
        problem = strongest_first(
            place,
            rss,
            np.take_along_axis(links.azimuth_rad[rows], pick, axis=1),
            np.take_along_axis(links.elevation_rad[rows], pick, axis=1),
        )
        position[rows] = wls_taylor(problem, model, area if bounded else None)
        covariance[rows] = crlb(position[rows], place, model)
        gap = np.maximum(np.linalg.norm(place - position[rows, None], axis=2), 1.0)
        power[rows] = (rss - model.receiver_offset_db + 10.0 * model.los_exponent * np.log10(gap)).mean(
            axis=1
        )
    if bounded:
        spread = max(area.height_max_m - area.height_min_m, 0.5)
        information = np.linalg.inv(covariance)
        information[:, 2, 2] += 12.0 / spread**2
        covariance = np.linalg.inv(information)
    los = links.los(model.los_threshold)
    exponent = np.where(los, model.los_exponent, model.first_exponent)
    gap = np.maximum(np.linalg.norm(links.position_enu_m - position[:, None], axis=2), 1.0)
    residual = links.rss_dbm - model.receiver_offset_db - power[:, None] + 10.0 * exponent * np.log10(gap)
    cost = np.square(residual).sum(axis=1)
    labels = los.sum(axis=1)
    share = math.nan if clock is None else (clock() - began) / size
    return [
        Estimate(
            position[i], covariance[i],
            Environment.LOS if labels[i] >= 2 else Environment.MIXED,
            method, float(power[i]), exponent[i], float(cost[i]), 3, "ok", share,
        )
        for i in range(size)
    ]  # fmt: skip
