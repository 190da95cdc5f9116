"""WLS-Taylor (30)–(51): the LOS solver, closed form, batched.

Exists because in line of sight angles and power ratios are linear in the position after one
Taylor step, so three small linear solves reach the Cramér–Rao bound within percents. Rule:
one code for one problem and for a batch, so that a study and the service agree.

One unweighted solve gives the point at which the weights' Jacobians (47)–(48) are taken;
two weighted solves follow (one leaves the error at 1.10 × the bound). W of (50) is 3K × 3K:
n^s includes the reference link. The bounded version adds the height limits (one active
bound, closed form) and the search area to each solve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.localization.problem import FloatArray, SearchArea, SignalModel

_RIDGE = 1e-10
_WEIGHTED_SOLVES = 2


@dataclass(frozen=True, slots=True, eq=False)
class WlsInput:
    """N problems of K ≥ 2 LOS links with angles, the strongest link first."""

    position: FloatArray
    """(N, K, 3) metres."""
    rss: FloatArray
    """(N, K) dBm."""
    azimuth: FloatArray
    """(N, K) radians."""
    elevation: FloatArray
    """(N, K) radians."""


def strongest_first(
    position: FloatArray, rss: FloatArray, azimuth: FloatArray, elevation: FloatArray
) -> WlsInput:
    """Order the links of each problem by falling power: the reference has the least relative noise."""
    order = np.argsort(-rss, axis=-1, kind="stable")
    return WlsInput(
        np.take_along_axis(position, order[..., None], axis=-2),
        np.take_along_axis(rss, order, axis=-1),
        np.take_along_axis(azimuth, order, axis=-1),
        np.take_along_axis(elevation, order, axis=-1),
    )


def wls_taylor(problem: WlsInput, model: SignalModel, area: SearchArea | None = None) -> FloatArray:
    """Positions (N, 3), metres ENU; bounded by ``area`` when it is given.

    Raises numpy.linalg.LinAlgError only on non-finite input.
    """
    cos_az, sin_az = np.cos(problem.azimuth), np.sin(problem.azimuth)
    cos_el, sin_el = np.cos(problem.elevation), np.sin(problem.elevation)
    zeros = np.zeros_like(cos_az)
    bearing = np.stack([cos_el * cos_az, cos_el * sin_az, sin_el], axis=-1)
    rows_azimuth = np.stack([sin_az, -cos_az, zeros], axis=-1)
    rows_elevation = np.stack([sin_el * cos_az, sin_el * sin_az, -cos_el], axis=-1)
    ratio = 10.0 ** ((problem.rss[:, :1] - problem.rss[:, 1:]) / (10.0 * model.los_exponent))
    rows_ratio = bearing[:, 1:] - ratio[..., None] * bearing[:, :1]
    along = np.einsum("nki,nki->nk", bearing, problem.position)
    matrix = np.concatenate([rows_azimuth, rows_elevation, rows_ratio], axis=1)
    right = np.concatenate(
        [
            np.einsum("nki,nki->nk", rows_azimuth, problem.position),
            np.einsum("nki,nki->nk", rows_elevation, problem.position),
            along[:, 1:] - ratio * along[:, :1],
        ],
        axis=1,
    )
    answer = _solve(matrix, right, area)
    for _ in range(_WEIGHTED_SOLVES):
        factor = np.linalg.cholesky(_error_covariance(problem, answer, bearing, ratio, model))
        stacked = np.concatenate([matrix, right[..., None]], axis=2)
        whitened = np.linalg.solve(factor, stacked)
        answer = _solve(whitened[..., :3], whitened[..., 3], area)
    return answer


def _error_covariance(
    problem: WlsInput, at: FloatArray, bearing: FloatArray, ratio: FloatArray, model: SignalModel
) -> FloatArray:
    """Q = C W Cᵀ of (49)–(50), (N, 3K−1, 3K−1), with the Jacobians taken at ``at``."""
    count, links = problem.rss.shape
    offset = at[:, None, :] - problem.position
    cos_az, sin_az = np.cos(problem.azimuth), np.sin(problem.azimuth)
    cos_el, sin_el = np.cos(problem.elevation), np.sin(problem.elevation)
    x, y, z = offset[..., 0], offset[..., 1], offset[..., 2]
    jacobian = np.zeros((count, 3 * links - 1, 3 * links))
    every = np.arange(links)
    jacobian[:, every, every] = x * cos_az + y * sin_az
    jacobian[:, links + every, every] = sin_el * (y * cos_az - x * sin_az)
    along = np.einsum("nki,nki->nk", bearing, offset)
    jacobian[:, links + every, links + every] = along
    by_azimuth = cos_el * (y * cos_az - x * sin_az)
    by_elevation = z * cos_el - sin_el * (x * cos_az + y * sin_az)
    others = every[1:]
    ratio_rows = 2 * links + others - 1
    jacobian[:, ratio_rows, others] = by_azimuth[:, 1:]
    jacobian[:, ratio_rows, links + others] = by_elevation[:, 1:]
    jacobian[:, ratio_rows, 0] = -ratio * by_azimuth[:, :1]
    jacobian[:, ratio_rows, links] = -ratio * by_elevation[:, :1]
    per_db = np.log(10.0) / (10.0 * model.los_exponent) * ratio * along[:, :1]
    jacobian[:, ratio_rows, 2 * links + others] = per_db
    jacobian[:, ratio_rows, 2 * links] = -per_db
    std = np.repeat([model.azimuth_std_rad, model.elevation_std_rad, model.rss_std_db], links)
    scaled = jacobian * std
    covariance = scaled @ np.swapaxes(scaled, 1, 2)
    # A target on an angle row's zero (right under a vehicle) would make Q singular.
    diagonal = np.einsum("nii->ni", covariance)
    diagonal += _RIDGE * diagonal.max(axis=1, keepdims=True) + 1e-300
    result: FloatArray = covariance
    return result


def _solve(matrix: FloatArray, right: FloatArray, area: SearchArea | None) -> FloatArray:
    """Least squares (N, M, 3), (N, M) → (N, 3), with one active height bound and the area."""
    normal = np.einsum("nmi,nmj->nij", matrix, matrix)
    vector = np.einsum("nmi,nm->ni", matrix, right)
    scale = np.einsum("nii->n", normal)[:, None, None]
    normal = normal + _RIDGE * scale * np.eye(3)
    answer: FloatArray = np.linalg.solve(normal, vector[..., None])[..., 0]
    if area is None:
        return answer
    height = np.clip(answer[:, 2], area.height_min_m, area.height_max_m)
    active = height != answer[:, 2]
    if active.any():
        reduced = vector[active, :2] - normal[active, :2, 2] * height[active, None]
        answer[active, :2] = np.linalg.solve(normal[active, :2, :2], reduced[..., None])[..., 0]
        answer[active, 2] = height[active]
    outside = ~area.contains(answer[:, 0], answer[:, 1])
    for row in np.flatnonzero(outside):
        answer[row] = _on_the_edge(normal[row], vector[row], answer[row], area)
    return answer


def _on_the_edge(normal: FloatArray, vector: FloatArray, answer: FloatArray, area: SearchArea) -> FloatArray:
    """The best point of a disc's rim by its multiplier (bisection); of a polygon the nearest point."""
    if area.polygon_en_m is not None:
        nearest: FloatArray = area.clip(answer[None])[0]
        return nearest
    center = area.center_enu_m[:2]
    block = normal[:2, :2]
    gradient = vector[:2] - normal[:2, 2] * answer[2] - block @ center
    values, vectors = np.linalg.eigh(block)
    projected = vectors.T @ gradient
    low, high = 0.0, float(np.linalg.norm(gradient) / area.radius_m)
    for _ in range(60):
        middle = 0.5 * (low + high)
        too_far = np.linalg.norm(projected / (values + middle)) > area.radius_m
        low, high = (middle, high) if too_far else (low, middle)
    horizontal = center + vectors @ (projected / (values + high))
    return np.array([horizontal[0], horizontal[1], answer[2]])
