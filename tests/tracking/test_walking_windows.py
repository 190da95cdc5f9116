from __future__ import annotations

from dataclasses import replace

import numpy as np

from groundstation.localization import SignalModel
from groundstation.tracking import TrackingSettings, TrackObservation
from groundstation.tracking.history import History
from groundstation.tracking.walking_windows import Windows, related, visits

PAPER = SignalModel(nlos_bias_max_db=8.0)
SETTINGS = TrackingSettings(sample_std_db=0.3)
NUMBERS = History(PAPER, SETTINGS)
MINE = np.array([0, 1])


def windows(*told: tuple[int, float, float | None, float]) -> Windows:
    """Of (vehicle, east in metres, power, time)."""
    return Windows.of(
        [
            TrackObservation(
                vehicle, (east_m, 0.0, 50.0), rss, None, 0.3, -0.5, None, None, 1.0, True, time_s
            )
            for vehicle, east_m, rss, time_s in told
        ],
        NUMBERS,
    )


EARLIER = windows(
    (1, 0.0, -40.0, 1.0), (1, 8.0, -41.0, 2.0), (1, 16.0, -42.0, 3.0), (1, 17.0, None, 3.5),
    (2, 17.0, -50.0, 3.0), (1, 90.0, -44.0, 9.0),
)  # fmt: skip
PAST = windows((1, 40.0, -43.0, 80.0), (2, 60.0, -51.0, 80.0))


def test_who_comes_again_is_reminded_of_his_own_nearest_windows() -> None:
    again = visits(EARLIER.rows, MINE, PAST, windows((1, 15.0, -47.0, 82.0)), 25.0)
    assert again.time_s.tolist() == [2.0, 3.0]
    # Numbered otherwise by the belief that remembers them, or not known to the walk at all.
    turned = visits(EARLIER.rows, np.array([1, 0]), PAST, windows((2, 15.0, -47.0, 82.0)), 25.0)
    assert turned.time_s.tolist() == [2.0, 3.0]
    assert (turned.observations().link == 1).all()
    assert visits(EARLIER.rows, np.array([-1, 1]), PAST, windows((1, 15.0, -47.0, 82.0)), 25.0).count == 0


def test_who_goes_on_or_hovers_comes_nowhere_again() -> None:
    # The newest window of the vehicle is nearer than any older one.
    assert visits(EARLIER.rows, MINE, PAST, windows((1, 46.0, -47.0, 82.0)), 25.0).count == 0
    # Nearer than that, but not near.
    assert visits(EARLIER.rows, MINE, PAST, windows((1, 25.0, -47.0, 82.0)), 25.0).count == 0
    assert visits(EARLIER.rows, MINE, PAST, windows((1, 25.0, -47.0, 82.0)), 50.0).count == 1
    hovering = windows(*((1, 5.0, -40.0, float(second)) for second in range(10)))
    there = windows((1, 5.0, -40.0, 10.0))
    assert visits(hovering.rows, MINE, there, windows((1, 5.0, -47.0, 12.0)), 25.0).count == 0
    nobody = windows((2, 60.0, -51.0, 80.0))
    assert visits(EARLIER.rows, MINE, nobody, windows((1, 15.0, -47.0, 82.0)), 25.0).count == 0


def test_an_earlier_visit_foretells_the_level_and_nothing_of_the_bearing() -> None:
    new = windows((1, 15.0, -47.0, 82.0), (2, 68.0, -50.0, 82.0))
    again = visits(EARLIER.rows, MINE, PAST, new, 25.0)
    for model in (PAPER, replace(PAPER, shared_shadowing=0.7)):
        plain = related(PAST, new, 2, 0.8, model, SETTINGS)
        told = related(PAST, new, 2, 0.8, model, SETTINGS, again)
        assert (told.past, told.first, plain.first) == (2, 4, 2)
        parents = set(told.every.parents[4].tolist())
        assert {0, 2, 3} <= parents
        # However long ago: of somebody who stands still.
        assert told.whitened.scale[0] < 0.6 * plain.whitened.scale[0]
        assert told.whitened.scale[1] == plain.whitened.scale[1]
        np.testing.assert_array_equal(told.every.angle_weight[4:], plain.every.angle_weight[2:])
        np.testing.assert_array_equal(told.late_s, plain.late_s)
