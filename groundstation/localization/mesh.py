"""Candidate positions: boxes over the search area, fine where the belief is.

Exists because an area of hundreds of metres and a belief of two metres need one set of
candidates of bounded size. Rule: deterministic – boxes split by the mass they hold, in
order, never at random – and each box knows its volume, so that density and mass agree; over
terrain a box stands on the ground under its own centre.
Many problems in one area are refined side by side, each as if it were alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import shapely
from numpy.typing import NDArray

from groundstation.localization.problem import BoolArray, FloatArray, SearchArea

IntArray = NDArray[np.int64]

_SUBPOINTS = 4
_NEIGHBOURS = 8
_MUCH = 0.15
_SAMPLES_ACROSS = 64
_MISSED = 0.15
_EN_UP = np.array([0, 0, 1])


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """C boxes."""

    center_enu_m: FloatArray
    """(C, 3) metres."""
    half_m: FloatArray
    """(C, 2): half the horizontal width and half the height."""
    log_volume: FloatArray
    """(C,) log of the volume inside the search area, m³."""

    @property
    def count(self) -> int:
        """C."""
        return int(self.log_volume.size)

    def keep(self, chosen: BoolArray | IntArray) -> Mesh:
        """The boxes that ``chosen`` selects, by mask or by number."""
        return Mesh(self.center_enu_m[chosen], self.half_m[chosen], self.log_volume[chosen])


@dataclass(frozen=True, slots=True)
class MeshSettings:
    """How fine and how many."""

    base_cells: int = 20
    """Boxes across the search area before any split."""
    maximum_cells: int = 2000
    """Splitting stops here."""
    split_mass: float = 0.004
    """A box with more of the belief than this is split."""
    minimum_half_m: float = 0.25
    """Boxes are not made smaller than twice this."""
    maximum_rounds: int = 8
    """Rounds of splitting."""
    pieces: int = 2
    """A box that is split is cut into so many along each side."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """The boxes of N problems after splitting, problem by problem."""

    mesh: Mesh
    """All problems' boxes."""
    problem: IntArray
    """(C,) whose box it is, rising."""
    log_likelihood: FloatArray
    """(C,)"""
    place: IntArray
    """(C,) where among all boxes that were evaluated, in order, it was: what was worked out for
    it need not be again."""


def _share_inside(center_en_m: FloatArray, half_m: FloatArray, area: SearchArea) -> FloatArray:
    """(n,) share of the squares round ``center_en_m`` (n, 2) that lies inside the area."""
    if _is_narrow(area):
        return _cut_exactly(center_en_m, half_m, area)
    steps = (np.arange(_SUBPOINTS) + 0.5) / _SUBPOINTS * 2.0 - 1.0
    east = center_en_m[:, 0, None, None] + half_m[:, None, None] * steps[:, None]
    north = center_en_m[:, 1, None, None] + half_m[:, None, None] * steps[None, :]
    east, north = np.broadcast_arrays(east, north)
    inside = area.contains(east.ravel(), north.ravel()).reshape(half_m.size, -1)
    share: FloatArray = inside.mean(axis=1)
    return share


def _cut_exactly(center_en_m: FloatArray, half_m: FloatArray, area: SearchArea) -> FloatArray:
    """The same of a polygon by intersection: for one too narrow for sampling, and slower."""
    low, high = center_en_m - half_m[:, None], center_en_m + half_m[:, None]
    squares = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
    common = shapely.area(shapely.intersection(squares, area.polygon_en_m))
    return np.asarray(common / (2.0 * half_m) ** 2, dtype=np.float64)


@lru_cache(maxsize=16)
def _is_narrow(area: SearchArea) -> bool:
    """Whether samples over the area's square miss much of its polygon."""
    if area.polygon_en_m is None:
        return False
    steps = (np.arange(_SAMPLES_ACROSS) + 0.5) * (2.0 * area.radius_m / _SAMPLES_ACROSS) - area.radius_m
    east, north = np.meshgrid(area.center_enu_m[0] + steps, area.center_enu_m[1] + steps)
    sampled = area.contains(east.ravel(), north.ravel()).mean() * (2.0 * area.radius_m) ** 2
    return bool(abs(sampled / area.polygon_en_m.area - 1.0) > _MISSED)


@lru_cache(maxsize=16)
def base_mesh(area: SearchArea, settings: MeshSettings) -> Mesh:
    """Equal boxes over the area, each with the part of its volume inside it."""
    half = area.radius_m / settings.base_cells
    steps = (np.arange(settings.base_cells) + 0.5) * 2.0 * half - area.radius_m
    lowest, highest = (area.height_min_m, area.height_max_m) if area.ground is None else area.above_ground_m
    height = max(highest - lowest, 2.0 * settings.minimum_half_m)
    levels = int(np.clip(round(height / (2.0 * half)), 2, 8)) if height > 2.0 else 1
    half_z = 0.5 * height / levels
    middle = 0.5 * (lowest + highest)
    heights = middle + half_z * (2.0 * np.arange(levels) + 1.0 - levels)
    east, north = np.meshgrid(area.center_enu_m[0] + steps, area.center_enu_m[1] + steps, indexing="ij")
    columns = np.stack([east.ravel(), north.ravel()], axis=1)
    share = _share_inside(columns, np.full(columns.shape[0], half), area)
    used = (share > 0.0).nonzero()[0]
    center = np.empty((used.size, levels, 3))
    center[:, :, :2] = columns[used, None]
    center[:, :, 2] = heights
    if area.ground is not None:
        center[:, :, 2] += area.ground.at(columns[used, 0], columns[used, 1])[:, None]
    volume = np.repeat(share[used] * (2.0 * half) ** 2 * (2.0 * half_z), levels)
    return Mesh(center.reshape(-1, 3), np.tile([half, half_z], (volume.size, 1)), np.log(volume))


@lru_cache(maxsize=64)
def _steps(pieces: int, levels: int) -> FloatArray:
    """(parts, 1, 3) centres of the parts of a box of half width and half height 1."""
    across = (2.0 * np.arange(pieces) + 1.0) / pieces - 1.0
    up = (2.0 * np.arange(levels) + 1.0) / levels - 1.0
    return np.stack(np.meshgrid(across, across, up, indexing="ij"), axis=-1).reshape(-1, 1, 3)


def split(mesh: Mesh, area: SearchArea, pieces: int = 2) -> tuple[Mesh, IntArray]:
    """Each box in ``pieces``² columns, of as many levels as keep the parts about as high as wide.

    Returns the parts inside the area and, for each, the number of the box that it comes from.
    """
    ratio = mesh.half_m[:, 1] / mesh.half_m[:, 0]
    levels = np.minimum(np.maximum((pieces * ratio + 0.6).astype(np.int64), 1), pieces)
    least, most = int(levels.min()), int(levels.max())
    if least == most:
        return _split_alike(mesh, area, pieces, least)
    finer, parents = [], []
    for number in range(least, most + 1):
        alike = (levels == number).nonzero()[0]
        if alike.size:
            part, parent = _split_alike(mesh.keep(alike), area, pieces, number)
            finer.append(part)
            parents.append(alike[parent])
    return joined(finer), np.concatenate(parents)


def _split_alike(mesh: Mesh, area: SearchArea, pieces: int, levels: int) -> tuple[Mesh, IntArray]:
    step = _steps(pieces, levels)
    parent = np.tile(np.arange(mesh.count), step.shape[0])
    center = (mesh.center_enu_m + step * mesh.half_m[:, _EN_UP]).reshape(-1, 3)
    if area.ground is not None:
        # Height above the ground is what a part inherits, not height: the ground goes on under it.
        under = area.ground.at(mesh.center_enu_m[:, 0], mesh.center_enu_m[:, 1])
        center[:, 2] += area.ground.at(center[:, 0], center[:, 1]) - under[parent]
    half = mesh.half_m / (pieces, levels)
    volume = np.log(8.0 * half[:, 0] * half[:, 0] * half[:, 1])
    cut = mesh.log_volume < volume + (math.log(pieces * pieces * levels) - 1e-9)
    half, log_volume = half[parent], volume[parent]
    if cut.any():
        on_the_edge = cut[parent].nonzero()[0]
        share = _share_inside(center[on_the_edge, :2], half[on_the_edge, 0], area)
        inside = np.ones(parent.size, dtype=bool)
        inside[on_the_edge] = share > 0.0
        log_volume[on_the_edge] += np.log(np.maximum(share, 1e-9))
        return Mesh(center[inside], half[inside], log_volume[inside]), parent[inside]
    return Mesh(center, half, log_volume), parent


def joined(parts: list[Mesh]) -> Mesh:
    """The boxes of all, one after the other."""
    return Mesh(
        np.concatenate([part.center_enu_m for part in parts]),
        np.concatenate([part.half_m for part in parts]),
        np.concatenate([part.log_volume for part in parts]),
    )


def masses(log_likelihood: FloatArray, mesh: Mesh, problem: IntArray | None = None) -> FloatArray:
    """(C,) share of the belief in each box, under a prior uniform over the area.

    ``problem`` (C,), rising: whose box each is, where there are several problems.
    """
    score = log_likelihood + mesh.log_volume
    if problem is None or problem[-1] == 0:
        mass = np.exp(score - score.max())
        result: FloatArray = mass / mass.sum()
        return result
    start = np.searchsorted(problem, np.arange(problem[-1] + 1))
    mass = np.exp(score - np.maximum.reduceat(score, start)[problem])
    result = mass / np.add.reduceat(mass, start)[problem]
    return result


def refine(
    area: SearchArea,
    evaluate: Callable[[Mesh, IntArray], tuple[FloatArray, FloatArray | float]],
    settings: MeshSettings,
    problems: int = 1,
) -> Refined:
    """Split from the base mesh until no box holds much.

    ``evaluate`` gives the log likelihood (C,) of boxes, each for the problem (C,) named beside it,
    and how much more than its mass a box counts when it comes to splitting (1: nothing).
    """
    base = base_mesh(area, settings)
    problem = np.repeat(np.arange(problems), base.count)
    mesh = base if problems == 1 else base.keep(np.tile(np.arange(base.count), problems))
    log_likelihood, urgency = _evaluated(evaluate, mesh, problem)
    evaluated = mesh.count
    place = np.arange(evaluated)
    for _ in range(settings.maximum_rounds):
        mass = masses(log_likelihood, mesh, problem)
        chosen = _with_neighbours(mass * urgency > settings.split_mass, mass, problem)
        chosen = _with_room(chosen, mass, problem, settings)
        chosen &= mesh.half_m[:, 0] > 2.0 * settings.minimum_half_m
        if not chosen.any():
            break
        split_up = chosen.nonzero()[0]
        finer, parent = split(mesh.keep(split_up), area, settings.pieces)
        whose = problem[split_up[parent]]
        kept = (~chosen).nonzero()[0]
        mesh = joined([mesh.keep(kept), finer])
        of_parts, urgency_of_parts = _evaluated(evaluate, finer, whose)
        log_likelihood = np.concatenate([log_likelihood[kept], of_parts])
        urgency = np.concatenate([urgency[kept], urgency_of_parts])
        place = np.concatenate([place[kept], evaluated + np.arange(finer.count)])
        evaluated += finer.count
        problem = np.concatenate([problem[kept], whose])
        if problems > 1:
            order = np.argsort(problem, kind="stable")
            mesh, problem = mesh.keep(order), problem[order]
            log_likelihood, place, urgency = log_likelihood[order], place[order], urgency[order]
    return Refined(mesh, problem, log_likelihood, place)


def _evaluated(
    evaluate: Callable[[Mesh, IntArray], tuple[FloatArray, FloatArray | float]],
    mesh: Mesh,
    problem: IntArray,
) -> tuple[FloatArray, FloatArray]:
    log_likelihood, urgency = evaluate(mesh, problem)
    return log_likelihood, np.broadcast_to(np.asarray(urgency, dtype=np.float64), log_likelihood.shape)


def _with_neighbours(chosen: BoolArray, mass: FloatArray, problem: IntArray) -> BoolArray:
    """Where one box holds much, its belief may be narrower than it: the next likely are split as well.

    A box is weighed at its centre; a peak near its corner may then seem to lie next door.
    """
    count = int(problem[-1]) + 1
    if count == 1:
        if mass.size > _NEIGHBOURS and mass.max() > _MUCH:
            chosen[np.argpartition(mass, -_NEIGHBOURS)[-_NEIGHBOURS:]] = True
        return chosen
    ends = np.searchsorted(problem, np.arange(count + 1))
    most = np.maximum.reduceat(mass, ends[:-1])
    for row in (most > _MUCH).nonzero()[0]:
        first, last = int(ends[row]), int(ends[row + 1])
        if last - first > _NEIGHBOURS:
            chosen[first + np.argpartition(mass[first:last], -_NEIGHBOURS)[-_NEIGHBOURS:]] = True
    return chosen


def _with_room(chosen: BoolArray, mass: FloatArray, problem: IntArray, settings: MeshSettings) -> BoolArray:
    """Of the boxes to be split, those that each problem's number of boxes leaves room for, heaviest first."""
    more = settings.pieces**3 - 1
    room = np.maximum(settings.maximum_cells - np.bincount(problem), 0) // more
    if (np.bincount(problem[chosen], minlength=room.size) <= room).all():
        return chosen
    wanted = chosen.nonzero()[0]
    wanted = wanted[np.lexsort((-mass[wanted], problem[wanted]))]
    whose = problem[wanted]
    rank = np.arange(wanted.size) - np.searchsorted(whose, whose)
    result = np.zeros(chosen.size, dtype=bool)
    result[wanted[rank < room[whose]]] = True
    return result


def moments(mesh: Mesh, mass: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (3,) in metres and covariance (3, 3) in m², the boxes' own extent included."""
    mean = mass @ mesh.center_enu_m
    offset = mesh.center_enu_m - mean
    covariance = (offset.T * mass) @ offset
    own = mass @ (mesh.half_m**2 / 3.0)
    covariance += np.diag([own[0], own[0], own[1]])
    return mean, covariance


def smooth_moments(mesh: Mesh, mass: FloatArray, area: SearchArea) -> tuple[FloatArray, FloatArray]:
    """Mean (3,) and covariance (3, 3) of a belief that the boxes resolve.

    The centres alone integrate a smooth belief; where it is cut off, at the height limits, the
    midpoint rule lacks h²/24 · [d(z − z̄)²f/dz] there (Euler–Maclaurin). A box with a tenth of
    the belief or more resolves nothing, and counts with its extent.
    """
    mean = mass @ mesh.center_enu_m
    offset = mesh.center_enu_m - mean
    covariance = (offset.T * mass) @ offset
    half = mesh.half_m
    coarse = mass * np.minimum(np.maximum(5.0 * mass - 0.5, 0.0), 1.0)
    own = coarse @ (half * half) / 3.0
    below = mesh.center_enu_m[:, 2] - half[:, 1]
    lowest, highest = area.height_limits_m(mesh.center_enu_m[:, 0], mesh.center_enu_m[:, 1])
    at_limit = (below < lowest + 1e-6) | (below + 2.0 * half[:, 1] > highest - 1e-6)
    cut = (mass * half[:, 1] * (np.abs(offset[:, 2]) + half[:, 1]))[at_limit].sum() / 6.0
    covariance[0, 0] += own[0]
    covariance[1, 1] += own[0]
    covariance[2, 2] += own[1] + cut
    return mean, covariance
