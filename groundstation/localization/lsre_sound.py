"""The LSRE criterion (60) itself, by the convex–concave procedure: ``lsre-ccp``.

Exists because (64) as printed does not minimise (60). There ‖x − a_k‖ is convex and its
reciprocal is not; the norm's tangent at the current place x₀, v_k(x) = c_k n_kᵀ(x − a_k) ≤
c_k‖x − a_k‖ with n_k the unit vector from a_k to x₀, makes Σ g_k [1/v_k² + c_k²‖x − a_k‖²] a
convex bound from above that touches the criterion at x₀. Rule: at fixed P̂_t and β̂ the
criterion never rises, from step to step and for every problem. Between such runs P̂_t and one
exponent shared by the NLOS links are refitted with their priors: one for each link, (68),
would make almost any place stationary.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.localization.batch import Answers, Batch
from groundstation.localization.interior import minimise
from groundstation.localization.lsre_terms import criterion, log_end_weights, log_gains, weighted_centroid
from groundstation.localization.problem import FloatArray
from groundstation.localization.refit import refit_power_and_exponent
from groundstation.localization.region import Region

_STEPS = 100
_IMPROVEMENT = 1e-6
_STEP_TOLERANCE = 1e-6
_CLEAR_OF_VEHICLE_M = 1.0
_CLOSEST_M = 1e-6
_POWER_STEPS = 30
_POWER_TOLERANCE_DB = 1e-7
_LARGEST_LOG = 300.0


@dataclass(frozen=True, slots=True, eq=False)
class Majoriser:
    """Σ g_k [1/v_k(x)² + c_k²‖x − a_k‖²] of N problems, in scaled lengths."""

    tangent: FloatArray
    """(N, K, 3): c_k n_k, so that v_k = c_k n_k·(x − a_k)."""
    shift: FloatArray
    """(N, K): −c_k n_k·a_k."""
    weight: FloatArray
    """(N, K): g_k."""
    pull: FloatArray
    """(N,): Σ g_k c_k²."""
    center: FloatArray
    """(N, 3): the weighted centroid, where the quadratic terms are least."""
    floor: FloatArray
    """(N,): what the quadratic terms are there."""

    def evaluate(self, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value (inf where a v_k is not positive), gradient, Hessian."""
        v = np.matmul(self.tangent, y[:, :, None])[:, :, 0] + self.shift
        bad = v.min(axis=1) <= 0.0
        inverse = 1.0 / np.where(v > 0.0, v, 1.0)
        square = self.weight * inverse * inverse
        offset = y - self.center
        value = square.sum(axis=1) + self.floor + self.pull * (offset * offset).sum(axis=1)
        twice = 2.0 * self.pull
        gradient = (
            twice[:, None] * offset - np.matmul((2.0 * square * inverse)[:, None, :], self.tangent)[:, 0]
        )
        bend = (6.0 * square * inverse * inverse)[:, :, None] * self.tangent
        hessian = np.matmul(np.swapaxes(bend, 1, 2), self.tangent)
        hessian.reshape(-1, 9)[:, ::4] += twice[:, None]
        return np.where(bad, np.inf, value), gradient, hessian

    def rows(self, chosen: FloatArray) -> Majoriser:
        """The problems that ``chosen`` selects."""
        return Majoriser(
            self.tangent[chosen], self.shift[chosen], self.weight[chosen],
            self.pull[chosen], self.center[chosen], self.floor[chosen],
        )  # fmt: skip


def majoriser(
    batch: Batch, region: Region, position_enu_m: FloatArray, power_dbm: FloatArray, exponent: FloatArray
) -> tuple[Majoriser, FloatArray]:
    """The bound that touches the criterion at positions (N, 3), over its value there; that value (N,)."""
    place, at = region.scaled(batch.place), region.scaled(position_enu_m)
    log_gain = log_gains(batch, power_dbm, exponent) + np.log(region.scale_m)
    log_weight = log_end_weights(batch, exponent)
    offset = at[:, None, :] - place
    distance = np.linalg.norm(offset, axis=-1)
    relative = 2.0 * (log_gain + np.log(distance))
    logs = log_weight + np.logaddexp(relative, -relative)
    top = logs.max(axis=1)
    # Over its own value the criterion is near one, however far a power lies from the model.
    value = np.exp(logs - top[:, None]).sum(axis=1)
    log_value = top + np.log(value)
    tangent = np.exp(log_gain)[..., None] * offset / distance[..., None]
    weight = np.exp(log_weight - log_value[:, None])
    share = np.exp(log_weight + 2.0 * log_gain - log_value[:, None])
    pull = share.sum(axis=1)
    center = np.einsum("nk,nkc->nc", share, place) / pull[:, None]
    floor = (share * np.square(place - center[:, None, :]).sum(axis=-1)).sum(axis=1)
    bound = Majoriser(tangent, -(tangent * place).sum(axis=-1), weight, pull, center, floor)
    return bound, np.exp(log_value)


def convex_concave_step(
    batch: Batch,
    region: Region,
    position_enu_m: FloatArray,
    power_dbm: FloatArray,
    exponent: FloatArray,
    tolerance: float = 1e-9,
) -> FloatArray:
    """(N, 3) metres: where the bound that touches the criterion at positions (N, 3) is least.

    ``tolerance``: relative, of the bound's value.
    """
    bound, _ = majoriser(batch, region, position_enu_m, power_dbm, exponent)
    at, inner = region.scaled(position_enu_m), region.inside(position_enu_m)
    # Off the outline, but not past the plane where the tangent of a vehicle close by turns negative.
    here = np.matmul(bound.tangent, at[:, :, None])[:, :, 0] + bound.shift
    loss = here - (np.matmul(bound.tangent, inner[:, :, None])[:, :, 0] + bound.shift)
    part = np.min(0.5 * here / np.maximum(loss, 0.5 * here), axis=1)
    start = at + part[:, None] * (inner - at)
    return region.metres(minimise(bound, region.constraints(), start, tolerance).y)


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """Convex–concave runs of N problems at fixed β̂."""

    position_enu_m: FloatArray
    """(N, 3) metres, inside the area."""
    transmit_power_dbm: FloatArray
    """(N,) P̂_t."""
    history: FloatArray
    """(steps + 1, N) the criterion after each step, the start's first; it never rises."""


def convex_concave(
    batch: Batch,
    region: Region,
    start_enu_m: FloatArray,
    power_dbm: FloatArray,
    exponent: FloatArray,
    *,
    free_power: bool = False,
) -> Descent:
    """Minimise the criterion (60) from ``start_enu_m`` (N, 3), inside the area, at fixed β̂ (N, K).

    ``free_power``: over ζ = 1/m_t too, as (60) is printed: P̂_t is set to its best after each
    step; otherwise it stays as given.
    """
    place, power = np.array(start_enu_m), np.array(power_dbm)
    if free_power:
        power = best_power(batch, place, power, exponent)
    value = criterion(batch, place, power, exponent)
    history = [value]
    active, stretch = np.arange(batch.size), np.ones(batch.size)
    for _ in range(_STEPS):
        part, held, before = batch.rows(active), exponent[active], place[active]
        found = batch.area.clip(
            convex_concave_step(part, region, before, power[active], held, _STEP_TOLERANCE)
        )
        further = batch.area.clip(found + stretch[active, None] * (found - before))
        level = far_level = power[active]
        if free_power:
            level, far_level = best_power(part, found, level, held), best_power(part, further, level, held)
        new, far = criterion(part, found, level, held), criterion(part, further, far_level, held)
        # The bound's steps are short where it is much steeper than the criterion: go on while that pays.
        longer = far < new
        stretch[active] = np.where(longer, 2.0 * stretch[active], np.maximum(0.5 * stretch[active], 0.5))
        found[longer], new = further[longer], np.where(longer, far, new)
        level = np.where(longer, far_level, level)
        # Not better: within the solver's tolerance, or clipped from the hull of a bent polygon.
        better = new < value[active]
        gain = np.where(better, 1.0 - new / value[active], 0.0)
        value = value.copy()
        rows = active[better]
        place[rows], power[rows], value[rows] = found[better], level[better], new[better]
        history.append(value)
        active = active[gain > _IMPROVEMENT]
        if not active.size:
            break
    return Descent(place, power, np.array(history))


def best_power(
    batch: Batch, position_enu_m: FloatArray, power_dbm: FloatArray, exponent: FloatArray
) -> FloatArray:
    """(N,) dBm: the P̂_t at which the criterion is least at positions (N, 3); convex in P̂_t.

    Never worse than ``power_dbm``.
    """
    rate = np.log(10.0) / (5.0 * exponent)
    weight = np.exp(log_end_weights(batch, exponent))
    gap = np.linalg.norm(batch.place - position_enu_m[:, None, :], axis=-1)
    mismatch = 2.0 * (log_gains(batch, power_dbm, exponent) + np.log(np.maximum(gap, _CLOSEST_M)))
    move = np.zeros(batch.size)
    for _ in range(_POWER_STEPS):
        at = np.clip(mismatch - rate * move[:, None], -_LARGEST_LOG, _LARGEST_LOG)
        slope = (weight * rate * np.sinh(at)).sum(axis=1)
        step = slope / (weight * rate * rate * np.cosh(at)).sum(axis=1)
        move += step
        if np.abs(step).max(initial=0.0) < _POWER_TOLERANCE_DB:
            break
    before = criterion(batch, position_enu_m, power_dbm, exponent)
    after = criterion(batch, position_enu_m, power_dbm + move, exponent)
    return np.where(after < before, power_dbm + move, power_dbm)


def lsre_ccp(batch: Batch) -> Answers:
    """The minimum of (60) over x and ζ, and one β̂ of the NLOS links refitted with its prior, in turn.

    From the weighted centroid (further starts did not lower the error); the paper's stopping
    rules. A known P_t is kept.
    """
    model, region = batch.model, Region.of(batch.area)
    free = model.known_transmit_power_dbm is None
    power, exponent = batch.first_power_dbm(), batch.first_exponents()
    place = clear_of_vehicles(batch, batch.area.clip(weighted_centroid(batch, power, exponent)))
    power, exponent = refit_power_and_exponent(batch, place)
    rounds = np.zeros(batch.size, dtype=np.int64)
    status = np.full(batch.size, "iteration limit", dtype=object)
    active = np.arange(batch.size)
    for number in range(1, int(model.maximum_iterations) + 1):
        part = batch.rows(active)
        run = convex_concave(part, region, place[active], power[active], exponent[active], free_power=free)
        found, level = run.position_enu_m, run.transmit_power_dbm
        _, new_exponent = refit_power_and_exponent(part, found)
        settled = np.linalg.norm(found - place[active], axis=1) < model.position_tolerance_m
        steady = np.abs(level - power[active]) < model.transmit_power_tolerance_db
        steady &= np.linalg.norm(new_exponent - exponent[active], axis=1) < model.exponent_tolerance
        place[active], power[active], rounds[active] = found, level, number
        done = settled | steady
        exponent[active[~done]] = new_exponent[~done]
        status[active[done]] = "ok"
        active = active[~done]
        if not active.size:
            break
    return Answers(place, power, exponent, rounds, list(status))


def clear_of_vehicles(batch: Batch, position_enu_m: FloatArray) -> FloatArray:
    """Places (N, 3), those within a metre of a vehicle moved: there the norm has no tangent."""
    close = (np.linalg.norm(position_enu_m[:, None, :] - batch.place, axis=-1) < _CLEAR_OF_VEHICLE_M).any(
        axis=1
    )
    offset = Region.of(batch.area).center_m - position_enu_m
    length = np.linalg.norm(offset, axis=1, keepdims=True)
    move = min(2.0 * _CLEAR_OF_VEHICLE_M, 0.5 * batch.area.radius_m)
    away = np.where(length > move, offset / np.maximum(length, move), [1.0, 0.0, 0.0])
    return np.where(close[:, None], position_enu_m + move * away, position_enu_m)
