"""Why a belief is what it is: each vehicle's weight, and how well it agrees ("why do you think so?").

Exists because an operator who sends people somewhere must be able to ask, and because a
receiver that is wrong shows here first. Rules: nothing here changes a belief; the numbers are
those of the belief's own likelihood, never of a second model.

* **Weight.** A vehicle's rows of the whitened regression and its bearings are taken away from
  the belief's sums (by the chain rule p(y|x) = Π p(y_i | nearest earlier ones, x) they are a
  factor of the likelihood), which gives the belief p₋ᵥ. The information that v brought is the
  relative entropy D(p ‖ p₋ᵥ) (Lindley, 1956); weights are these, scaled to add up to one. Many
  vehicles that say the same each bring little: that is what "can be spared" means.
* **Area factor.** exp(H(p₋ᵥ) − H(p)), H the entropy over places: the space where the beacon may be
  were so many times as large without v. Below one where v contradicts the others.
* **Residual of the power.** A constant δ_v added to all of the vehicle's powers, fitted by
  generalised least squares at the estimate with power, offsets and exponents integrated out (the
  mean-shift test of a group of observations: Cook & Weisberg, Residuals and Influence in
  Regression, 1982, §2.2): what it hears beyond what the *others* and the priors let expect. Its
  variance takes in the offset's prior and the spread of the place.
* **Residual of the bearing.** Mean turn between bearing and estimate, each window weighed by its
  P(line of sight) and its news; the variance takes in the vehicle's constant error and the
  spread of the place.

The belief's hundreds of boxes are thinned to a fixed set of weighed ones, chosen systematically,
the same at every call: shares are told in whole percent, and this costs a tenth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from groundstation.localization.bearings import angle_log_likelihood
from groundstation.localization.mesh import Mesh, joined, moments
from groundstation.localization.problem import FloatArray, SignalModel
from groundstation.localization.regression import Evidence
from groundstation.localization.whitening import Observations, Whitened, whiten
from groundstation.tracking.belief import Belief

_PLACES = 160
_LN10 = math.log(10.0)


@dataclass(frozen=True, slots=True)
class LinkExplanation:
    """One vehicle's part in a belief."""

    vehicle_id: int
    weight: float
    """Share of the information about the place that it brought, 0 to 1; all vehicles add up to 1."""
    area_factor: float
    """How many times as large the space of the belief were without it; below 1: it contradicts."""
    windows: int
    """Windows of it that are remembered."""
    power_residual_db: float | None
    """How much stronger it hears the beacon than the estimate explains, dB; None: it never told a power."""
    power_score: float | None
    """The same over its standard deviation."""
    azimuth_residual_rad: float | None
    """Mean turn of its bearings from the estimate, counter-clockwise, radians; None: it told none."""
    azimuth_score: float | None
    """The same over its standard deviation."""
    elevation_residual_rad: float | None
    """Mean of its elevations less the estimate's, up positive, radians."""
    elevation_score: float | None
    """The same over its standard deviation."""
    los_probability: float | None
    """Mean P(line of sight) of its judged windows; None: none was judged."""


def explain(belief: Belief) -> tuple[LinkExplanation, ...]:
    """Each vehicle's weight and residuals, in the order of their ids; empty for an empty belief."""
    observations = belief.observations()
    vehicles = belief.vehicles
    if not vehicles or observations.count == 0:
        return ()
    rows = whiten(observations, 0, len(vehicles), belief.settings.correlation_m, belief.model)
    gain, lost = _information(belief, observations, rows)
    weight = gain / max(float(gain.sum()), 1e-12)
    place, spread = moments(belief.mesh, belief.mass)
    # A vehicle that is off by a metre sees a bearing off that nobody's compass is to blame for.
    spreads = [spread + _of_vehicle(observations, link, belief.model) for link in range(len(vehicles))]
    powers = _power_residuals(belief, observations, rows, place, spreads)
    found = []
    for link, vehicle_id in enumerate(vehicles):
        mine = observations.link == link
        power, power_score = powers[link]
        azimuth, azimuth_score, elevation, elevation_score = _bearing_residuals(
            observations, mine, place, spreads[link], belief.model.angle_bias_std_rad
        )
        found.append(
            LinkExplanation(
                vehicle_id=vehicle_id,
                weight=float(weight[link]),
                area_factor=float(np.exp(lost[link])),
                windows=int(mine.sum()),
                power_residual_db=power,
                power_score=power_score,
                azimuth_residual_rad=azimuth,
                azimuth_score=azimuth_score,
                elevation_residual_rad=elevation,
                elevation_score=elevation_score,
                los_probability=_los_probability(observations, mine),
            )
        )
    return tuple(sorted(found, key=lambda link: link.vehicle_id))


def thinned(mesh: Mesh, mass: FloatArray, count: int = _PLACES) -> tuple[Any, FloatArray]:
    """``count`` boxes that stand for all: their numbers, and the log volume that each stands for.

    Systematic sampling from a mixture of the belief and its square root by volume (what the belief
    may become when a vehicle is taken away), each box weighed by the inverse of its chance.
    """
    if mesh.count <= count:
        return np.arange(mesh.count), mesh.log_volume
    volume = np.exp(mesh.log_volume)
    wide = np.sqrt(mass * volume)
    chance = 0.5 * mass / mass.sum() + 0.4 * wide / wide.sum() + 0.1 * volume / volume.sum()
    edges = np.cumsum(chance)
    points = (np.arange(count) + 0.5) / count * edges[-1]
    chosen, times = np.unique(np.searchsorted(edges, points), return_counts=True)
    return chosen, mesh.log_volume[chosen] + np.log(times / (count * chance[chosen]))


def _information(belief: Belief, observations: Observations, rows: Whitened) -> tuple[FloatArray, FloatArray]:
    """(V,) D(p ‖ p₋ᵥ) and (V,) H(p₋ᵥ) − H(p), nats."""
    # Without a vehicle the person may be where there is nothing with it.
    everywhere = joined([belief.mesh, belief.gone])
    chosen, log_volume = thinned(everywhere, np.append(belief.mass, np.zeros(belief.gone.count)))
    mesh = everywhere.keep(chosen)
    links = len(belief.vehicles)
    parts = [_part(belief, observations, rows, mesh, link) for link in range(links)]
    whole = _sum(parts)

    def log_likelihood(evidence: Evidence) -> FloatArray:
        return evidence.log_likelihood(belief.exponents, belief.settings.noise_degrees)

    # What is no vehicle's (the prior map, silence) stays when a vehicle goes.
    remembered, otherwise = log_likelihood(whole), belief.fields_at(mesh)
    kept = np.flatnonzero(chosen < belief.mesh.count)
    log_density = belief.log_likelihood[chosen[kept]]
    others = otherwise.copy()
    others[kept] = log_density - remembered[kept]
    # What forgotten windows said is not known of boxes that were let go: as at the likeliest one.
    best = kept[np.argmax(log_density)]
    gone = chosen >= belief.mesh.count
    others[gone] += others[best] - otherwise[best]
    log_density = remembered + others
    log_p = _normalised(log_density + log_volume)
    p = np.exp(log_p)
    gain, lost = np.zeros(links), np.zeros(links)
    for link, part in enumerate(parts):
        log_q = _normalised(log_likelihood(_difference(whole, part)) + others + log_volume)
        gain[link] = max(float(p @ (log_p - log_q)), 0.0)
        lost[link] = float(np.exp(log_q) @ (log_volume - log_q) - p @ (log_volume - log_p))
    return gain, lost


def _part(belief: Belief, observations: Observations, rows: Whitened, mesh: Mesh, link: int) -> Evidence:
    """What one vehicle's rows add to the sums at the boxes of ``mesh``."""
    own = rows.take(observations.link[rows.rows] == link)
    part = Evidence.empty(mesh.count, len(belief.vehicles), len(belief.model.los_shares))
    part.add(observations, own, mesh.center_enu_m, belief.model.has_antenna_null)
    heard = np.flatnonzero((observations.link == link) & np.isfinite(observations.azimuth_rad))
    if heard.size:
        part.angle_log += angle_log_likelihood(
            observations.take(heard), 0, mesh.center_enu_m, mesh.half_m, belief.model
        )
    return part


_SUMS = tuple(field.name for field in fields(Evidence) if field.name != "loading_loading")


def _sum(parts: list[Evidence]) -> Evidence:
    """Sums of all vehicles; the prior, which each part holds, counts once."""
    prior = np.eye(parts[0].level_loading.size)
    total = {name: sum(getattr(part, name) for part in parts) for name in _SUMS}
    return replace(
        parts[0], loading_loading=prior + sum(part.loading_loading - prior for part in parts), **total
    )


def _difference(whole: Evidence, part: Evidence) -> Evidence:
    """The sums without one vehicle's."""
    prior = np.eye(part.level_loading.size)
    rest = {name: getattr(whole, name) - getattr(part, name) for name in _SUMS}
    return replace(whole, loading_loading=whole.loading_loading - part.loading_loading + prior, **rest)


def _normalised(log_mass: FloatArray) -> FloatArray:
    top = log_mass - log_mass.max()
    result: FloatArray = top - math.log(float(np.exp(top).sum()))
    return result


def _of_vehicle(observations: Observations, link: int, model: SignalModel) -> FloatArray:
    """(3, 3) m²: how far off its places may be."""
    said = observations.place_variance_m2[observations.link == link]
    flat, upright = said.mean(axis=0) if len(said) else model.vehicle_variance_m2
    return np.diag([flat, flat, upright])


def _power_residuals(
    belief: Belief, observations: Observations, rows: Whitened, place: FloatArray, spreads: list[FloatArray]
) -> list[tuple[float | None, float | None]]:
    """For each vehicle δ_v in dB, and over its standard deviation; ``spreads``: (3, 3) m² for each."""
    links = len(belief.vehicles)
    if not rows.rows.size:
        return [(None, None)] * links
    losses = Evidence.loss_rows(observations, rows, place[None], belief.model.has_antenna_null)
    means, stds = _orders(belief.model)
    residual = rows.level + sum(mean * loss[:, 0] for mean, loss in zip(means, losses, strict=True))
    # Everything that is shared and not known, each with its prior as unit variance.
    loading = np.column_stack(
        [rows.loading, *(-std * loss[:, 0] for std, loss in zip(stds, losses, strict=True))]
    )
    parents = observations.parents[rows.rows]
    members = np.concatenate([rows.rows[:, None], np.where(parents >= 0, parents, 0)], axis=1)
    # (r, V): what one decibel more on all of a vehicle's powers does to each row.
    shift = np.stack(
        [(rows.mixing * (observations.link[members] == link)).sum(axis=1) for link in range(links)], axis=1
    )
    both = np.column_stack([residual, shift])
    precision = np.eye(loading.shape[1]) + loading.T @ loading
    shared = np.linalg.solve(precision, loading.T @ both)
    cleared = both - loading @ shared
    los, nlos = (means[order] + stds[order] * shared[order - 3, 0] for order in (0, 1))
    found: list[tuple[float | None, float | None]] = []
    for link in range(links):
        worth = float(shift[:, link] @ cleared[:, 1 + link])
        if worth < 1e-9:
            found.append((None, None))
            continue
        delta_db = float(shift[:, link] @ cleared[:, 0]) / worth
        mine = (observations.link == link) & np.isfinite(observations.rss_dbm)
        away = place - observations.position_enu_m[mine]
        p = observations.los_probability[mine]
        exponent = p * los + (1.0 - p) * nlos
        square = np.maximum(np.square(away).sum(axis=1), 1.0)
        slope = ((10.0 / _LN10 * exponent / square)[:, None] * away).mean(axis=0)
        std_db = math.sqrt(1.0 / worth + float(slope @ spreads[link] @ slope))
        found.append((delta_db, delta_db / std_db))
    return found


def _orders(model: SignalModel) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Prior means and standard deviations of β_LOS, β_NLOS (uniform) and the order of the antennas' null."""
    low, high = model.nlos_exponent_min, model.nlos_exponent_max
    return (
        (model.los_exponent, 0.5 * (low + high), model.antenna_null_mean),
        (model.los_exponent_std, (high - low) / math.sqrt(12.0), model.antenna_null_std),
    )


def _bearing_residuals(
    observations: Observations, mine: Any, place: FloatArray, spread: FloatArray, constant_rad: float
) -> tuple[float | None, float | None, float | None, float | None]:
    """Azimuth's and elevation's mean residual, radians, each with its score."""
    heard = mine & np.isfinite(observations.azimuth_rad) & np.isfinite(observations.elevation_rad)
    worth = observations.angle_weight[heard] * observations.angle_probability[heard]
    if not heard.any() or worth.sum() < 1e-9:
        return None, None, None, None
    away = place - observations.position_enu_m[heard]
    flat = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1.0)
    square = flat**2 + away[:, 2] ** 2
    azimuth = observations.azimuth_rad[heard] - np.arctan2(away[:, 1], away[:, 0])
    azimuth = (azimuth + math.pi) % (2.0 * math.pi) - math.pi
    elevation = observations.elevation_rad[heard] - np.arctan2(away[:, 2], flat)
    std = observations.angle_std_rad[heard]
    zero = np.zeros(flat.size)
    turn = np.stack([-away[:, 1], away[:, 0], zero], axis=1) / flat[:, None] ** 2
    lift = np.stack([-away[:, 0] * away[:, 2] / flat, -away[:, 1] * away[:, 2] / flat, flat], axis=1)
    lift /= square[:, None]
    found: list[float] = []
    for residual, sigma, slope in ((azimuth, std[:, 0], turn), (elevation, std[:, 1], lift)):
        share = worth / sigma**2
        mean = float(share @ residual / share.sum())
        across = share @ slope / share.sum()
        # White errors average out, the vehicle's constant one does not.
        variance = constant_rad**2 + 1.0 / share.sum() + float(across @ spread @ across)
        found += [mean, mean / math.sqrt(variance)]
    return found[0], found[1], found[2], found[3]


def _los_probability(observations: Observations, mine: Any) -> float | None:
    # A window that nobody judged counts as NLOS for its power and as even for its bearing.
    judged = mine & ~((observations.los_probability == 0.0) & (observations.angle_probability == 0.5))
    return float(observations.los_probability[judged].mean()) if judged.any() else None
