"""``posterior``: the snapshot's posterior mean, everything unknown marginalised.

Exists because in NLOS no point criterion beats the posterior mean, and because LOS, mixed
and NLOS are one model once the labels are soft. Rule: its likelihood is the tracker's; this
is the tracker's first update, one observation a link.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from groundstation.localization.batch import Answers, Batch
from groundstation.localization.likelihood import ExponentGrid
from groundstation.localization.link_states import LinkStates, doubtful_links
from groundstation.localization.mesh import IntArray, Mesh, MeshSettings, masses, refine, smooth_moments
from groundstation.localization.problem import BoolArray, FloatArray, Links, SearchArea, SignalModel

SNAPSHOT_MESH = MeshSettings(
    base_cells=10, maximum_cells=1600, split_mass=0.03, minimum_half_m=0.05, maximum_rounds=6, pieces=3
)
_CHUNK = 32
_URGENCY = 5.0
"""A box wider than a ray through it is split at a fifth of the usual mass."""
_NEGLIGIBLE = 1e-4
"""Combinations of link states with less of the belief than this are left out once that is seen."""
_FEW_COMBINATIONS = 2
_NO_OUTLIER = 3e-3
"""The same of those with an outlier: a share that its prior alone would give it, and a little more."""
_NEARLY_ALL = 0.99
_GAUSS_POINTS = np.array(list(product((-1.0, 1.0), repeat=3))) / math.sqrt(3.0)
_NODE_SPACING = 1.4
_MAXIMUM_NODES = 40
_DIFFERENCES_DB = 3.0
"""By how much 10 log₁₀ of the distances to a place differ from vehicle to vehicle."""


@dataclass(frozen=True, slots=True, eq=False)
class PosteriorAnswer:
    """The belief of one snapshot."""

    position_enu_m: FloatArray
    """(3,) posterior mean, metres."""
    covariance_m2: FloatArray
    """(3, 3) m²."""
    transmit_power_dbm: float
    """Posterior mean at the most likely place."""
    path_loss_exponent: FloatArray
    """(K,) posterior mean of each link's exponent at the most likely place."""
    los_probability: FloatArray
    """(K,) posterior P(line of sight) of each link at the most likely place."""
    mesh: Mesh
    """Where it was evaluated."""
    log_likelihood: FloatArray
    """(C,) of each box, up to a constant: the log of the belief's density."""
    mass: FloatArray
    """(C,) belief in each box."""
    states: LinkStates
    """The likelihood itself, for any place."""
    area: SearchArea
    """Where the target may be."""

    def log_likelihood_at(self, points_enu_m: FloatArray) -> FloatArray:
        """(n,) at places (n, 3), up to the same constant as ``log_likelihood``."""
        points = np.asarray(points_enu_m, dtype=np.float64).reshape(-1, 3)
        whose = np.zeros(points.shape[0], dtype=np.int64)
        return self.states.log_likelihood(whose, points, np.zeros((points.shape[0], 2)))[0]

    def credible_level(self, points_enu_m: FloatArray) -> FloatArray:
        """(n,) belief in all places denser than each of (n, 3): the truth is in the 90 % highest-density
        region exactly where this is 0.9 or less. 1 outside the area."""
        points = np.asarray(points_enu_m, dtype=np.float64).reshape(-1, 3)
        density, share = self._densities()
        order = np.argsort(density, kind="stable")
        below = np.concatenate([[0.0], np.cumsum(share[order])])
        rank = np.searchsorted(density[order], self.log_likelihood_at(points))
        inside = self.area.contains(points[:, 0], points[:, 1])
        height = np.clip(points[:, 2], *self.area.height_limits_m(points[:, 0], points[:, 1]))
        inside &= np.abs(points[:, 2] - height) < 1e-6
        return np.where(inside, np.clip(1.0 - below[rank] / below[-1], 0.0, 1.0), 1.0)

    def _densities(self) -> tuple[FloatArray, FloatArray]:
        """Log density and belief (G,) at Gauss points of the boxes: a ray's density varies inside one."""
        order = np.argsort(-self.mass, kind="stable")
        used = order[: int(np.searchsorted(np.cumsum(self.mass[order]), _NEARLY_ALL)) + 1]
        offset = (_GAUSS_POINTS[:, None] * self.mesh.half_m[used][:, [0, 0, 1]]).reshape(-1, 3)
        density = self.log_likelihood_at(np.tile(self.mesh.center_enu_m[used], (8, 1)) + offset)
        share = np.exp(density - density.max()) * np.tile(np.exp(self.mesh.log_volume[used]), 8)
        rest = np.delete(np.arange(self.mass.size), used)
        share *= self.mass[used].sum() / share.sum()
        return (
            np.concatenate([density, self.log_likelihood[rest]]),
            np.concatenate([share, self.mass[rest]]),
        )


def posterior(links: Links, area: SearchArea, model: SignalModel) -> PosteriorAnswer:
    """Posterior over position given one snapshot of K ≥ 1 links; prior uniform over the area."""
    return beliefs(Batch.of(links.as_batch(), area, model))[0]


def spread_about(belief: PosteriorAnswer, position_enu_m: FloatArray) -> FloatArray:
    """Mean squared error of answering ``position_enu_m`` under the belief, (3, 3) m²."""
    shift = belief.position_enu_m - position_enu_m
    result: FloatArray = belief.covariance_m2 + np.outer(shift, shift)
    return result


def posterior_batch(batch: Batch) -> Answers:
    """``posterior`` of each problem."""
    found = beliefs(batch)
    return Answers(
        np.array([belief.position_enu_m for belief in found]),
        np.array([belief.transmit_power_dbm for belief in found]),
        np.array([belief.path_loss_exponent for belief in found]),
        np.ones(batch.size, dtype=np.int64),
        ["ok"] * batch.size,
        np.array([belief.covariance_m2 for belief in found]),
        list(found),
    )


def beliefs(batch: Batch) -> list[PosteriorAnswer]:
    """The belief of each problem; it does not depend on the others."""
    doubtful, nodes = doubtful_links(batch.links), _nodes(batch)
    if batch.size == 1:
        return _alike(batch, doubtful[0], int(nodes[0]))
    kinds, which = np.unique(np.column_stack([doubtful, nodes]), axis=0, return_inverse=True)
    found: list[PosteriorAnswer | None] = [None] * batch.size
    for number, kind in enumerate(kinds):
        rows = np.flatnonzero(which.ravel() == number)
        pattern = kind[:-1] > 0
        # With many combinations of link states each problem drops others: one at a time.
        size = _CHUNK if 2 ** pattern.sum() <= _FEW_COMBINATIONS else 1
        for first in range(0, rows.size, size):
            chunk = rows[first : first + size]
            for row, belief in zip(chunk, _alike(batch.rows(chunk), pattern, int(kind[-1])), strict=True):
                found[row] = belief
    return [belief for belief in found if belief is not None]


def _nodes(batch: Batch) -> IntArray:
    """(N,) nodes of β_NLOS: close enough for how well K links tell it, through P_t's prior and each other.

    The midpoint rule on a Gaussian of σ errs by under 10⁻⁴ up to steps of 1.4 σ.
    """
    model, links = batch.model, batch.links.count
    reach = np.abs(batch.place[..., :2] - batch.area.center_enu_m[:2]).max(axis=(1, 2)) + batch.area.radius_m
    variance = model.nlos_rss_std_db**2 + model.receiver_offset_std_db**2 + model.nlos_bias_max_db**2 / 12.0
    common = np.square(10.0 * np.log10(np.maximum(reach, 10.0)))
    common /= 1.0 + links * model.transmit_power_std_db**2 / variance
    std = np.sqrt(variance / (links * (common + _DIFFERENCES_DB**2)))
    span = model.nlos_exponent_max - model.nlos_exponent_min
    nodes = np.clip(np.ceil(span / (_NODE_SPACING * std)), 3, _MAXIMUM_NODES)
    nodes[(batch.links.los_probability == 1.0).all(axis=1)] = 1
    result: IntArray = nodes.astype(np.int64)
    return result


def _alike(batch: Batch, doubtful: BoolArray, nodes: int) -> list[PosteriorAnswer]:
    """Problems whose doubtful links are the same, side by side."""
    exponents = ExponentGrid.of(batch.model, nodes)
    states = LinkStates.of(batch.links, batch.model, batch.bias_max_db, doubtful, exponents)
    pruned = states.combinations <= _FEW_COMBINATIONS
    # An outlier is kept in mind where the powers speak for one; at its prior it only costs time.
    least = np.where(states.strange, _NO_OUTLIER, _NEGLIGIBLE)[:, None]

    def evaluate(mesh: Mesh, problem: IntArray) -> tuple[FloatArray, FloatArray]:
        nonlocal states, pruned
        if pruned:
            log_likelihood, coarse = states.log_likelihood(problem, mesh.center_enu_m, mesh.half_m)
            return log_likelihood, np.where(coarse, _URGENCY, 1.0)
        # The base mesh shows which combinations of link states are out of the question.
        parts, coarse = states.by_combination(problem, mesh.center_enu_m, mesh.half_m)
        top = parts.max(axis=0)
        parts = np.exp(parts - top)
        total = parts.sum(axis=0)
        log_likelihood = top + np.log(total)
        belief = parts / total * masses(log_likelihood, mesh, problem)
        share = np.stack([np.bincount(problem, row, batch.size) for row in belief])
        states, pruned = states.only(share > least), True
        return log_likelihood, np.where(coarse, _URGENCY, 1.0)

    found = refine(batch.area, evaluate, SNAPSHOT_MESH, batch.size)
    mass = masses(found.log_likelihood, found.mesh, found.problem)
    ends = np.searchsorted(found.problem, np.arange(batch.size + 1)).tolist()
    best = np.array(
        [first + int(np.argmax(found.log_likelihood[first:last])) for first, last in pairwise(ends)]
    )
    power, exponent, los = states.nuisances(np.arange(batch.size), found.mesh.center_enu_m[best])
    result = []
    for row, (first, last) in enumerate(pairwise(ends)):
        mine = slice(first, last)
        mesh = Mesh(found.mesh.center_enu_m[mine], found.mesh.half_m[mine], found.mesh.log_volume[mine])
        mean, covariance = smooth_moments(mesh, mass[mine], batch.area)
        result.append(
            PosteriorAnswer(
                mean, covariance, float(power[row]), exponent[row], los[row], mesh,
                found.log_likelihood[mine], mass[mine], states.problem(row), batch.area,
            )
        )  # fmt: skip
    return result
