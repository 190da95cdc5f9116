"""The exact Bayes filter of a tracking run: what no estimator's mean squared error is under.

Exists as the yardstick of issue-sized claims ("within 8 % of the best there is"). Rules: it knows
the true generative model (``World``), link states included; it shares no code with
``groundstation.localization`` or ``tracking``; and it is brute force: a sum over places, exponents and
transmit powers, with biases and the angles' constant errors integrated in closed form.

The shadowing of a vehicle's windows is Gaussian with covariance Σ = σ² exp(−Δ/d), whatever the place x:
with Σ = L Lᵀ, the rows of L⁻¹ y are independent, and as L is lower triangular the running sums
over rows give the likelihood at every time in one pass. With z = L⁻¹ y, g = L⁻¹ 1, h(x) = L⁻¹ 10 log₁₀ d(x),
what is left at any time is Gaussian in c = P_t − b:

    −½ Σ (z + β h − c g)² = −½ q(x, β) − ½ a (c − m(x, β))²,  a = Σ g²

∫ over b ~ U(0, b_max) is a difference of normal distribution functions of P_t − m; the sums over
β (Gauss–Legendre) and P_t are numerical. Where all links are obstructed, places are a grid over
the disc; where one is in line of sight the belief may be a metre wide, and places are
drawn evenly (a low-discrepancy sequence) from a Student-t fitted to it and weighted by what it is.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.ndimage import zoom
from scipy.spatial.distance import cdist
from scipy.special import gammaincinv, ndtr, ndtri

from groundstation.localization.problem import FloatArray
from sim_sitl.studies.tracking.answers import SHARES, Answers, level_and_areas, points_region
from sim_sitl.studies.tracking.world import Run, World

_FLOOR_M = 1.0
_DB_OF_SQUARE = 5.0 / math.log(10.0)
"""10 log₁₀ d = so much times ln d²."""
_NEGLIGIBLE = 30.0
"""Log likelihood below the highest at which a combination is left out."""
_FINER = 4
"""Of a square of the grid, sides of the parts that regions are made of."""
_STRIDE = 8
"""Of the places, every so manyth shows roughly how high the likelihood is."""
_TABLE_STEP_DB = 0.01
_TABLE_REACH_DB = 60.0
_TRIAL_PLACES = 512
"""Drawn twice to fit the distribution that the others are drawn from."""
_DEGREES = 6.0
"""Of the Student-t that places are drawn from."""
_RECURRENCE = 1.1673039782614187 ** -np.arange(1.0, 5.0)
"""Steps of an additive recurrence that fills four dimensions evenly: powers of 1/x where x⁵ = x + 1."""


@dataclass(frozen=True, slots=True)
class Resolution:
    """How fine the sums are. Twice as fine moves the RMSE by less than 1 % where all links are obstructed.
    With a line of sight draws may miss a place in the first half minute: see docs/decisions.md."""

    cell_m: float = 4.0
    """Width of the grid's squares (all links obstructed)."""
    heights: int = 3
    """Gauss–Legendre nodes over the height."""
    exponents: int = 16
    """Gauss–Legendre nodes over β_NLOS."""
    powers: int = 6
    """Gauss–Legendre nodes over P_t."""
    places: int = 2048
    """Places drawn a time (a line of sight)."""


class ExactFilter:
    """The exact filter of one run, of somebody who stands still."""

    def __init__(self, run: Run, world: World, ticks: Any, resolution: Resolution) -> None:
        self._run, self._world, self._ticks, self._resolution = run, world, np.asarray(ticks), resolution
        self._beta, self._beta_log = _legendre(resolution.exponents, *world.nlos_exponent)
        self._power, power_log = _legendre(resolution.powers, *world.power_dbm)
        self._power_mass = np.exp(power_log)
        self._whitening = [self._whitened(k) for k in range(run.rss_dbm.shape[1])]

    def _whitened(self, vehicle: int) -> FloatArray:
        place = self._run.position_enu_m[:, vehicle]
        gap = np.linalg.norm(place[:, None] - place[None], axis=-1)
        covariance = self._world.shadowing_db**2 * np.exp(-gap / self._world.correlation_m)
        # The same place twice would be singular.
        covariance[np.diag_indices_from(covariance)] += 1e-6
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)

    def log_likelihood(self, places_enu_m: FloatArray, ticks: Any) -> FloatArray:
        """(R, C) log likelihood of places (C, 3) given the windows up to and with each of ``ticks`` (R,)."""
        result = self._power_log_likelihood(places_enu_m, ticks)
        for vehicle, seen in enumerate(self._world.line_of_sight):
            if seen:
                result += self._angle_log_likelihood(vehicle, places_enu_m, ticks)
        return result

    def _power_log_likelihood(self, places: FloatArray, ticks: Any) -> FloatArray:
        last = int(max(ticks)) + 1
        terms = []
        for vehicle, whitening in enumerate(self._whitening):
            lower = whitening[:last, :last]
            apart = cdist(self._run.position_enu_m[:last, vehicle], places, "sqeuclidean")
            h = lower @ (_DB_OF_SQUARE * np.log(np.maximum(apart, _FLOOR_M**2)))
            z, g = lower @ self._run.rss_dbm[:last, vehicle], lower.sum(axis=1)
            terms.append(_Sums.of(z, g, h, ticks))
        return np.stack([self._summed(terms, row) for row in range(len(ticks))])

    def _summed(self, terms: list[_Sums], row: int) -> FloatArray:
        """(C,) with exponent, power and biases summed out; what is negligible is left out early."""
        world = self._world
        links = [
            _Reduced.of(sums, row, world.los_exponent if seen else None)
            for sums, seen in zip(terms, world.line_of_sight, strict=True)
        ]
        count = links[0].q0.size
        score = np.full(count, -np.inf)
        # The best exponent at each place, whatever power and biases it asks for: never too low.
        q0, q1, q2 = (sum(getattr(link, name) for link in links) for name in ("q0", "q1", "q2"))
        best = np.clip(-q1 / np.maximum(q2, 1e-9), *world.nlos_exponent)
        highest = -0.5 * (q0 + 2.0 * best * q1 + best * best * q2)
        some = np.arange(0, count, _STRIDE)
        reached = float(self._bound(links, some).max())
        places = np.flatnonzero(highest > reached - _NEGLIGIBLE)
        bound = self._bound(links, places)
        node, column = np.nonzero(bound > bound.max() - _NEGLIGIBLE)
        column = places[column]
        beta = self._beta[node]
        plain = self._beta_log[node].copy()
        factor = np.ones((self._power.size, node.size))
        for link, seen in zip(links, world.line_of_sight, strict=True):
            m, q = link.at(beta, column)
            plain -= 0.5 * q
            apart = self._power[:, None] - m
            if seen:
                factor *= np.exp(-0.5 * link.precision * apart * apart)
            else:
                factor *= _within(apart, link.precision, world.bias_max_db)
        with np.errstate(divide="ignore"):
            log_total = plain + np.log(self._power_mass @ factor)
        top = float(log_total.max())
        summed = np.bincount(column, weights=np.exp(log_total - top), minlength=count)
        possible = summed > 0.0
        score[possible] = top + np.log(summed[possible])
        return score

    def _bound(self, links: list[_Reduced], places: Any) -> FloatArray:
        """(B, n) log likelihood at most: each vehicle with the best power and bias that there are."""
        world = self._world
        low, high = world.power_dbm[0] - world.bias_max_db, world.power_dbm[1]
        bound = np.repeat(self._beta_log[:, None], len(places), axis=1)
        for link in links:
            m, q = link.at(self._beta[:, None], places)
            away = np.maximum(np.maximum(low - m, m - high), 0.0)
            bound -= 0.5 * (q + link.precision * away * away)
        return bound

    def _angle_log_likelihood(self, vehicle: int, places: FloatArray, ticks: Any) -> FloatArray:
        """Independent Gaussian errors of each window and one constant error, integrated out."""
        last = int(max(ticks)) + 1
        run, world = self._run, self._world
        east, north, up = np.moveaxis(places[None] - run.position_enu_m[:last, None, vehicle], -1, 0)
        turn = run.azimuth_rad[:last, None, vehicle] - np.arctan2(north, east)
        turn = np.remainder(turn + math.pi, 2.0 * math.pi) - math.pi
        lift = run.elevation_rad[:last, None, vehicle] - np.arctan2(up, np.hypot(east, north))
        white, constant = world.angle_white_rad**2, world.angle_constant_rad**2
        number = np.asarray(ticks)[:, None] + 1.0
        shrink = constant / (white + number * constant)
        result = np.zeros((len(ticks), places.shape[0]))
        for error in (turn, lift):
            total = np.cumsum(error, axis=0)[ticks]
            square = np.cumsum(error * error, axis=0)[ticks]
            result -= 0.5 * (square - shrink * total * total) / white
        return result

    def answers(self) -> Answers:
        """Posterior means and regions at the ticks."""
        began = time.thread_time()
        places = self._on_grid() if not any(self._world.line_of_sight) else self._on_points()
        count = self._ticks.size
        return Answers(
            *places, np.full((count, len(SHARES)), math.nan), np.full(count, math.nan),
            time.thread_time() - began,
        )  # fmt: skip

    def _on_grid(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        cell, area = self._resolution.cell_m, self._run.area
        half = math.ceil(area.radius_m / cell)
        fine = (np.arange(2 * half * _FINER) + 0.5) * (cell / _FINER) - half * cell
        within = np.hypot(fine[:, None], fine) <= area.radius_m
        # Of a square on the area's edge only a part counts.
        share = within.reshape(2 * half, _FINER, 2 * half, _FINER).mean(axis=(1, 3))
        steps = (np.arange(2 * half) - half + 0.5) * cell
        east, north = np.meshgrid(steps, steps, indexing="ij")
        inside = share > 0.0
        height, height_log = _legendre(self._resolution.heights, area.height_min_m, area.height_max_m)
        columns = np.stack([east[inside], north[inside]], axis=-1)
        places = np.concatenate([np.column_stack([columns, np.full(len(columns), z)]) for z in height])
        prior = np.repeat(height_log, len(columns)) + np.tile(np.log(share[inside]), height.size)
        score = self.log_likelihood(places, self._ticks) + prior
        mass = np.exp(score - score.max(axis=1, keepdims=True))
        mass /= mass.sum(axis=1, keepdims=True)
        means = mass @ places
        level, areas = np.empty(len(mass)), np.empty((len(mass), len(SHARES)))
        where = np.floor(self._run.truth_enu_m[0, :2] / (cell / _FINER)).astype(int) + half * _FINER
        for row, flat in enumerate(mass):
            raster = np.zeros(inside.shape)
            raster[inside] = flat.reshape(height.size, -1).sum(axis=0) / share[inside]
            # Between the squares' centres the density is smooth.
            smooth = zoom(raster, _FINER, order=1, grid_mode=True, mode="nearest") * within
            part_m2 = (cell / _FINER) ** 2
            level[row], areas[row] = level_and_areas(smooth, part_m2, int(where[0]), int(where[1]))
        return means, level, areas

    def _on_points(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        rows = self._ticks.size
        means, level, areas = np.empty((rows, 3)), np.empty(rows), np.empty((rows, len(SHARES)))
        for row, tick in enumerate(self._ticks):
            mean, covariance = self._first_guess(int(tick))
            for count in (_TRIAL_PLACES, _TRIAL_PLACES, self._resolution.places):
                place, weight = self._weighted(int(tick), mean, covariance, count)
                mean = weight @ place
                offset = place - mean
                covariance = (offset.T * weight) @ offset + 1e-6 * np.eye(3)
            means[row] = mean
            level[row], areas[row] = points_region(place[:, :2], weight, self._run.truth_enu_m[0, :2])
        return means, level, areas

    def _weighted(
        self, tick: int, mean: FloatArray, covariance: FloatArray, count: int
    ) -> tuple[FloatArray, FloatArray]:
        area = self._run.area
        even = np.mod(0.5 + np.arange(1, count + 1)[:, None] * _RECURRENCE, 1.0)
        # A Student-t: a normal over the root of a gamma variable.
        spread = np.sqrt(0.5 * _DEGREES / _gamma_quantile(even[:, 3], 0.5 * _DEGREES))
        normal = ndtri(even[:, :3]) * spread[:, None]
        place = mean + 1.2 * normal @ np.linalg.cholesky(covariance).T
        inside = (np.hypot(place[:, 0], place[:, 1]) <= area.radius_m) & (
            (place[:, 2] >= area.height_min_m) & (place[:, 2] <= area.height_max_m)
        )
        place, normal = place[inside], normal[inside]
        proposal = -0.5 * (_DEGREES + 3.0) * np.log1p(np.square(normal).sum(axis=1) / _DEGREES)
        score = self.log_likelihood(place, np.array([tick]))[0] - proposal
        weight = np.exp(score - score.max())
        return place, weight / weight.sum()

    def _first_guess(self, tick: int) -> tuple[FloatArray, FloatArray]:
        """Gauss–Newton on the angles in line of sight, the prior's moments beside them."""
        run, world, area = self._run, self._world, self._run.area
        prior_mean = np.array([0.0, 0.0, 0.5 * (area.height_min_m + area.height_max_m)])
        height_std = (area.height_max_m - area.height_min_m) / math.sqrt(12.0)
        prior = np.diag([0.25 * area.radius_m**2, 0.25 * area.radius_m**2, height_std**2])
        x = prior_mean.copy()
        number = tick + 1
        both = np.eye(number) / world.angle_white_rad**2
        both -= (
            world.angle_constant_rad**2
            / world.angle_white_rad**2
            / (world.angle_white_rad**2 + number * world.angle_constant_rad**2)
        )
        for _ in range(12):
            precision = np.linalg.inv(prior)
            right = precision @ (prior_mean - x)
            for vehicle in np.flatnonzero(world.line_of_sight):
                east, north, up = (x - run.position_enu_m[:number, vehicle]).T
                flat2 = np.maximum(east**2 + north**2, 1.0)
                flat, all2 = np.sqrt(flat2), flat2 + up**2
                turn = run.azimuth_rad[:number, vehicle] - np.arctan2(north, east)
                turn = np.remainder(turn + math.pi, 2.0 * math.pi) - math.pi
                lift = run.elevation_rad[:number, vehicle] - np.arctan2(up, flat)
                across = np.stack([-north / flat2, east / flat2, np.zeros(number)], axis=-1)
                rise = np.stack(
                    [-east * up / (flat * all2), -north * up / (flat * all2), flat / all2], axis=-1
                )
                for slope, error in ((across, turn), (rise, lift)):
                    precision = precision + slope.T @ both @ slope
                    right = right + slope.T @ both @ error
            covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
            x = x + covariance @ right
            x[:2] *= min(1.0, area.radius_m / max(float(np.hypot(x[0], x[1])), 1e-9))
            x[2] = min(max(x[2], area.height_min_m), area.height_max_m)
        return x, covariance


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Running sums of one vehicle's whitened rows up to each of R ticks."""

    zz: FloatArray
    zg: FloatArray
    gg: FloatArray
    zh: FloatArray
    gh: FloatArray
    hh: FloatArray

    @classmethod
    def of(cls, z: FloatArray, g: FloatArray, h: FloatArray, ticks: Any) -> _Sums:
        edges = np.concatenate([[0], np.asarray(ticks) + 1])
        parts = [slice(first, end) for first, end in pairwise(edges)]

        def running(values: list[Any]) -> FloatArray:
            return np.cumsum(np.array(values), axis=0)

        return cls(
            running([z[s] @ z[s] for s in parts]),
            running([z[s] @ g[s] for s in parts]),
            running([g[s] @ g[s] for s in parts]),
            running([z[s] @ h[s] for s in parts]),
            running([g[s] @ h[s] for s in parts]),
            running([np.einsum("tc,tc->c", h[s], h[s]) for s in parts]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Reduced:
    """One vehicle's Gaussian in c = P_t − b at one time: m = m0 + β m1, q = q0 + 2 β q1 + β² q2, all (C,)."""

    precision: float
    m0: FloatArray
    m1: FloatArray
    q0: FloatArray
    q1: FloatArray
    q2: FloatArray

    @classmethod
    def of(cls, sums: _Sums, row: int, exponent: float | None) -> _Reduced:
        """``exponent``: the link's own, where it is known; None: it is β."""
        a = float(sums.gg[row])
        m0, m1 = np.full(sums.gh.shape[1], sums.zg[row] / a), sums.gh[row] / a
        q0 = np.full(m1.size, sums.zz[row] - a * m0[0] ** 2)
        q1, q2 = sums.zh[row] - a * m0 * m1, sums.hh[row] - a * m1 * m1
        if exponent is None:
            return cls(a, m0, m1, q0, q1, q2)
        none = np.zeros_like(m1)
        whole = q0 + 2.0 * exponent * q1 + exponent**2 * q2
        return cls(a, m0 + exponent * m1, none, whole, none, none)

    def at(self, beta: FloatArray, places: Any) -> tuple[FloatArray, FloatArray]:
        """m and q."""
        m = self.m0[places] + beta * self.m1[places]
        return m, self.q0[places] + beta * (2.0 * self.q1[places] + beta * self.q2[places])


def _within(apart_db: FloatArray, precision: float, bias_max_db: float) -> FloatArray:
    """P(m + noise in [P_t − b_max, P_t]) for P_t − m = ``apart_db``: from a table, as there are millions."""
    grid = np.arange(-_TABLE_REACH_DB, _TABLE_REACH_DB, _TABLE_STEP_DB)
    root = math.sqrt(precision)
    # Of two tails the small one is exact: Φ(a) − Φ(b) = Φ(−b) − Φ(−a).
    table = np.where(
        grid > 0.5 * bias_max_db,
        ndtr(root * (bias_max_db - grid)) - ndtr(-root * grid),
        ndtr(root * grid) - ndtr(root * (grid - bias_max_db)),
    )
    index = (apart_db + (_TABLE_REACH_DB + 0.5 * _TABLE_STEP_DB)) * (1.0 / _TABLE_STEP_DB)
    np.clip(index, 0.0, table.size - 1.0, out=index)
    result: FloatArray = table[index.astype(np.int32)]
    return result


def _legendre(nodes: int, low: float, high: float) -> tuple[FloatArray, FloatArray]:
    """Nodes over an interval and the logs of their weights, which sum to one."""
    place, weight = np.polynomial.legendre.leggauss(nodes)
    return 0.5 * (low + high) + 0.5 * (high - low) * place, np.log(0.5 * weight)


def _gamma_quantile(share: FloatArray, shape: float) -> FloatArray:
    return np.asarray(gammaincinv(shape, share), dtype=np.float64)
