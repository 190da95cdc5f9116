"""Which vehicles go to which beacon, and which place on its ring each takes.

Beacons get vehicles by how uncertain they are (D'Hondt's highest averages); places go to
vehicles so that the least is flown in total (Hungarian method).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def seats(weights: list[float], vehicles: int, group: int) -> list[int]:
    """How many of ``vehicles`` each beacon gets.

    Beacons are served in order of weight: as many as can have ``group`` vehicles each, and
    at least one; the rest of the vehicles go to the highest weight per vehicle (D'Hondt).

    Parameters
    ----------
    weights
        (B,) positive; how much each beacon needs vehicles.
    vehicles
        How many there are to give.
    group
        Smallest useful number of vehicles at one beacon.
    """
    given = [0] * len(weights)
    if not weights or vehicles <= 0:
        return given
    order = sorted(range(len(weights)), key=lambda index: (-weights[index], index))
    served = order[: max(1, vehicles // group)]
    for index in served:
        given[index] = min(group, vehicles)
    for _ in range(vehicles - sum(given)):
        best = max(served, key=lambda index: (weights[index] / (given[index] + 1), -index))
        given[best] += 1
    return given


def assign(cost: NDArray[np.float64]) -> list[tuple[int, int]]:
    """(row, column) pairs of least total cost; ``cost`` is (rows, columns)."""
    # Here, not above: it takes half a second to import, and a station must listen before it plans.
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(cost)
    return [(int(row), int(column)) for row, column in zip(rows, columns, strict=True)]


def ring(
    center_m: tuple[float, float], radius_m: float, count: int, turn_rad: float
) -> list[tuple[float, float]]:
    """``count`` places at equal bearings on a circle, the first at azimuth ``turn_rad`` from east."""
    return [
        (
            center_m[0] + radius_m * math.cos(turn_rad + 2.0 * math.pi * index / count),
            center_m[1] + radius_m * math.sin(turn_rad + 2.0 * math.pi * index / count),
        )
        for index in range(count)
    ]


def best_ring(
    vehicles_m: list[tuple[float, float]], center_m: tuple[float, float], radius_m: float, rotations: int
) -> list[tuple[float, float]]:
    """A place on the ring for each vehicle, the ring turned so that the least is flown.

    Turns are tried in equal steps and also so that a place lies exactly at each vehicle's
    present bearing: vehicles already well spread then have nothing to fly.
    """
    count = len(vehicles_m)
    start = np.array(vehicles_m)
    turns = [2.0 * math.pi * step / (count * rotations) for step in range(rotations)]
    turns += [math.atan2(y - center_m[1], x - center_m[0]) for x, y in vehicles_m]
    best_cost = math.inf
    best: list[tuple[float, float]] = []
    for turn in turns:
        places = ring(center_m, radius_m, count, turn)
        cost = np.linalg.norm(start[:, None, :] - np.array(places)[None, :, :], axis=2)
        pairs = assign(cost)
        total = float(sum(cost[row, column] for row, column in pairs))
        if total < best_cost - 1e-6:
            best_cost = total
            best = [places[column] for _, column in sorted(pairs)]
    return best
