"""Station time never steps back, whatever the wall clock does."""

from __future__ import annotations

from groundstation.store.clock import StationClock, monotonic_ns

HOUR_NS = 3_600_000_000_000


class Hands:
    """A wall clock and a steady one that the test moves."""

    def __init__(self) -> None:
        self.wall = 1_795_311_900 * 10**9
        self.steady = 42


def test_follows_the_steady_clock_when_the_wall_clock_is_set() -> None:
    hands = Hands()
    clock = StationClock(0, lambda: hands.wall, lambda: hands.steady)
    start = hands.wall
    assert clock.now() == (start, start // 1000)
    hands.steady += 5
    hands.wall -= HOUR_NS
    assert clock.now() == (start + 5, (start - HOUR_NS) // 1000)


def test_never_decreases() -> None:
    hands = Hands()
    clock = StationClock(0, lambda: hands.wall, lambda: hands.steady)
    first = clock.time_ns()
    hands.steady -= 10
    assert clock.time_ns() == first


def test_after_a_restart_it_goes_on_behind_the_last_record() -> None:
    hands = Hands()
    last = hands.wall + HOUR_NS
    clock = StationClock(last, lambda: hands.wall, lambda: hands.steady)
    assert clock.held_back_ns == HOUR_NS
    assert clock.time_ns() == last
    hands.steady += 7
    assert clock.time_ns() == last + 7
    assert StationClock(hands.wall - 1, lambda: hands.wall, lambda: hands.steady).held_back_ns == 0


def test_the_steady_clock_of_this_system_is_steady() -> None:
    readings = [monotonic_ns() for _ in range(100)]
    assert readings == sorted(readings)
