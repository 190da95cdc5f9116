"""Least squares inside the height limits and the search area.

Exists because a quadratic's best point inside a cylinder over a disc or a polygon has an
answer in closed form but for one multiplier or one nearest point, so that a bound costs no
solver. Rule: batched over problems; only those whose free answer lies outside are touched.
"""

from __future__ import annotations

import math

import numpy as np
import shapely
from scipy.special import ndtr

from groundstation.localization.problem import FloatArray, SearchArea

_BISECTIONS = 60
_THINNEST_M = 0.01
_DEEPEST_STD = 8.0
"""A free height further outside the limits counts as this far: the tails end in double precision."""
_ROOT_2PI = math.sqrt(2.0 * math.pi)


def bounded_minimum(normal: FloatArray, vector: FloatArray, free: FloatArray, area: SearchArea) -> FloatArray:
    """Minimum of xᵀ H x − 2 vᵀ x inside ``area`` from its free minimum (N, 3).

    ``normal`` H (N, 3, 3), ``vector`` v (N, 3). The height's bound first; where the place then
    lies outside the area, the best place on its edge with the height free, or held at the bound
    that this would pass.
    """
    answer = free
    low, high = area.height_min_m, area.height_max_m
    height = np.minimum(np.maximum(free[:, 2], low), high)
    held = height != free[:, 2]
    if held.any():
        answer = free.copy()
        answer[held] = _at_height(normal[held], vector[held], height[held])
    outside = np.flatnonzero(~area.contains(answer[:, 0], answer[:, 1]))
    if not outside.size:
        return answer
    answer = answer.copy() if answer is free else answer
    block, right = normal[outside], vector[outside]
    # With the height free, it follows the place: the Schur complement on the plane.
    slope = block[:, :2, 2] / block[:, 2, 2, None]
    plane = block[:, :2, :2] - slope[:, :, None] * block[:, None, :2, 2]
    place = _on_the_edge(plane, right[:, :2] - slope * right[:, 2, None], area)
    height = right[:, 2] / block[:, 2, 2] - (slope * place).sum(axis=1)
    passing = (height < low) | (height > high)
    if passing.any():
        height[passing] = np.clip(height[passing], low, high)
        place[passing] = _held_on_the_edge(block[passing], right[passing], height[passing], area)
    answer[outside, :2], answer[outside, 2] = place, height
    return answer


def within_heights(
    covariance: FloatArray, free_height_m: FloatArray, height_m: FloatArray, area: SearchArea
) -> FloatArray:
    """Mean squared error (N, 3, 3), m², of bounded answers at heights (N,) whose free ones (N,) are given.

    The free answer is normal with ``covariance``; the height limits cut that normal, and the
    second moment of what is left is taken about the answer, which sits on a limit where the free
    one lies beyond it. Exact for a quadratic and a height uniform between its limits.
    """
    variance = covariance[:, 2, 2]
    std = np.sqrt(variance)
    low, high = area.height_min_m, max(area.height_max_m, area.height_min_m + _THINNEST_M)
    center = np.minimum(np.maximum(free_height_m, low - _DEEPEST_STD * std), high + _DEEPEST_STD * std)
    # By symmetry from the side where neither tail vanishes.
    flip = np.where(center > 0.5 * (low + high), -1.0, 1.0)
    a = np.where(flip > 0.0, low - center, center - high) / std
    b = np.where(flip > 0.0, high - center, center - low) / std
    density_a, density_b = np.exp(-0.5 * a * a) / _ROOT_2PI, np.exp(-0.5 * b * b) / _ROOT_2PI
    mass = ndtr(-a) - ndtr(-b)
    mean = (density_a - density_b) / mass
    spread = 1.0 + (a * density_a - b * density_b) / mass - mean * mean
    shift = center + flip * std * mean - height_m
    ahead = covariance[:, :, 2] / variance[:, None]
    change = variance * np.maximum(spread, 1e-6) - variance + shift * shift
    result: FloatArray = covariance + ahead[:, :, None] * ahead[:, None, :] * change[:, None, None]
    return result


def _at_height(normal: FloatArray, vector: FloatArray, height: FloatArray) -> FloatArray:
    reduced = vector[:, :2] - normal[:, :2, 2] * height[:, None]
    place = np.linalg.solve(normal[:, :2, :2], reduced[..., None])[..., 0]
    return np.column_stack([place, height])


def _held_on_the_edge(
    normal: FloatArray, vector: FloatArray, height: FloatArray, area: SearchArea
) -> FloatArray:
    inside = _at_height(normal, vector, height)[:, :2]
    outside = ~area.contains(inside[:, 0], inside[:, 1])
    reduced = vector[:, :2] - normal[:, :2, 2] * height[:, None]
    if outside.any():
        inside[outside] = _on_the_edge(normal[outside][:, :2, :2], reduced[outside], area)
    return inside


def _on_the_edge(plane: FloatArray, vector: FloatArray, area: SearchArea) -> FloatArray:
    """The best places (N, 2) on the area's edge for xᵀ H x − 2 vᵀ x whose free minimum lies outside."""
    if area.polygon_en_m is not None:
        return _on_a_polygon(plane, vector, area.polygon_en_m)
    center = area.center_enu_m[:2]
    gradient = vector - (plane @ center)
    values, vectors = np.linalg.eigh(plane)
    along = np.einsum("nji,nj->ni", vectors, gradient)
    # The rim's multiplier: the norm of along / (values + multiplier) falls as it grows.
    low = np.zeros(len(plane))
    high = np.linalg.norm(gradient, axis=1) / area.radius_m
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        reach = np.linalg.norm(along / (values + middle[:, None]), axis=1)
        far = reach > area.radius_m
        low, high = np.where(far, middle, low), np.where(far, high, middle)
    result: FloatArray = center + np.einsum("nij,nj->ni", vectors, along / (values + high[:, None]))
    return result


def _on_a_polygon(plane: FloatArray, vector: FloatArray, polygon: shapely.Geometry) -> FloatArray:
    """The nearest places of the polygon in the metric of H: Euclidean once the plane is stretched."""
    places = np.empty((len(plane), 2))
    corners = shapely.get_coordinates(polygon)
    for row in range(len(plane)):
        stretch = np.linalg.cholesky(plane[row]).T
        shape = shapely.set_coordinates(polygon, corners @ stretch.T)
        target = shapely.Point(np.linalg.solve(stretch.T, vector[row]))
        nearest = shapely.get_coordinates(shapely.shortest_line(shape, target))[0]
        places[row] = np.linalg.solve(stretch, nearest)
    return places
