"""LSRE in NLOS: the paper's program as printed, its iteration as printed, and a sound version.

Exists because (64) as printed is degenerate: with ζ fixed by a known power it returns the
centroid of the vehicles weighted by received power, with z on the height cap, and after (68)
every residual of (69) is zero. Both literal readings are kept by name. ``lsre-ccp`` solves
the criterion (60) itself: 1/D² is majorised with an affine minorant of the norm, and the
step repeated (convex–concave procedure), so the criterion never rises at fixed power and
exponent; between such runs power and one shared NLOS exponent are refitted with their priors.
Rule: LOS-labelled links have b = 0 and β_LOS ((72)); the others the interval 0 … b_max.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.localization.conic import majoriser, solve_literal
from groundstation.localization.problem import FloatArray, Links, SearchArea, SignalModel

_MINIMUM_DISTANCE_M = 1.0
_SMALLEST_EXPONENT = 0.1
_CCP_STEPS = 25
_CCP_IMPROVEMENT = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class LsreAnswer:
    """What an LSRE solver found."""

    position_enu_m: FloatArray
    """(3,) metres."""
    transmit_power_dbm: float
    path_loss_exponent: FloatArray
    """(K,)"""
    rss_cost_db2: float
    """J of (69), with the unshifted powers as printed."""
    iterations: int
    status: str
    objective: tuple[float, ...] = ()
    """``lsre-ccp``: the true criterion after each convex–concave step of the last run."""


def received_dbm(links: Links, model: SignalModel) -> FloatArray:
    """(K,) received power without the receivers' common offset."""
    result: FloatArray = links.rss_dbm - model.receiver_offset_db
    return result


def distances_m(links: Links, position_enu_m: FloatArray) -> FloatArray:
    """(K,) of (66), not under one metre."""
    gap = np.linalg.norm(links.position_enu_m - position_enu_m, axis=1)
    result: FloatArray = np.maximum(gap, _MINIMUM_DISTANCE_M)
    return result


def first_power_dbm(model: SignalModel) -> float:
    """P̂_t before the first iteration."""
    known = model.known_transmit_power_dbm
    return model.first_transmit_power_dbm if known is None else known


def first_exponents(links: Links, model: SignalModel) -> FloatArray:
    """β̂ before the first iteration: β_LOS or the first NLOS exponent."""
    return np.where(links.los(model.los_threshold), model.los_exponent, model.first_exponent)


def gains_per_m(links: Links, power_dbm: float, exponent: FloatArray, model: SignalModel) -> FloatArray:
    """m_k / m_{t,k} of (54): one over the distance that the shifted power P̂_r suggests."""
    shift = np.where(links.los(model.los_threshold), 0.0, 0.5 * model.nlos_bias_max_db)
    result: FloatArray = 10.0 ** ((received_dbm(links, model) + shift - power_dbm) / (10.0 * exponent))
    return result


def interval_ends(links: Links, exponent: FloatArray, model: SignalModel) -> list[tuple[float, ...]]:
    """R_k of (72): {1} on a LOS link, {e̲, ē} on an NLOS link."""
    ends = 10.0 ** (-model.nlos_bias_max_db / (20.0 * exponent))
    los = links.los(model.los_threshold)
    return [(1.0,) if is_los else (float(e), float(1.0 / e)) for is_los, e in zip(los, ends, strict=True)]


def rss_cost_db2(
    links: Links, position: FloatArray, power_dbm: float, exponent: FloatArray, model: SignalModel
) -> float:
    """J of (69)."""
    path = 10.0 * exponent * np.log10(distances_m(links, position))
    return float(np.square(received_dbm(links, model) - power_dbm + path).sum())


def weighted_centroid(links: Links, area: SearchArea, model: SignalModel) -> FloatArray:
    """What (64) amounts to: Σ w_k a_k / Σ w_k, w_k = (m_k/m_t,k)² Σ r², moved into the area."""
    exponent = first_exponents(links, model)
    gain = gains_per_m(links, first_power_dbm(model), exponent, model)
    ends = np.array([sum(e * e for e in pair) for pair in interval_ends(links, exponent, model)])
    weight = gain**2 * ends
    inside: FloatArray = area.clip((weight @ links.position_enu_m / weight.sum())[None])[0]
    return inside


def lsre_socp(links: Links, area: SearchArea, model: SignalModel) -> LsreAnswer:
    """One solve of (64) as printed, at P̂_t and β̂ of the settings; height limits and area as constraints."""
    exponent = first_exponents(links, model)
    power = first_power_dbm(model)
    gain = gains_per_m(links, power, exponent, model)
    raw, status = solve_literal(links.position_enu_m, gain, interval_ends(links, exponent, model), area)
    position = area.clip(raw[None])[0]
    cost = rss_cost_db2(links, position, power, exponent, model)
    return LsreAnswer(position, power, exponent, cost, 1, _status(status))


def update_power_and_exponents(
    links: Links,
    position: FloatArray,
    power_dbm: float,
    exponent: FloatArray,
    model: SignalModel,
    *,
    every_link: bool = False,
) -> tuple[float, FloatArray]:
    """(67), (70), then (68): afterwards every refitted link's residual in (69) is zero.

    LOS-labelled links keep β_LOS, as below (72), unless ``every_link``: (68) as printed knows
    no labels. At one metre (68) divides by zero: the exponent stays.
    """
    received = received_dbm(links, model)
    log_distance = np.log10(distances_m(links, position))
    if model.known_transmit_power_dbm is None:
        averaged = float((received + 10.0 * exponent * log_distance).mean())
        power_dbm = power_dbm + model.relaxation * (averaged - power_dbm)
    adjustable = (every_link | ~links.los(model.los_threshold)) & (log_distance > 1e-6)
    fitted = (power_dbm - received) / (10.0 * np.where(adjustable, log_distance, 1.0))
    return power_dbm, np.where(adjustable, np.maximum(fitted, _SMALLEST_EXPONENT), exponent)


def lsre_socp_iterative(
    links: Links, area: SearchArea, model: SignalModel, *, every_link: bool = False
) -> LsreAnswer:
    """(64) and (66)–(70) in turn, as printed, with the paper's stopping rules.

    ``every_link``: see ``update_power_and_exponents``.
    """
    exponent = first_exponents(links, model)
    power = first_power_dbm(model)
    previous: FloatArray | None = None
    cost, rises, status, rounds = np.inf, 0, "iteration limit", 0
    position = np.zeros(3)
    while rounds < model.maximum_iterations:
        rounds += 1
        gain = gains_per_m(links, power, exponent, model)
        raw, solver = solve_literal(links.position_enu_m, gain, interval_ends(links, exponent, model), area)
        position = area.clip(raw[None])[0]
        new_power, new_exponent = update_power_and_exponents(
            links, position, power, exponent, model, every_link=every_link
        )
        new_cost = rss_cost_db2(links, position, new_power, new_exponent, model)
        rises = rises + 1 if new_cost > cost + 1e-9 else 0
        settled = previous is not None and np.linalg.norm(position - previous) < model.position_tolerance_m
        steady = (
            abs(new_power - power) < model.transmit_power_tolerance_db
            and np.linalg.norm(new_exponent - exponent) < model.exponent_tolerance
        )
        previous, power, exponent, cost = position, new_power, new_exponent, new_cost
        if _status(solver) != "ok":
            status = _status(solver)
            break
        if settled or steady:
            status = "ok"
            break
        if rises >= model.diverging_rounds:
            status = "diverging"
            break
    return LsreAnswer(position, power, exponent, float(cost), rounds, status)


def lsre_criterion(
    links: Links, position: FloatArray, power: float, exponent: FloatArray, model: SignalModel
) -> float:
    """Σ_k Σ_r 1/(c_k r d_k)² + (c_k r d_k)² of (58)/(60)."""
    gain, weight = gains_per_m(links, power, exponent, model), _end_weight(links, exponent, model)
    relative = np.square(gain * np.linalg.norm(links.position_enu_m - position, axis=1))
    return float(weight @ (relative + 1.0 / np.maximum(relative, 1e-18)))


def _end_weight(links: Links, exponent: FloatArray, model: SignalModel) -> FloatArray:
    # The ends are each other's inverse, so both terms carry the same factor e̲² + ē².
    return np.array([sum(e * e for e in pair) for pair in interval_ends(links, exponent, model)])


def convex_concave(
    links: Links, start: FloatArray, power: float, exponent: FloatArray, area: SearchArea, model: SignalModel
) -> tuple[FloatArray, tuple[float, ...], str]:
    """Minimise the criterion from ``start`` at fixed power and exponents; it never rises.

    Returns the position (3,), the criterion after each step (the start's first), a status.
    """
    step = majoriser(
        links.position_enu_m,
        gains_per_m(links, power, exponent, model),
        _end_weight(links, exponent, model),
        area,
    )
    position = start
    values = [lsre_criterion(links, position, power, exponent, model)]
    for _ in range(_CCP_STEPS):
        candidate, solver = step(position)
        candidate = area.clip(candidate[None])[0]
        value = lsre_criterion(links, candidate, power, exponent, model)
        # Not better within the solver's tolerance (or clipped out of a polygon's hull): the end.
        if _status(solver) != "ok" or value > values[-1]:
            break
        position = candidate
        values.append(value)
        if values[-2] - value < _CCP_IMPROVEMENT * value:
            break
    return position, tuple(values), "ok"


def refit_power_and_exponent(
    links: Links, position: FloatArray, model: SignalModel
) -> tuple[float, FloatArray]:
    """Least squares of P_t and one shared NLOS exponent with their priors at a given position."""
    los = links.los(model.los_threshold)
    log_distance = 10.0 * np.log10(distances_m(links, position))
    shifted = received_dbm(links, model) + np.where(los, 0.0, 0.5 * model.nlos_bias_max_db)
    noise = np.where(
        los, model.rss_std_db, np.hypot(model.nlos_rss_std_db, model.nlos_bias_max_db / np.sqrt(12.0))
    )
    design = np.stack([np.ones(links.count), -np.where(los, 0.0, log_distance)], axis=1) / noise[:, None]
    right = (shifted + np.where(los, model.los_exponent * log_distance, 0.0)) / noise
    prior_mean = np.array([model.transmit_power_mean_dbm, model.first_exponent])
    exponent_std = (model.nlos_exponent_max - model.nlos_exponent_min) / np.sqrt(12.0)
    prior_std = np.maximum([model.transmit_power_std_db, exponent_std], 1e-6)
    precision = np.diag(1.0 / prior_std**2)
    power, exponent = np.linalg.solve(
        design.T @ design + precision, design.T @ right + precision @ prior_mean
    )
    exponent = float(np.clip(exponent, model.nlos_exponent_min, model.nlos_exponent_max))
    return float(power), np.where(los, model.los_exponent, exponent)


def lsre_ccp(links: Links, area: SearchArea, model: SignalModel) -> LsreAnswer:
    """The LSRE criterion by convex–concave steps, power and a shared exponent refitted between runs."""
    position = weighted_centroid(links, area, model)
    position = position + 1e-3
    power, exponent = first_power_dbm(model), first_exponents(links, model)
    values: tuple[float, ...] = ()
    status, rounds = "iteration limit", 0
    while rounds < model.maximum_iterations:
        rounds += 1
        moved, values, _ = convex_concave(links, position, power, exponent, area, model)
        new_power, new_exponent = refit_power_and_exponent(links, moved, model)
        settled = float(np.linalg.norm(moved - position)) < model.position_tolerance_m
        steady = (
            abs(new_power - power) < model.transmit_power_tolerance_db
            and float(np.abs(new_exponent - exponent).max()) < model.exponent_tolerance
        )
        position, power, exponent = moved, new_power, new_exponent
        if settled or steady:
            status = "ok"
            break
    cost = rss_cost_db2(links, position, power, exponent, model)
    return LsreAnswer(position, power, exponent, cost, rounds, status, values)


def _status(solver_status: str) -> str:
    return "ok" if solver_status in {"Solved", "AlmostSolved"} else f"solver: {solver_status}"
