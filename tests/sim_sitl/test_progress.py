"""Progress: one line on a terminal, plain lines elsewhere, never more than there is to tell."""

from __future__ import annotations

from io import StringIO

import pytest

from sim_sitl.progress import Progress


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_elsewhere_it_writes_plain_lines_now_and_then(clock: Clock) -> None:
    stream = StringIO()
    progress = Progress("rows", stream, clock)
    for done in range(11):
        progress(done, 10)
        clock.now += 1.0
    assert stream.getvalue().splitlines() == [
        "0 of 10 rows", "5 of 10 rows, about 5 s left", "10 of 10 rows",
    ]  # fmt: skip


def test_a_terminal_has_one_line_that_ends_with_the_work(clock: Clock) -> None:
    stream = Terminal()
    progress = Progress("trials", stream, clock)
    progress(1, 2)
    assert stream.getvalue() == "\r\x1b[K1 of 2 trials"
    progress(2, 2)
    progress.end()
    assert stream.getvalue() == "\r\x1b[K1 of 2 trials\r\x1b[K2 of 2 trials\n"


def test_what_follows_a_broken_off_line_has_its_own(clock: Clock) -> None:
    stream = Terminal()
    progress = Progress("trials", stream, clock)
    progress.end()
    assert stream.getvalue() == ""
    progress(1, 2)
    progress.end()
    progress.end()
    assert stream.getvalue() == "\r\x1b[K1 of 2 trials\n"


def test_long_waits_are_told_in_minutes(clock: Clock) -> None:
    stream = StringIO()
    progress = Progress("trials", stream, clock)
    progress(0, 100)
    clock.now += 60.0
    progress(10, 100)
    assert stream.getvalue().splitlines()[-1] == "10 of 100 trials, about 9 min left"
