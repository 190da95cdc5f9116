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
from typing import Any

import numpy as np

from groundstation.localization.likelihood import (
    ANYWHERE,
    bearing_residual,
    stray_share,
    widened_variance,
)
from groundstation.localization.mesh import Mesh
from groundstation.localization.problem import FloatArray, SignalModel
from groundstation.localization.whitening import Observations

_REACH2 = 60.0
"""A bearing is followed out to √60 standard deviations, e⁻³⁰."""
_FACTORS = 32
_LEAST_CLAIM = 3.0
"""However alike, a bearing with news in it can raise a candidate by e³."""


@dataclass(slots=True, eq=False)
class Bearings:
    """Belief over each vehicle's constant error at C candidates."""

    mean: FloatArray
    """(2, V, C) of azimuth and elevation, radians."""
    variance: FloatArray
    """(2, V, C) rad²."""

    @classmethod
    def empty(cls, candidates: int, links: int, model: SignalModel) -> Bearings:
        """Nothing heard at ``candidates`` places from ``links`` vehicles."""
        shape = (2, links, candidates)
        return cls(np.zeros(shape), np.full(shape, model.angle_bias_std_rad**2))

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
        seen: dict[int, int] = {}
        rounds: list[list[int]] = []
        for row, link in zip(rows.tolist(), observations.link[rows].tolist(), strict=True):
            turn = seen[link] = seen.get(link, -1) + 1
            if turn == len(rounds):
                rounds.append([])
            rounds[turn].append(row)
        spread_m2 = mesh.half_m**2 / 3.0
        for chosen in rounds:
            # No vehicle twice: the rows of a round do not touch each other's errors.
            self._take(observations, np.array(chosen), mesh, spread_m2, model, log)

    def _take(
        self,
        observations: Observations,
        rows: Any,
        mesh: Mesh,
        spread_m2: FloatArray,
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
        log += (fresh * np.log(stray)).sum(axis=1)[:, None]
        peak = 1.0 / (2.0 * math.pi * np.sqrt((white + constant).prod(axis=0)))
        claim = np.log1p(trusted * peak / stray)
        news = np.minimum(model_white(model) / white.prod(axis=0), 1.0)
        tempered = np.minimum(claim, np.maximum(fresh * claim, _LEAST_CLAIM * news))
        odds = trusted / (stray * np.exp(claim - tempered))

        place = observations.position_enu_m[rows]
        azimuth, elevation = observations.azimuth_rad[rows], observations.elevation_rad[rows]
        number, cell = _near_the_rays(place, azimuth, white[0] + constant, mesh.center_enu_m, spread_m2)
        if not number.size:
            return
        link = observations.link[rows][number]
        cells = log.shape[1]
        center, spread = mesh.center_enu_m.T, spread_m2.T
        offset = center.take(cell, axis=1) - place.T.take(number, axis=1)
        residual, of_box = bearing_residual(
            offset, spread.take(cell, axis=1), (azimuth.take(number), elevation.take(number))
        )
        at = link * cells + cell
        flat_mean, flat_variance = self.mean.reshape(2, -1), self.variance.reshape(2, -1)
        mean, variance = flat_mean.take(at, axis=1), flat_variance.take(at, axis=1)
        total = widened_variance(white.take(number, axis=1) + variance, of_box)
        residual -= mean
        square = residual * residual
        square /= total
        density = np.exp(-0.5 * (square[0] + square[1]))
        density /= np.sqrt(total[0] * total[1])
        density *= 1.0 / (2.0 * math.pi)
        # P(genuine) under what is believed of π at each candidate: weight (N, C), odds (r, C).
        weight = np.exp(log - log.max(axis=0))
        weight /= weight.sum(axis=0)
        ratio = (odds.T @ weight)[number, cell] * density
        genuine = ratio / (1.0 + ratio)
        everywhere = np.zeros((rows.size, cells))
        everywhere[number, cell] = density
        for node, factor in enumerate(odds):
            # One logarithm of a product: e¹² a row at most, 60 rows.
            for first in range(0, rows.size, _FACTORS):
                some = slice(first, first + _FACTORS)
                log[node] += np.log((1.0 + factor[some, None] * everywhere[some]).prod(axis=0))
        step = variance / total
        residual *= step
        flat_mean[:, at] = mean + genuine * residual
        flat_variance[:, at] = (
            variance * (1.0 - genuine * step) + genuine * (1.0 - genuine) * residual * residual
        )

    def state(self) -> dict[str, Any]:
        """As arrays."""
        return {"bias_mean": self.mean.copy(), "bias_variance": self.variance.copy()}

    @classmethod
    def restore(cls, tree: dict[str, Any]) -> Bearings:
        """The reverse."""
        return cls(
            np.array(tree["bias_mean"], dtype=np.float64), np.array(tree["bias_variance"], dtype=np.float64)
        )


def model_white(model: SignalModel) -> float:
    """Product of the white variances of azimuth and elevation, rad⁴."""
    return (model.azimuth_std_rad * model.elevation_std_rad) ** 2


def _near_the_rays(
    place: FloatArray,
    azimuth_rad: FloatArray,
    variance: FloatArray,
    candidates: FloatArray,
    spread_m2: FloatArray,
) -> tuple[Any, Any]:
    """Pairs (row, cell) where a bearing's density is not nothing: most cells are far off a narrow ray."""
    east, north = np.cos(azimuth_rad)[:, None], np.sin(azimuth_rad)[:, None]
    x = candidates[:, 0] - place[:, 0, None]
    y = candidates[:, 1] - place[:, 1, None]
    across = y * east - x * north
    along = x * east + y * north
    across *= across
    horizontal2 = np.maximum(across + along * along, 0.01)
    spread = variance[:, None] * horizontal2 + spread_m2[:, 0]
    # Behind the vehicle the turn is over 90°: nothing, unless the spread is wide.
    ahead = (along > 0.0) | (spread > 0.03 * horizontal2)
    number, cell = np.nonzero((across < _REACH2 * spread) & ahead)
    return number, cell


def angle_log_likelihood(
    observations: Observations, first: int, candidates: FloatArray, half_m: FloatArray, model: SignalModel
) -> FloatArray:
    """(N, C) of the bearings of rows from ``first`` on alone, for each of ``model.los_shares``."""
    log = np.zeros((len(model.los_shares), candidates.shape[0]))
    links = int(observations.link.max(initial=-1)) + 1
    mesh = Mesh(candidates, half_m, np.zeros(candidates.shape[0]))
    Bearings.empty(candidates.shape[0], links, model).add(observations, first, mesh, model, log)
    return log
