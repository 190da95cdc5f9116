"""WLS-Taylor (30)–(51): the LOS solver, closed form, batched.

Exists because in line of sight angles and power ratios are linear in the position after one
Taylor step, so three small linear solves reach the Cramér–Rao bound within percents. Rule:
one code for one problem and for a batch, so that a study and the service agree.

The paper's K − 1 ratio rows (39) are K rows λ_k u_kᵀ(x − a_k) = η, λ_k = 10^(P_k / 10β), with
the unknown η = 10^(P_t / 10β) eliminated: a contrast of the same rows, hence the same weighted
answer, and the links' errors no longer share the reference. One unweighted solve gives the
point at which the Jacobians (47)–(48) are taken; two weighted solves follow (one leaves the
error at 1.01 × the bound). All of C is taken at that point, angles too, where (47) keeps the
measured angles: to first order the same, the cross terms C_φθ, C_βθ and C_βφ vanish, so that
Q = C W Cᵀ costs nothing; and a bearing that is wrong by a right angle cannot get an infinite
weight from the cosine of its error. RMSE over the bound is the same (tests).

``wls-taylor-bounded`` adds the height limits and the search area to each solve; ``wls-ideal``
knows the transmit power (K range rows) and takes the Jacobians at the true place.

The covariance is the Cramér–Rao bound at the answer where that holds. It does not where the
residuals are beyond what LOS noise does (a wrong label), or where the bearings cross so
flatly that one Taylor step does not describe the range: NaN there, for which ``locate`` puts the
posterior's spread about the answer. Scaling by the residuals (Birge's ratio) was tried and is
not honest: with one wrong bearing of four, 56 % of truths in the 90 % ellipsoid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from groundstation.localization.batch import Answers, Batch
from groundstation.localization.bounded import bounded_minimum, within_heights
from groundstation.localization.bounds import crlb
from groundstation.localization.problem import BoolArray, FloatArray, SearchArea, SignalModel

_RIDGE = 1e-12 * np.eye(3)
"""Against parallel bearings; rows have unit length, or over 1e-3 where they are weighted."""
_WEIGHTED_SOLVES = 2
_NEAREST_M = 0.1
"""Distances under it weigh as it: a row right under a vehicle must not become exact."""
_FAR = 30.0
"""Squared distances under so many variances of the answer are not known from the answer alone."""
_UNLIKELY = 1e-3
"""Residuals that LOS links show less often than this are not the model's noise."""
_LINEAR = 0.08
"""Largest range error, as a share of the range, at which one Taylor step describes the spread."""


@dataclass(frozen=True, slots=True, eq=False)
class WlsInput:
    """N problems of K LOS links with angles."""

    position: FloatArray
    """(N, K, 3) metres."""
    rss: FloatArray
    """(N, K) dBm."""
    azimuth: FloatArray
    """(N, K) radians."""
    elevation: FloatArray
    """(N, K) radians."""
    used: BoolArray | None = None
    """(N, K) links that count; None: all. The others' powers and angles may be anything, NaN too."""
    transmit_power_dbm: FloatArray | None = None
    """(N,) dBm where it is known; None: eliminated."""
    truth: FloatArray | None = None
    """(N, 3) where the Jacobians are taken instead of the last answer."""


@dataclass(frozen=True, slots=True, eq=False)
class WlsFit:
    """N weighted answers."""

    position: FloatArray
    """(N, 3) metres ENU; not finite where the rows do not determine one."""
    free: FloatArray
    """(N, 3) the last weighted solve's answer without bounds."""
    angle_chi2: FloatArray
    """(N,) squared angle residuals over their variances, summed."""
    crossing: FloatArray
    """(N,) Σ sin² of the bearings' angles to the line that they follow best: 0 if all are parallel."""


def wls_taylor(batch: Batch) -> Answers:
    """``wls-taylor`` on the LOS-labelled links with angles of each problem (two or more)."""
    return _answers(batch, None, None, None)


def wls_taylor_bounded(batch: Batch) -> Answers:
    """``wls-taylor`` inside the target's height limits and the search area."""
    return _answers(batch, batch.area, None, None)


def wls_ideal(batch: Batch) -> Answers:
    """``wls-ideal``: with the true transmit power; Jacobians at the true place where it is given.

    Without ``truth_enu_m`` they are taken at the last answer, as everywhere else.
    """
    return _answers(batch, None, batch.true_power_dbm(), batch.truth_enu_m)


def _answers(
    batch: Batch, area: SearchArea | None, power: FloatArray | None, truth: FloatArray | None
) -> Answers:
    used, links, model = batch.bearing_usable(), batch.links, batch.model
    received = batch.received_dbm()
    problem = WlsInput(
        links.position_enu_m, received, links.azimuth_rad, links.elevation_rad, used, power, truth
    )
    fit = fitted(problem, model, area)
    position = fit.position
    solved: BoolArray = np.asarray(np.isfinite(position).all(axis=1))
    at = position if solved.all() else np.where(solved[:, None], position, 0.0)
    count = used.sum(axis=1)
    emitted = received + 10.0 * model.los_exponent * np.log10(batch.distances_m(at))
    known = power is not None
    if power is None:
        power = np.where(used, emitted, 0.0).sum(axis=1) / count
    miss_db = np.where(used, emitted - power[:, None], 0.0)
    chi2 = fit.angle_chi2 + np.square(miss_db).sum(axis=1) / model.rss_std_db**2
    freedom = 3 * count - (3 if known else 4)
    covariance = _covariance(problem, at, model)
    if area is not None:
        covariance = within_heights(covariance, fit.free[:, 2], position[:, 2], area)
    angle_std = max(model.azimuth_std_rad, model.elevation_std_rad)
    holds = (chi2 <= chdtri(freedom, _UNLIKELY)) & (fit.crossing >= (angle_std / _LINEAR) ** 2)
    covariance[~(holds & solved)] = np.nan
    status = ["ok"] * batch.size
    for row in np.flatnonzero(~solved):
        status[row] = "the bearings are parallel; vehicles in different directions are needed"
    rounds = np.full(batch.size, 1 + _WEIGHTED_SOLVES)
    return Answers(position, power, batch.first_exponents(), rounds, status, covariance)


def _covariance(problem: WlsInput, at: FloatArray, model: SignalModel) -> FloatArray:
    """(N, 3, 3) the bound at the answer; near a vehicle the bound expected of a place not better known."""
    known = problem.transmit_power_dbm is not None
    place, used = problem.position, problem.used
    covariance = crlb(at, place, model, None, known, used=used)
    spread = covariance[:, 0, 0] + covariance[:, 1, 1]
    offset = at[:, None, :2] - place[..., :2]
    horizontal2 = np.einsum("nki,nki->nk", offset, offset)
    nearest2 = horizontal2.min(axis=1, initial=np.inf, where=True if used is None else used)
    near = np.flatnonzero(nearest2 < _FAR * spread)
    if near.size:
        covariance[near] = crlb(
            at[near], place[near], model, None, known,
            used=None if used is None else used[near], spread_m2=spread[near],
        )  # fmt: skip
    return covariance


def positions(problem: WlsInput, model: SignalModel, area: SearchArea | None = None) -> FloatArray:
    """Positions (N, 3), metres ENU; bounded by ``area`` when it is given."""
    return fitted(problem, model, area).position


def fitted(problem: WlsInput, model: SignalModel, area: SearchArea | None = None) -> WlsFit:
    """One unweighted and two weighted solves of N problems, inside ``area`` when it is given."""
    place = problem.position
    size, links = problem.rss.shape
    used = np.ones((size, links), dtype=bool) if problem.used is None else problem.used
    count = used.sum(axis=1)
    known = problem.transmit_power_dbm
    azimuth, elevation = np.where(used, problem.azimuth, 0.0), np.where(used, problem.elevation, 0.0)
    rss = np.where(used, problem.rss, -np.inf)
    strongest = rss.argmax(axis=1)
    reference_dbm = rss.max(axis=1)
    # λ relative to the strongest link's; zero where a link is not used.
    gain = np.exp((rss - reference_dbm[:, None]) * (math.log(10.0) / (10.0 * model.los_exponent)))
    cos_az, sin_az, cos_el, sin_el = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    rows = np.zeros((size, 3, links, 4))
    rows[:, 0, :, 0] = sin_az
    rows[:, 0, :, 1] = -cos_az
    rows[:, 1, :, 0] = sin_el * cos_az
    rows[:, 1, :, 1] = sin_el * sin_az
    rows[:, 1, :, 2] = -cos_el
    scaled = gain * cos_el
    rows[:, 2, :, 0] = scaled * cos_az
    rows[:, 2, :, 1] = scaled * sin_az
    rows[:, 2, :, 2] = gain * sin_el
    rows[..., 3] = np.einsum("nski,nki->nsk", rows[..., :3], place)
    ranges = rows[:, 2]
    if known is None:
        ranges -= ranges.sum(axis=1, keepdims=True) / count[:, None, None]
    else:
        level = np.exp((known - reference_dbm) * (math.log(10.0) / (10.0 * model.los_exponent)))
        ranges[..., 3] += level[:, None]
    rows *= used[:, None, :, None]
    answer, _ = _solve(rows, area)
    per_db = math.log(10.0) / (10.0 * model.los_exponent)
    every = np.arange(size)
    weight = np.empty((size, 3, links))
    free = answer
    for _ in range(_WEIGHTED_SOLVES):
        offset = (answer if problem.truth is None else problem.truth)[:, None, :] - place
        squared = offset * offset
        horizontal2 = squared[..., 0] + squared[..., 1]
        distance = np.sqrt(np.maximum(horizontal2 + squared[..., 2], _NEAREST_M**2))
        horizontal = np.sqrt(np.maximum(horizontal2, _NEAREST_M**2))
        weight[:, 0] = 1.0 / (model.azimuth_std_rad * horizontal)
        weight[:, 1] = 1.0 / (model.elevation_std_rad * distance)
        level_now = distance[every, strongest] if known is None else level
        weight[:, 2] = (1.0 / (per_db * model.rss_std_db) / level_now)[:, None]
        answer, free = _solve(rows * weight[..., None], area)
    angles = rows[:, :2]
    miss = (np.einsum("nski,ni->nsk", angles[..., :3], answer) - angles[..., 3]) * weight[:, :2]
    across = angles[..., :3].reshape(size, -1, 3)
    crossing: FloatArray = np.asarray(np.linalg.eigvalsh(np.swapaxes(across, 1, 2) @ across)[:, 0])
    return WlsFit(answer, free, np.einsum("nsk,nsk->n", miss, miss), crossing)


def _solve(rows: FloatArray, area: SearchArea | None) -> tuple[FloatArray, FloatArray]:
    """Least squares of rows (N, 3, K, 4), right side last: (N, 3) inside the area, and free."""
    flat = rows.reshape(len(rows), -1, 4)
    square = np.swapaxes(flat[..., :3], 1, 2) @ flat
    normal = square[:, :, :3] + _RIDGE
    free: FloatArray = np.asarray(np.linalg.solve(normal, square[:, :, 3:])[..., 0], dtype=np.float64)
    return (free if area is None else bounded_minimum(normal, square[:, :, 3], free, area)), free
