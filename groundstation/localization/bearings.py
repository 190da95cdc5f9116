"""Bearings along flights: each vehicle's constant error learned at every candidate, strays let go.

Exists because a compass or a mounting is off by a constant, which shows itself when the geometry
changes and not before: taken as white it makes a flight too sure, taken as nothing to be learned it
wastes the flight. Rule: same model and density as ``likelihood``; with one bearing a vehicle both
give the same number.

At a candidate x a vehicle's constant error c ~ N(0, σ_c²) is the only unknown that its genuine
bearings share, so p(bearings | x) follows by the chain rule from the running mean and variance of c
at x (a scalar Kalman filter per angle, vehicle and candidate). Whether a bearing is genuine (line of
sight, no stray) is not known: its density is the mixture, and the filter takes it in with its
posterior probability (probabilistic data association: Bar-Shalom & Tse, Automatica 11, 1975). What
is no longer exact then is only that the mixture of Gaussians over c is taken for one.

A bearing that is wrong once (a reflection) is wrong again a few metres on: bearings from near by
share whether they are genuine. The claim of each, how much it can raise a candidate over one that
no bearing speaks for, is therefore tempered by ``Observations.angle_weight``; its shape near the ray is not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from groundstation.localization.likelihood import (
    ANYWHERE,
    angle_variance,
    residual_along,
    stray_share,
    widened_variance,
)
from groundstation.localization.mesh import Mesh
from groundstation.localization.problem import FloatArray, SignalModel
from groundstation.localization.whitening import Observations

_REACH2 = 60.0
"""A bearing is followed out to √60 standard deviations, e⁻³⁰."""
_PAIRS = 100_000
"""Rows × candidates whose geometry is worked out at once: more does not stay in the processor's cache."""
_SINGLE = np.float32
"""Of angles and densities: 10⁻⁷ rad beside errors of a degree. Their logarithms add up in double."""
_LEAST_CLAIM = 3.0
"""However alike, a bearing with news in it can raise a candidate by e³."""


@dataclass(slots=True, eq=False)
class Bearings:
    """Belief over each vehicle's constant error at C candidates."""

    mean: Any
    """(2, V, C) of azimuth and elevation, radians."""
    variance: Any
    """(2, V, C) rad². Both in single precision."""

    @classmethod
    def empty(cls, candidates: int, links: int, model: SignalModel) -> Bearings:
        """Nothing heard at ``candidates`` places from ``links`` vehicles."""
        shape = (2, links, candidates)
        return cls(np.zeros(shape, _SINGLE), np.full(shape, model.angle_bias_std_rad**2, _SINGLE))

    @classmethod
    def gathered(cls, parts: list[Bearings], place: Any) -> Bearings:
        """Of candidates of several parts: ``place`` (C,) counts through them."""
        return cls(
            np.concatenate([part.mean for part in parts], axis=-1).take(place, axis=-1),
            np.concatenate([part.variance for part in parts], axis=-1).take(place, axis=-1),
        )

    def grow(self, links: int, model: SignalModel) -> None:
        """Make room for vehicles not heard before."""
        more = links - self.mean.shape[1]
        if more > 0:
            fresh = Bearings.empty(self.mean.shape[2], more, model)
            self.mean = np.concatenate([self.mean, fresh.mean], axis=1)
            self.variance = np.concatenate([self.variance, fresh.variance], axis=1)

    def add(
        self, observations: Observations, first: int, mesh: Mesh, model: SignalModel, log: FloatArray
    ) -> None:
        """Take in the bearings of rows from ``first`` on; ``log`` (N, C), per node of π, grows in place.

        A box's extent adds to the bearings' variance where it is wider than the ray.
        """
        rows = np.arange(first, observations.count)
        rows = rows[
            np.isfinite(observations.azimuth_rad[rows])
            & np.isfinite(observations.elevation_rad[rows])
            & (observations.angle_probability[rows] > 0.0)
        ]
        if not rows.size:
            return
        # In rounds that hold no vehicle twice: the rows of a round do not touch each other's errors.
        turn = _turns(observations.link[rows])
        order = np.argsort(turn, kind="stable")
        rows, rounds = rows[order], np.bincount(turn).tolist()
        at_once = max(_PAIRS // max(mesh.count, 1), 1)
        while rounds:
            # What does not depend on the order is worked out for several rounds together.
            count = 1
            while count < len(rounds) and sum(rounds[: count + 1]) <= at_once:
                count += 1
            ends = np.cumsum([0, *rounds[:count]])
            self._take(observations, rows[: ends[-1]], ends.tolist(), mesh, model, log)
            rows, rounds = rows[ends[-1] :], rounds[count:]

    def _take(
        self,
        observations: Observations,
        rows: Any,
        ends: list[int],
        mesh: Mesh,
        model: SignalModel,
        log: FloatArray,
    ) -> None:
        p = observations.angle_probability[rows]
        white = observations.angle_std_rad[rows].T ** 2
        constant = model.angle_bias_std_rad**2
        # Odds of a genuine bearing, and what others are worth, at each node of π: (N, r).
        share = np.array(model.los_shares)[:, None]
        right = 2.0 * p * share
        trusted = right * (1.0 - stray_share(model))
        stray = (right - trusted + 2.0 * (1.0 - p) * (1.0 - share)) * ANYWHERE
        fresh = observations.angle_weight[rows]
        strays = fresh * np.log(stray)
        peak = 1.0 / (2.0 * math.pi * np.sqrt((white + constant).prod(axis=0)))
        claim = np.log1p(trusted * peak / stray)
        news = np.minimum(model_white(model) / white.prod(axis=0), 1.0)
        tempered = np.minimum(claim, np.maximum(fresh * claim, _LEAST_CLAIM * news))
        odds = trusted / (stray * np.exp(claim - tempered))

        link, cells = observations.link[rows], mesh.count
        # From a middle: differences are what single precision has to hold.
        place = observations.position_enu_m[rows]
        middle = place.mean(axis=0)
        here, there = (place - middle).astype(_SINGLE), (mesh.center_enu_m - middle).astype(_SINGLE).T.copy()
        spread_m2 = (mesh.half_m.T**2 / 3.0).astype(_SINGLE)
        azimuth = observations.azimuth_rad[rows].astype(_SINGLE)
        wide = (white[0] + constant).astype(_SINGLE)
        of_vehicle = observations.place_variance_m2[rows].T.astype(_SINGLE)
        near, along, across = _near_the_rays(here, azimuth, wide, there, spread_m2[0], of_vehicle[0])
        pair = np.flatnonzero(near)
        number = pair // max(cells, 1)
        cell = pair - number * cells
        up = there[2].take(cell) - here[:, 2].take(number)
        residual, per_m2 = residual_along(
            (along.take(pair), across.take(pair), up),
            observations.elevation_rad[rows].astype(_SINGLE).take(number),
        )
        of_box = angle_variance(per_m2, tuple(spread_m2.take(cell, axis=1)))
        white, odds = white.astype(_SINGLE).take(number, axis=1), odds.astype(_SINGLE)
        if of_vehicle.any():
            white += angle_variance(per_m2, tuple(of_vehicle.take(number, axis=1)))
        at = (link * cells).take(number) + cell
        mean, variance = self.mean.reshape(2, -1), self.variance.reshape(2, -1)
        starts = np.searchsorted(number, ends).tolist()
        for turn, (first, last) in enumerate(pairwise(ends)):
            log += strays[:, first:last].sum(axis=1)[:, None]
            pairs = slice(starts[turn], starts[turn + 1])
            if pairs.start == pairs.stop:
                continue
            place = at[pairs]
            error, doubt = mean.take(place, axis=1), variance.take(place, axis=1)
            total = widened_variance(white[:, pairs] + doubt, of_box[:, pairs])
            off = residual[:, pairs] - error
            square = off * off
            square /= total
            density = np.exp(-0.5 * (square[0] + square[1]))
            density /= np.sqrt(total[0] * total[1])
            density *= 1.0 / (2.0 * math.pi)
            genuine = _told(log, odds[:, first:last], density, number[pairs] - first, cell[pairs])
            step = np.divide(doubt, total, out=total)
            off *= step
            error += genuine * off
            off *= off
            off *= genuine * (1.0 - genuine)
            step *= genuine
            doubt -= np.multiply(step, doubt, out=step)
            doubt += off
            for angle in range(2):
                # One axis at a time: assigning to both at once takes five times as long.
                mean[angle][place] = error[angle]
                variance[angle][place] = doubt[angle]

    def state(self) -> dict[str, Any]:
        """As arrays."""
        return {"bias_mean": self.mean.copy(), "bias_variance": self.variance.copy()}

    @classmethod
    def restore(cls, tree: dict[str, Any]) -> Bearings:
        """The reverse."""
        return cls(np.array(tree["bias_mean"], dtype=_SINGLE), np.array(tree["bias_variance"], dtype=_SINGLE))


def model_white(model: SignalModel) -> float:
    """Product of the white variances of azimuth and elevation, rad⁴."""
    return (model.azimuth_std_rad * model.elevation_std_rad) ** 2


def _turns(link: Any) -> Any:
    """(r,) how many rows of the same vehicle come before each."""
    order = np.argsort(link, kind="stable")
    of = link[order]
    turn = np.empty(link.size, dtype=np.int64)
    turn[order] = np.arange(link.size) - np.searchsorted(of, of)
    return turn


def _told(log: FloatArray, odds: Any, density: Any, number: Any, cell: Any) -> Any:
    """Take a round's bearings into ``log`` (N, C) and give the probability that each pair's is genuine.

    Pairs of a row ``number`` and a ``cell``: ``density`` of the bearing, per rad²; ``odds`` (N, r).
    """
    # Under what was believed of π at each candidate before: weight (N, C).
    weight = np.exp(log - log.max(axis=0))
    weight /= weight.sum(axis=0)
    ratio = (odds.T @ weight.astype(_SINGLE)).take(number * log.shape[1] + cell)
    ratio *= density
    for node, factor in enumerate(odds):
        log[node] += np.bincount(cell, np.log(1.0 + factor.take(number) * density), log.shape[1])
    ratio /= 1.0 + ratio
    return ratio


def _near_the_rays(
    place: Any, azimuth_rad: Any, variance: Any, center: Any, spread_m2: Any, of_place_m2: Any
) -> tuple[Any, Any, Any]:
    """Where a bearing's density is not nothing (most cells are far off a narrow ray); (r, C) bool.

    Cells: ``center`` (3, C), and ``spread_m2`` (C,), the variance of a place in each on an axis;
    ``of_place_m2`` (r,) the same of each place. And the horizontal way from each place to each cell, along
    the bearing and across it; (r, C) metres.
    """
    east, north = np.cos(azimuth_rad)[:, None], np.sin(azimuth_rad)[:, None]
    x = center[0] - place[:, 0, None]
    y = center[1] - place[:, 1, None]
    across = y * east
    across -= x * north
    along = x
    along *= east
    y *= north
    along += y
    across2 = np.multiply(across, across, out=y)
    horizontal2 = along * along
    horizontal2 += across2
    np.maximum(horizontal2, 0.01, out=horizontal2)
    spread = variance[:, None] * horizontal2
    spread += spread_m2
    spread += of_place_m2[:, None]
    # Behind the vehicle the turn is over 90°: nothing, unless the spread is wide.
    horizontal2 *= 0.03
    near = spread > horizontal2
    near |= along > 0.0
    spread *= _REACH2
    near &= across2 < spread
    return near, along, across


def angle_log_likelihood(
    observations: Observations, first: int, candidates: FloatArray, half_m: FloatArray, model: SignalModel
) -> FloatArray:
    """(N, C) of the bearings of rows from ``first`` on alone, for each of ``model.los_shares``."""
    log = np.zeros((len(model.los_shares), candidates.shape[0]))
    links = int(observations.link.max(initial=-1)) + 1
    mesh = Mesh(candidates, half_m, np.zeros(candidates.shape[0]))
    Bearings.empty(candidates.shape[0], links, model).add(observations, first, mesh, model, log)
    return log
