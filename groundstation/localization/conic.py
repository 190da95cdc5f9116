"""The two conic programs of LSRE, assembled once per shape and filled with data.

Exists because building a conic program costs more than solving it. Rules: sparse patterns
are cached by shape (numbers of links, ends and area faces), never solvers, so that an answer
depends on its data alone; one thread; lengths in units of the area's radius from its centre,
so that the solver sees numbers near one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import clarabel
import numpy as np
import scipy.sparse
import shapely

from groundstation.localization.problem import FloatArray, SearchArea

Entry = tuple[int, int, float]


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """The search area as cone rows over (east, north, up), in scaled units."""

    center: FloatArray
    """(3,) metres: where scaled coordinates begin."""
    scale_m: float
    low: float
    """Scaled height limits."""
    high: float
    faces: FloatArray
    """(f, 3): n_east, n_north, offset with n·x ≤ offset; empty for a disc."""

    @classmethod
    def of(cls, area: SearchArea) -> Region:
        """Disc or, for a polygon, its convex hull (what is not convex is mended by clipping the answer)."""
        center = np.array([area.center_enu_m[0], area.center_enu_m[1], area.height_max_m])
        scale = area.radius_m
        faces = np.zeros((0, 3))
        if area.polygon_en_m is not None:
            hull = shapely.get_coordinates(shapely.convex_hull(area.polygon_en_m))
            if not shapely.is_ccw(shapely.LinearRing(hull)):
                hull = hull[::-1]
            hull = (hull - center[:2]) / scale
            edge = np.diff(hull, axis=0)
            normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            faces = np.column_stack([normal, (normal * hull[:-1]).sum(axis=1)])
        low = (area.height_min_m - center[2]) / scale
        high = (area.height_max_m - center[2]) / scale
        return cls(center, scale, low, high, faces)

    def scaled(self, position_enu_m: FloatArray) -> FloatArray:
        """Metres → scaled."""
        result: FloatArray = (position_enu_m - self.center) / self.scale_m
        return result

    def metres(self, scaled: FloatArray) -> FloatArray:
        """Scaled → metres."""
        result: FloatArray = self.center + self.scale_m * scaled
        return result

    def rows(self) -> tuple[list[Entry], list[float], list[Any]]:
        """Entries, right-hand sides and cones of s = b − A x for the area (heights, then the outline)."""
        entries: list[Entry] = [(0, 2, 1.0), (1, 2, -1.0)]
        right = [self.high, -self.low]
        if len(self.faces):
            for number, (east, north, offset) in enumerate(self.faces):
                entries += [(2 + number, 0, float(east)), (2 + number, 1, float(north))]
                right.append(float(offset))
            return entries, right, [clarabel.NonnegativeConeT(2 + len(self.faces))]
        entries += [(3, 0, -1.0), (4, 1, -1.0)]
        right += [1.0, 0.0, 0.0]
        return entries, right, [clarabel.NonnegativeConeT(2), clarabel.SecondOrderConeT(3)]


def _settings() -> Any:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.presolve_enable = False
    settings.chordal_decomposition_enable = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-9
    return settings


def _csc(rows: Any, columns: Any, shape: tuple[int, int]) -> tuple[Any, Any]:
    """A csc pattern and the permutation that puts entry values into its data order."""
    order = np.lexsort((rows, columns))
    counts = np.bincount(columns, minlength=shape[1])
    pointer = np.concatenate([[0], np.cumsum(counts)])
    matrix = scipy.sparse.csc_matrix((np.zeros(order.size), rows[order], pointer), shape=shape)
    return matrix, order


@lru_cache(maxsize=64)
def _literal_pattern(pairs: tuple[int, ...], faces: int) -> tuple[Any, Any]:
    """Pattern of (64): variables x(3), then (s, y, τ1, τ2) for each (link, end) pair."""
    head = 2 + faces if faces else 5
    entries = [(0, 2), (1, 2)]
    entries += [(2 + f, c) for f in range(faces) for c in (0, 1)] if faces else [(3, 0), (4, 1)]
    row = head
    for pair in range(len(pairs)):
        s, y, t1, t2 = (3 + 4 * pair + i for i in range(4))
        entries += [(row, t1), (row, y), (row + 1, t1), (row + 1, y)]
        entries += [(row + 3, y), (row + 4, y), (row + 5, s)]
        entries += [(row + 6, t2), (row + 7, t2), (row + 8, s)]
        entries += [(row + 9, s), (row + 10, 0), (row + 11, 1), (row + 12, 2)]
        row += 13
    rows, columns = np.array(entries, dtype=np.int64).T
    return _csc(rows, columns, (row, 3 + 4 * len(pairs)))


def solve_literal(
    vehicle_enu_m: FloatArray, gain_per_m: FloatArray, ends: list[tuple[float, ...]], area: SearchArea
) -> tuple[FloatArray, str]:
    """(64) as printed, ζ fixed at 1/m_t: the position (3,) and the solver's status.

    ``gain_per_m`` (K,): m_k / m_{t,k}; ``ends``: for each link R_k of (72). Nothing bounds
    y from above, so the reciprocal term costs nothing and a weighted centroid comes out.
    """
    region = Region.of(area)
    place = region.scaled(vehicle_enu_m)
    pairs = tuple(k for k, link_ends in enumerate(ends) for _ in link_ends)
    factors = [
        float(e * gain_per_m[k] * region.scale_m) for k, link_ends in enumerate(ends) for e in link_ends
    ]
    matrix, order = _literal_pattern(pairs, len(region.faces))
    area_entries, right, cones = region.rows()
    values = [value for _, _, value in area_entries]
    for k, factor in zip(pairs, factors, strict=True):
        values += [-1.0, -1.0, -1.0, 1.0]
        values += [-1.0, -1.0, -2.0 * factor]
        values += [-1.0, -1.0, -2.0 * factor]
        values += [-1.0, 1.0, 1.0, 1.0]
        right += [0.0, 0.0, 2.0, 1.0, -1.0, 0.0, 1.0, -1.0, 0.0, 0.0, *place[k]]
        cones += [clarabel.SecondOrderConeT(3)] * 3 + [clarabel.SecondOrderConeT(4)]
    filled = matrix.copy()
    filled.data = np.array(values)[order]
    size = filled.shape[1]
    cost = np.zeros(size)
    cost[5::4] = 1.0
    cost[6::4] = 1.0
    quadratic = scipy.sparse.csc_matrix((size, size))
    solution = clarabel.DefaultSolver(quadratic, cost, filled, np.array(right), cones, _settings()).solve()
    return region.metres(np.array(solution.x[:3])), str(solution.status)


@lru_cache(maxsize=64)
def _majoriser_pattern(links: int, faces: int) -> tuple[Any, Any]:
    head = 2 + faces if faces else 5
    entries = [(0, 2), (1, 2)]
    entries += [(2 + f, c) for f in range(faces) for c in (0, 1)] if faces else [(3, 0), (4, 1)]
    row = head
    for link in range(links):
        entries += [(row, 3 + link), (row + 1, 3 + link)]
        entries += [(row + side, axis) for side in (0, 1) for axis in range(3)]
        row += 3
    rows, columns = np.array(entries, dtype=np.int64).T
    return _csc(rows, columns, (row, 3 + links))


def majoriser(
    vehicle_enu_m: FloatArray, gain_per_m: FloatArray, weight: FloatArray, area: SearchArea
) -> Callable[[FloatArray], tuple[FloatArray, str]]:
    """The convex program of one convex–concave step, as a function of the point it is taken at.

    min Σ g_k (t_k² + c_k²‖x − a_k‖²) over the area, t_k v_k ≥ 1, v_k = c_k(D₀ + ∇D₀ᵀ(x − x₀))
    ≤ c_k‖x − a_k‖: an upper bound of the LSRE criterion that touches it at x₀.
    """
    region = Region.of(area)
    place = region.scaled(vehicle_enu_m)
    gain = gain_per_m * region.scale_m
    links = gain.size
    matrix, order = _majoriser_pattern(links, len(region.faces))
    area_entries, area_right, cones = region.rows()
    cones = cones + [clarabel.SecondOrderConeT(3)] * links
    head = np.array([value for _, _, value in area_entries])
    pull = weight * gain**2
    size = 3 + links
    quadratic = scipy.sparse.csc_matrix(
        scipy.sparse.diags_array(np.concatenate([np.full(3, 2.0 * pull.sum()), 2.0 * weight]))
    )
    cost = np.concatenate([-2.0 * pull @ place, np.zeros(size - 3)])
    solvers: list[Any] = []

    def step(position_enu_m: FloatArray) -> tuple[FloatArray, str]:
        at = region.scaled(position_enu_m)
        offset = at - place
        distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-6)
        slope = gain[:, None] * offset / distance[:, None]
        level = gain * distance - slope @ at
        ones = np.ones((links, 1))
        values = np.concatenate([head, np.concatenate([-ones, -ones, -slope, slope], axis=1).ravel()])
        right = np.concatenate([area_right, np.stack([level, -level, np.full(links, 2.0)], axis=1).ravel()])
        filled = matrix.copy()
        filled.data = values[order]
        if solvers:
            solvers[0].update(A=filled, b=right)
        else:
            solvers.append(clarabel.DefaultSolver(quadratic, cost, filled, right, cones, _settings()))
        solution = solvers[0].solve()
        return region.metres(np.array(solution.x[:3])), str(solution.status)

    return step
