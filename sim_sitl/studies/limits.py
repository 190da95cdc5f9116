"""What no estimator beats, computed on the very trials that the methods are scored on.

Rules: shares no code with ``groundstation.localization``'s likelihood, posterior or solvers,
or the methods would be checked against themselves; and knows the true generative model, as a
best estimator would. With all links LOS the limit is the Cramér–Rao bound (unknown transmit
power). Elsewhere it is the squared error of the exact posterior mean, which no estimator's
mean squared error is under. The posterior is computed by brute force: candidates drawn from the
prior and along the bearings, weighted by prior over proposal (balance heuristic: Veach &
Guibas, 1995) and by the exact likelihood, with power, exponent, bias and link states summed out.

What it knows of link states is each link's label as solvers are given it, weighed by how much
more often such a label comes with a line of sight (measured on other links, so that it holds
for a classifier whose probabilities are off too), and the case's joint prior over states
(15/25/60 % in V-D), which solvers are not told: worth 0.3 m of 26.6 m there.

V-D has no such bound for solvers as they are: its vehicles stand round the target, so that their
places alone tell where it is about. No solver takes them for evidence, and neither does the limit
that its cases give; it is then what is to be had from the links under the solvers' own
prior, and its name says so. With ``Knowledge.places`` it is the bound (21 m where the other is 35 m).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from groundstation.localization import SearchArea, crlb
from groundstation.localization.problem import BoolArray, FloatArray
from sim_sitl.studies.channels import AngleReport, wrapped_rad
from sim_sitl.studies.laws import Law
from sim_sitl.studies.trials import Trials

CANDIDATES = 512
"""Candidate positions a trial."""
_ANYWHERE = 1.0 / (2.0 * math.pi**2)
"""Density of NLOS angles, 1/rad²: uniform in azimuth and elevation."""
_RECURRENCE = 1.2207440846057596 ** -np.arange(1.0, 4.0)
"""Steps of an additive recurrence that fills the cube evenly: inverse powers of the root of x⁴ = x + 1."""


def crlb_square_m2(trials: Trials) -> FloatArray:
    """(N,) trace of the Cramér–Rao bound at the truth, unknown transmit power, m²."""
    bound = crlb(trials.truth_enu_m, trials.links.position_enu_m, trials.model)
    result: FloatArray = np.trace(bound, axis1=-2, axis2=-1)
    return result


@dataclass(frozen=True, slots=True, eq=False)
class StatePrior:
    """Which combinations of link states there are."""

    line_of_sight: BoolArray
    """(C, K) the combinations."""
    weight: FloatArray
    """(C,) prior probability of each."""


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """The generative model that the limit knows; picklable parts of a case."""

    law: Law
    """Received power."""
    angles: AngleReport
    """Reported angles."""
    states: StatePrior | None = None
    """Prior over link states; None where ``los_probability`` holds the true labels."""
    odds: Callable[[FloatArray], FloatArray] | None = None
    """With ``states``: how P(line of sight) (…) maps to likelihood ratios LOS : NLOS (…)."""
    places: Callable[[FloatArray, FloatArray], FloatArray] | None = None
    """Density of vehicles (K, 3) given each of S targets (S, 3), where they are evidence."""


def posterior_moments(
    trials: Trials, knowledge: Knowledge, rng: np.random.Generator, candidates: int = CANDIDATES
) -> tuple[FloatArray, FloatArray]:
    """Exact posterior means (N, 3), metres ENU, and the traces of the covariances (N,), m².

    ``candidates`` positions a trial decide how exact. Over many trials the mean squared error
    equals the mean trace, if what is known is how the trials came about.
    """
    shift = rng.random((trials.count, 3))
    means, traces = np.empty((trials.count, 3)), np.empty(trials.count)
    for row in range(trials.count):
        place, weight = _weighted(trials, row, knowledge, shift[row], candidates)
        means[row] = weight @ place
        traces[row] = weight @ np.square(place - means[row]).sum(axis=1)
    return means, traces


def posterior_square_m2(
    trials: Trials, knowledge: Knowledge, rng: np.random.Generator, candidates: int = CANDIDATES
) -> FloatArray:
    """(N,) squared error of the exact posterior mean, m²."""
    means, _ = posterior_moments(trials, knowledge, rng, candidates)
    result: FloatArray = np.square(means - trials.truth_enu_m).sum(axis=1)
    return result


def _weighted(
    trials: Trials, row: int, knowledge: Knowledge, shift: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """Candidates (S, 3) of one trial and their posterior weights (S,), which sum to one."""
    links, law = trials.links, knowledge.law
    ratio, combinations, prior = _evidence_of_states(links.los_probability[row], knowledge)
    rays = [
        _Ray(vehicle, azimuth, elevation, knowledge.angles, trials.area)
        for vehicle, azimuth, elevation in zip(
            links.position_enu_m[row], links.azimuth_rad[row], links.elevation_rad[row], strict=True
        )
    ]
    share = _proposal_shares(ratio, combinations, prior)
    place, proposal = _propose(trials.area, rays, share, shift, count)
    offset = links.position_enu_m[row] - place[:, None, :]
    rss = links.rss_dbm[row]
    # Only what some combination asks for is looked up: that is where the time goes.
    sometimes = np.asarray(combinations.any(axis=0))
    always = np.asarray(combinations.all(axis=0))
    each = [(rss[k : k + 1], offset[:, k : k + 1]) for k in range(links.count)]
    los = [law.los(*link)[0] if sometimes[k] else None for k, link in enumerate(each)]
    nlos = [None if always[k] else law.nlos(*link)[0] for k, link in enumerate(each)]
    bearing = np.stack([ray.angle_density(place) for ray in rays]) / _ANYWHERE
    likelihood = np.zeros(len(place))
    for combination, weight in zip(combinations, prior, strict=True):
        clear = np.flatnonzero(combination)
        chosen = np.flatnonzero(np.all(bearing[clear] > 0.0, axis=0))
        value = weight * np.prod(ratio[clear]) * bearing[np.ix_(clear, chosen)].prod(axis=0)
        likelihood[chosen] += value * _rss_likelihood(law, los, nlos, combination, chosen)
    weights = likelihood / proposal
    if knowledge.places is not None:
        weights *= knowledge.places(links.position_enu_m[row], place)
    total = weights.sum()
    if not total > 0.0:
        # Bearings that all miss the area leave nothing to weigh: the prior's mean is left.
        return _centre(trials.area)[None, :], np.ones(1)
    return place, weights / total


def _rss_likelihood(
    law: Law, los: list[Any], nlos: list[Any], combination: BoolArray, chosen: Any
) -> FloatArray:
    """(S,) density of all received powers given the link states, power and classes summed out.

    ``los`` and ``nlos``: by link, densities (S, L) and (S, C, L).
    """
    clear = np.broadcast_to(law.level_weight, (len(chosen), law.level_weight.size))
    obstructed: Any = None
    for k, line_of_sight in enumerate(combination):
        density = los[k] if line_of_sight else nlos[k]
        if len(chosen) < len(density):
            density = density[chosen]
        if line_of_sight:
            clear = clear * density
        else:
            obstructed = density if obstructed is None else obstructed * density
    if obstructed is None:
        return np.asarray(clear.sum(axis=-1))
    per_class = np.einsum("scl,sl->sc", obstructed, clear)
    return np.asarray(per_class @ law.class_weight)


def _evidence_of_states(
    probability: FloatArray, knowledge: Knowledge
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Likelihood ratio LOS : NLOS of each link's label, the combinations it leaves, and their prior."""
    states = knowledge.states
    if states is None or knowledge.odds is None:
        return np.ones(probability.size), probability[None, :] > 0.5, np.ones(1)
    return knowledge.odds(probability), states.line_of_sight, states.weight


def _proposal_shares(ratio: FloatArray, combinations: BoolArray, prior: FloatArray) -> FloatArray:
    """(1 + K,) share of candidates from the prior and along each link's bearing."""
    odds = prior * np.where(combinations, ratio, 1.0).prod(axis=1)
    odds = odds / odds.sum()
    if len(odds) > 1:
        # Angles decide between states too: no combination goes without candidates.
        odds = 0.5 * odds + 0.5 / len(odds)
    clear = combinations.sum(axis=1)
    each = odds[:, None] * combinations / np.maximum(clear, 1)[:, None]
    return np.concatenate([[odds[clear == 0].sum()], each.sum(axis=0)])


def _propose(
    area: SearchArea, rays: list[_Ray], share: FloatArray, shift: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """Candidates (S, 3) inside the area, and the density they were drawn from over the prior's."""
    numbers = np.rint(share * count).astype(int)
    low, high = area.height_min_m, area.height_max_m
    prior_density = 1.0 / (math.pi * area.radius_m**2 * (high - low))
    parts = []
    for source, number in enumerate(numbers):
        own = np.mod(shift + source * 0.38196601 + np.arange(1.0, number + 1.0)[:, None] * _RECURRENCE, 1.0)
        if source == 0:
            parts.append(_in_disc(area, own))
        elif number:
            parts.append(rays[source - 1].draw(own))
    place = np.concatenate(parts)
    density = np.full(len(place), share[0] * prior_density)
    for ray, part in zip(rays, share[1:], strict=True):
        if part > 0.0:
            density += part * ray.proposal_density(place)
    return place, density / prior_density


def _in_disc(area: SearchArea, unit: FloatArray) -> FloatArray:
    distance = area.radius_m * np.sqrt(unit[:, 0])
    azimuth = 2.0 * math.pi * unit[:, 1]
    height = area.height_min_m + (area.height_max_m - area.height_min_m) * unit[:, 2]
    east, north = distance * np.cos(azimuth), distance * np.sin(azimuth)
    return np.stack([east + area.center_enu_m[0], north + area.center_enu_m[1], height], axis=1)


def _centre(area: SearchArea) -> FloatArray:
    """(3,) the prior's mean: what is left to say where every candidate is impossible."""
    return np.array([*area.center_enu_m[:2], 0.5 * (area.height_min_m + area.height_max_m)])


class _Ray:
    """The bearing that one link reports, as a source of candidates and as evidence."""

    def __init__(
        self, vehicle: FloatArray, azimuth: float, elevation: float, angles: AngleReport, area: SearchArea
    ) -> None:
        self._vehicle, self._azimuth, self._elevation = vehicle, float(azimuth), float(elevation)
        self._area = area
        self._std = math.radians(angles.std_deg)
        self._half_step = 0.5 * math.radians(angles.rounded_deg)

    def draw(self, unit: FloatArray) -> FloatArray:
        """Candidates from (S, 3) uniform numbers: two angle errors, then the range inside the area."""
        azimuth = self._azimuth + self._error(unit[:, 0])
        elevation = self._elevation + self._error(unit[:, 1])
        near, far = self._reach(azimuth, elevation)
        keep = far > near
        azimuth, elevation, near, far = azimuth[keep], elevation[keep], near[keep], far[keep]
        horizontal = near + unit[keep, 2] * (far - near)
        east, north = horizontal * np.cos(azimuth), horizontal * np.sin(azimuth)
        gap: FloatArray = np.stack([east, north, horizontal * np.tan(elevation)], axis=1)
        return gap + self._vehicle

    def angle_density(self, place: FloatArray) -> FloatArray:
        """(S,) density of the reported angles for a LOS link from each place, 1/rad²."""
        azimuth, elevation, _ = self._angles(place)
        return self._angle_density(azimuth, elevation)

    def proposal_density(self, place: FloatArray) -> FloatArray:
        """(S,) density that ``draw`` has at each place, 1/m³."""
        azimuth, elevation, distance = self._angles(place)
        near, far = self._reach(azimuth, elevation)
        angle = self._density(wrapped_rad(azimuth - self._azimuth)) * self._density(
            elevation - self._elevation
        )
        # The volume element is ρ² / cos² of elevation = d² in (azimuth, elevation, horizontal range).
        return np.where(far > near, angle / (np.maximum(far - near, 1e-9) * np.square(distance)), 0.0)

    def _angles(self, place: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        gap = place - self._vehicle
        horizontal = np.hypot(gap[:, 0], gap[:, 1])
        azimuth = np.arctan2(gap[:, 1], gap[:, 0])
        return azimuth, np.arctan2(gap[:, 2], horizontal), np.maximum(np.hypot(horizontal, gap[:, 2]), 1e-3)

    def _reach(self, azimuth: FloatArray, elevation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Horizontal ranges between which a bearing lies inside the area; empty where far ≤ near."""
        slope = np.tan(elevation)
        slope = np.where(np.abs(slope) < 1e-12, 1e-12, slope)
        low = (self._area.height_min_m - self._vehicle[2]) / slope
        high = (self._area.height_max_m - self._vehicle[2]) / slope
        from_centre = self._vehicle[:2] - self._area.center_enu_m[:2]
        along = from_centre[0] * np.cos(azimuth) + from_centre[1] * np.sin(azimuth)
        square = np.square(along) - from_centre @ from_centre + self._area.radius_m**2
        half = np.sqrt(np.maximum(square, 0.0))
        near = np.maximum(np.maximum(np.minimum(low, high), -along - half), 0.0)
        far = np.minimum(np.maximum(low, high), -along + half)
        return near, np.where((square > 0.0) & (np.abs(elevation) < 0.5 * math.pi), far, -1.0)

    def _angle_density(self, azimuth: FloatArray, elevation: FloatArray) -> FloatArray:
        across = self._density(wrapped_rad(azimuth - self._azimuth))
        along = self._density(elevation - self._elevation)
        return np.asarray(across * along, dtype=np.float64)

    def _error(self, unit: FloatArray) -> FloatArray:
        if self._half_step > 0.0:
            return np.asarray(self._half_step * (2.0 * unit - 1.0))
        return np.asarray(self._std * ndtri(np.clip(unit, 1e-12, 1.0 - 1e-12)))

    def _density(self, error: FloatArray) -> FloatArray:
        if self._half_step > 0.0:
            return np.asarray(np.where(np.abs(error) <= self._half_step, 0.5 / self._half_step, 0.0))
        return np.asarray(
            np.exp(-0.5 * np.square(error / self._std)) / (self._std * math.sqrt(2.0 * math.pi))
        )
