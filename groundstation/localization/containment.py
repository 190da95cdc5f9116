"""From a belief to what an operator reads: a place, its spread, a radius, regions.

Exists to keep one definition of "90 %": the share of the belief. Rule: regions are
highest-density, horizontal (heights added up), and the radius is that of the circle round
the mean; both count a box's own extent, so they never shrink under the grid.

A belief says where the target is seen from the vehicles' told places. What these are off by in common
moves it as a whole and shows itself in no residual: it is added here (``Shift``), a convolution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.ndimage import gaussian_filter

from groundstation.localization.mesh import Mesh, moments
from groundstation.localization.problem import FloatArray

EnRing = tuple[tuple[float, float], ...]
"""(east_m, north_m) corners, closed."""

_SUBPOINTS = 4
_RASTER = 64
_SMOOTHING_CELLS = 1.0
_OF_UNIFORM = 12.0**-0.5
"""Standard deviation of a uniform distribution, in its widths."""
Shift = tuple[float, float]
"""Variance of what moves all vehicles' told places alike: each horizontal axis, and vertical, m²."""
_NO_SHIFT = (0.0, 0.0)
_SHIFT_REACH = 3.5
"""A picture goes on for so many of its standard deviations."""
_RINGS, _RADII, _TURNS = 32, 16, 5
"""In how many parts distances from the mean, and a shift's lengths and directions, are counted."""
_SMALL_SHIFT = 0.02
"""A shift so small beside the radius adds to it like a Gaussian's to a Gaussian's, to a thousandth."""


@dataclass(frozen=True, slots=True, eq=False)
class Containment:
    """Summary of a belief."""

    position_enu_m: FloatArray
    """(3,) posterior mean, metres."""
    covariance_m2: FloatArray
    """(3, 3) m²."""
    radius_90_m: float
    """Of the horizontal circle round the mean that holds 90 % of the belief, metres."""


def containment(mesh: Mesh, mass: FloatArray, share: float = 0.9, shift: Shift = _NO_SHIFT) -> Containment:
    """Mean, covariance and the radius that holds ``share``; vehicles' places off by ``shift``."""
    mean, covariance = moments(mesh, mass)
    covariance = covariance + np.diag([shift[0], shift[0], shift[1]])
    steps = (np.arange(_SUBPOINTS) + 0.5) / _SUBPOINTS * 2.0 - 1.0
    used = np.flatnonzero(mass > 1e-7 * mass.max())
    offset = mesh.center_enu_m[used, :2] - mean[:2]
    half = mesh.half_m[used, 0]
    east = offset[:, 0, None, None] + half[:, None, None] * steps[:, None]
    north = offset[:, 1, None, None] + half[:, None, None] * steps[None, :]
    distance = np.hypot(east, north).reshape(used.size, -1)
    weight = np.repeat(mass[used] / _SUBPOINTS**2, _SUBPOINTS**2)
    order = np.argsort(distance.ravel(), kind="stable")
    reached = np.cumsum(weight[order])
    index = int(np.searchsorted(reached, share * reached[-1]))
    radius = float(distance.ravel()[order[min(index, order.size - 1)]])
    if shift[0] > 0.0:
        radius = _shifted_radius(distance.ravel(), weight, radius, share, math.sqrt(shift[0]))
    return Containment(mean, covariance, radius)


def _shifted_radius(
    distance_m: FloatArray, weight: FloatArray, radius_m: float, share: float, std_m: float
) -> float:
    """The radius that holds ``share`` once each place is moved by a Gaussian of ``std_m`` on both axes."""
    if std_m < _SMALL_SHIFT * radius_m:
        return math.hypot(radius_m, std_m * math.sqrt(-2.0 * math.log1p(-share)))
    which = (distance_m * ((_RINGS - 1) / max(float(distance_m.max()), 1e-9))).astype(np.int64)
    held = np.bincount(which, weight, _RINGS)
    ring = np.bincount(which, weight * distance_m, _RINGS) / np.maximum(held, 1e-300)
    ring = ring[:, None, None]
    middles = (np.arange(_RADII) + 0.5) / _RADII
    length = std_m * np.sqrt(-2.0 * np.log1p(-middles))[:, None]
    along = np.cos(math.pi * (np.arange(_TURNS) + 0.5) / _TURNS)
    moved = np.sqrt(ring * (ring + 2.0 * length * along) + length * length).ravel()
    order = np.argsort(moved, kind="stable")
    reached = np.cumsum(np.repeat(held, _RADII * _TURNS)[order])
    return float(np.interp(share * reached[-1], reached, moved[order]))


@dataclass(frozen=True, slots=True, eq=False)
class Raster:
    """The horizontal belief on equal squares, for regions and search maps."""

    west_m: float
    """East coordinate of the first column's western edge."""
    south_m: float
    """North coordinate of the first row's southern edge."""
    cell_m: float
    """Width of a square."""
    mass: FloatArray
    """(rows from the south, columns from the west) share of the belief."""


def raster(mesh: Mesh, mass: FloatArray, cells: int = _RASTER) -> Raster:
    """Horizontal belief over the part of the area that holds all but a thousandth of it, box by box."""
    return _laid_out(mesh, mass, cells, smooth=False)


def smooth_raster(mesh: Mesh, mass: FloatArray, cells: int = _RASTER, shift: Shift = _NO_SHIFT) -> Raster:
    """The raster that regions and search maps are read off: without the boxes' edges.

    The edges are the mesh's, not the belief's: a belief hardly wider than a box would end where the
    box does. Each is smoothed over its own width, as far as a uniform box spreads (width / √12),
    which is what interpolating between the centres of boxes does, and over a square at least. And all
    over what the vehicles' places may be off by in common, ``shift``.
    """
    return _laid_out(mesh, mass, cells, smooth=True, shift_std_m=math.sqrt(shift[0]))


def _laid_out(mesh: Mesh, mass: FloatArray, cells: int, smooth: bool, shift_std_m: float = 0.0) -> Raster:
    order = np.argsort(-mass, kind="stable")
    count = int(np.searchsorted(np.cumsum(mass[order]), 0.999)) + 1
    used = order[:count]
    center, half = mesh.center_enu_m[used, :2], mesh.half_m[used, :1]
    reach = half + _SHIFT_REACH * shift_std_m
    low, high = (center - reach).min(axis=0), (center + reach).max(axis=0)
    cell = float((high - low).max()) / cells
    low = 0.5 * (low + high) - 0.5 * cells * cell
    # Every box is laid out in enough points to fill the squares that it covers.
    values = np.zeros((cells, cells))
    width = 2.0 * half[:, 0]
    level = np.ceil(np.log2(np.maximum(width / cell, 1.0))).astype(int) + 1
    for exponent in np.unique(level):
        points = 2 ** int(exponent)
        steps = (np.arange(points) + 0.5) / points - 0.5
        here = level == exponent
        east = center[here, 0, None] + width[here, None] * steps
        north = center[here, 1, None] + width[here, None] * steps
        column = np.clip(((east - low[0]) / cell).astype(int), 0, cells - 1)
        row = np.clip(((north - low[1]) / cell).astype(int), 0, cells - 1)
        index = (row[:, :, None] * cells + column[:, None, :]).ravel()
        share = np.repeat(mass[used][here] / points**2, points**2)
        part = np.bincount(index, weights=share, minlength=cells * cells).reshape(cells, cells)
        if smooth:
            spread = float(mass[used][here] @ width[here] / mass[used][here].sum()) * _OF_UNIFORM / cell
            spread = math.hypot(max(spread, _SMOOTHING_CELLS), shift_std_m / cell)
            part = gaussian_filter(part, spread, mode="constant")
        values += part
    return Raster(float(low[0]), float(low[1]), cell, values)


def region_rings(
    mesh: Mesh,
    mass: FloatArray,
    shares: tuple[float, ...] = (0.5, 0.9, 0.95),
    picture: Raster | None = None,
) -> tuple[tuple[float, tuple[EnRing, ...]], ...]:
    """Highest-density regions: for each share its rings (outer and holes, even–odd rule), metres.

    ``picture``: what ``smooth_raster`` gave, where it is there already.
    """
    picture = picture or smooth_raster(mesh, mass)
    flat = picture.mass.ravel()
    order = np.argsort(-flat, kind="stable")
    reached = np.cumsum(flat[order])
    result = []
    for share in shares:
        inside = np.zeros(flat.size, dtype=bool)
        inside[order[: int(np.searchsorted(reached, share * reached[-1])) + 1]] = True
        result.append((share, _rings(inside.reshape(picture.mass.shape), picture)))
    return tuple(result)


def _rings(inside: FloatArray, picture: Raster) -> tuple[EnRing, ...]:
    """Outlines of the marked squares; runs along a row first, so that few boxes are joined."""
    padded = np.pad(inside.astype(np.int8), ((0, 0), (1, 1)))
    change = np.diff(padded, axis=1)
    rows, starts = np.nonzero(change == 1)
    _, ends = np.nonzero(change == -1)
    cell = picture.cell_m
    boxes = shapely.box(
        picture.west_m + starts * cell,
        picture.south_m + rows * cell,
        picture.west_m + ends * cell,
        picture.south_m + (rows + 1) * cell,
    )
    outline = shapely.simplify(shapely.union_all(boxes), 0.75 * cell)
    rings: list[EnRing] = []
    for polygon in shapely.get_parts(outline):
        for ring in [polygon.exterior, *polygon.interiors]:
            coordinates = shapely.get_coordinates(ring).round(2)
            rings.append(tuple((float(east), float(north)) for east, north in coordinates))
    return tuple(rings)
