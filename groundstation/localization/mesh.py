"""Candidate positions: boxes over the search area, fine where the belief is.

Exists because an area of hundreds of metres and a belief of two metres need one set of
candidates of bounded size. Rule: deterministic – boxes split by the mass they hold, in
order, never at random – and each box knows its volume, so that density and mass agree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.localization.problem import BoolArray, FloatArray, SearchArea

IntArray = NDArray[np.int64]

_SUBPOINTS = 4


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

    def keep(self, mask: BoolArray) -> Mesh:
        """The boxes that ``mask`` selects."""
        return Mesh(self.center_enu_m[mask], self.half_m[mask], self.log_volume[mask])


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


def _inside(center: FloatArray, half: FloatArray, area: SearchArea) -> Mesh:
    """Boxes with the part of their volume inside the area; those with none are left out."""
    steps = (np.arange(_SUBPOINTS) + 0.5) / _SUBPOINTS * 2.0 - 1.0
    east = center[:, 0, None, None] + half[:, 0, None, None] * steps[:, None]
    north = center[:, 1, None, None] + half[:, 0, None, None] * steps[None, :]
    east, north = np.broadcast_arrays(east, north)
    share = area.contains(east.ravel(), north.ravel()).reshape(center.shape[0], -1).mean(axis=1)
    mask = share > 0.0
    volume = share[mask] * (2.0 * half[mask, 0]) ** 2 * (2.0 * half[mask, 1])
    return Mesh(center[mask], half[mask], np.log(volume))


def base_mesh(area: SearchArea, settings: MeshSettings) -> Mesh:
    """Equal boxes over the area."""
    half = area.radius_m / settings.base_cells
    steps = (np.arange(settings.base_cells) + 0.5) * 2.0 * half - area.radius_m
    height = max(area.height_max_m - area.height_min_m, 2.0 * settings.minimum_half_m)
    levels = int(np.clip(round(height / (2.0 * half)), 2, 8)) if height > 2.0 else 1
    half_z = 0.5 * height / levels
    heights = area.height_min_m + half_z * (2.0 * np.arange(levels) + 1.0)
    east, north, up = np.meshgrid(
        area.center_enu_m[0] + steps, area.center_enu_m[1] + steps, heights, indexing="ij"
    )
    center = np.stack([east.ravel(), north.ravel(), up.ravel()], axis=1)
    return _inside(center, np.tile([half, half_z], (center.shape[0], 1)), area)


def split(mesh: Mesh, area: SearchArea) -> Mesh:
    """Each box in four, or in eight where it is as high as it is wide."""
    parts = []
    flat = mesh.half_m[:, 1] < 0.7 * mesh.half_m[:, 0]
    for up in (-1.0, 0.0, 1.0):
        chosen = flat if up == 0.0 else ~flat
        if not chosen.any():
            continue
        half = mesh.half_m[chosen] * (0.5, 1.0 if up == 0.0 else 0.5)
        for east in (-1.0, 1.0):
            for north in (-1.0, 1.0):
                shift = np.stack([east * half[:, 0], north * half[:, 0], up * half[:, 1]], axis=1)
                parts.append((mesh.center_enu_m[chosen] + shift, half))
    return _inside(np.concatenate([c for c, _ in parts]), np.concatenate([h for _, h in parts]), area)


def masses(log_likelihood: FloatArray, mesh: Mesh) -> FloatArray:
    """(C,) share of the belief in each box, under a prior uniform over the area."""
    score = log_likelihood + mesh.log_volume
    mass = np.exp(score - score.max())
    result: FloatArray = mass / mass.sum()
    return result


def refine(
    area: SearchArea, evaluate: Callable[[Mesh], FloatArray], settings: MeshSettings
) -> tuple[Mesh, FloatArray, IntArray]:
    """Split from the base mesh until no box holds much.

    Returns the boxes, their log likelihood, and for each the place that it had among all boxes
    that ``evaluate`` was given, in order: what was worked out for it need not be again.
    """
    mesh = base_mesh(area, settings)
    log_likelihood = evaluate(mesh)
    evaluated = mesh.count
    place = np.arange(evaluated)
    for _ in range(settings.maximum_rounds):
        mass = masses(log_likelihood, mesh)
        chosen = (mass > settings.split_mass) & (mesh.half_m[:, 0] > 2.0 * settings.minimum_half_m)
        room = (settings.maximum_cells - mesh.count) // 7
        if not chosen.any() or room < 1:
            break
        if int(chosen.sum()) > room:
            heaviest = np.argsort(np.where(chosen, -mass, 0.0), kind="stable")[:room]
            chosen = np.zeros(mesh.count, dtype=bool)
            chosen[heaviest] = True
        finer = split(mesh.keep(chosen), area)
        rest = mesh.keep(~chosen)
        mesh = Mesh(
            np.concatenate([rest.center_enu_m, finer.center_enu_m]),
            np.concatenate([rest.half_m, finer.half_m]),
            np.concatenate([rest.log_volume, finer.log_volume]),
        )
        log_likelihood = np.concatenate([log_likelihood[~chosen], evaluate(finer)])
        place = np.concatenate([place[~chosen], evaluated + np.arange(finer.count)])
        evaluated += finer.count
    return mesh, log_likelihood, place


def moments(mesh: Mesh, mass: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (3,) in metres and covariance (3, 3) in m², the boxes' own extent included."""
    mean = mass @ mesh.center_enu_m
    offset = mesh.center_enu_m - mean
    covariance = np.einsum("c,ci,cj->ij", mass, offset, offset)
    own = mass @ (mesh.half_m**2 / 3.0)
    covariance += np.diag([own[0], own[0], own[1]])
    return mean, covariance
