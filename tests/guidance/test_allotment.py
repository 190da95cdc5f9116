"""Numbers of vehicles by uncertainty; places by least way."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.guidance.allotment import assign, best_ring, ring, seats


@pytest.mark.parametrize(
    ("weights", "vehicles", "expected"),
    [
        ([50.0], 4, [4]),
        ([50.0, 10.0], 4, [4, 0]),
        ([10.0, 50.0], 6, [3, 3]),
        ([10.0, 50.0], 9, [3, 6]),
        ([10.0, 50.0, 49.0], 2, [0, 2, 0]),
        ([30.0, 30.0], 3, [3, 0]),
        ([], 3, []),
        ([30.0], 0, [0]),
    ],
)
def test_seats(weights, vehicles, expected):
    assert seats(weights, vehicles, 3) == expected


@given(weights=st.lists(st.floats(1, 500), min_size=1, max_size=6), vehicles=st.integers(0, 20))
def test_every_vehicle_gets_one_seat(weights, vehicles):
    given_seats = seats(weights, vehicles, 3)
    assert sum(given_seats) == vehicles
    assert all(count == 0 or count >= min(3, vehicles) for count in given_seats)


def test_assignment_is_the_cheapest_of_all():
    cost = np.array([[4.0, 1.0, 3.0], [2.0, 0.0, 5.0], [3.0, 2.0, 2.0]])
    chosen = sum(cost[row, column] for row, column in assign(cost))
    assert chosen == min(
        sum(cost[i, p] for i, p in enumerate(order)) for order in itertools.permutations(range(3))
    )


def test_a_ring_has_equal_bearings():
    places = ring((10.0, -5.0), 50.0, 5, 0.3)
    bearings = sorted(math.atan2(y + 5.0, x - 10.0) for x, y in places)
    assert np.allclose(np.diff(bearings), 2 * math.pi / 5)
    assert np.allclose([math.hypot(x - 10.0, y + 5.0) for x, y in places], 50.0)


@given(turn=st.floats(-3, 3))
def test_vehicles_already_spread_stay(turn):
    spread = ring((0.0, 0.0), 60.0, 4, turn)
    assert np.allclose(best_ring(spread, (0.0, 0.0), 60.0, 12), spread, atol=1e-6)


def test_each_vehicle_gets_a_place_of_its_own():
    places = best_ring([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)], (100.0, 100.0), 40.0, 12)
    assert len({(round(x, 3), round(y, 3)) for x, y in places}) == 3
