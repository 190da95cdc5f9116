from __future__ import annotations

import numpy as np

from groundstation.tracking.places import EAST, SUMS, Places


def test_near_places_of_one_vehicle_are_summed_up() -> None:
    places = Places(2, 10.0, 50)
    places.add(1, (0.0, 0.0, 50.0), (1.0, 0.5))
    places.add(1, (6.0, 0.0, 50.0), (1.0, 0.5))
    places.add(2, (6.0, 0.0, 50.0), (1.0, 0.0))
    places.add(1, (12.0, 0.0, 50.0), (4.0, 0.0))
    assert places.rows[:, SUMS:].tolist() == [[2.0, 1.0], [1.0, 0.0], [4.0, 0.0]]
    assert places.rows[0, EAST] == 0.0


def test_a_full_book_is_coarser_and_loses_no_sum() -> None:
    places = Places(1, 5.0, 20)
    track = np.linspace(0.0, 1000.0, 400)
    for east in track:
        places.add(3, (float(east), 0.0, 40.0), (1.0,))
    assert len(places.rows) <= 20
    assert places.rows[:, SUMS].sum() == 400.0
    # The whole flight stays covered.
    assert np.abs(track[:, None] - places.rows[None, :, EAST]).min(axis=1).max() <= places.spacing_m


def test_state_comes_back() -> None:
    places = Places(1, 5.0, 4)
    for east in range(0, 60, 6):
        places.add(1, (float(east), 0.0, 0.0), (1.0,))
    again = Places(1, 5.0, 4)
    again.restore(places.state())
    for book in (places, again):
        book.add(1, (100.0, 0.0, 0.0), (1.0,))
    assert np.array_equal(places.rows, again.rows)
    assert places.spacing_m == again.spacing_m > 5.0
