"""Station time: one clock that never steps, whatever the wall clock does.

Rule: station time is the wall clock at the session's start plus what the monotonic clock
has counted since. A wall clock set by GPS or NTP in flight changes ``unix_us`` alone. After
a restart station time goes on at or after the last journalled time, never before it.
"""

from __future__ import annotations

import time
from collections.abc import Callable


def monotonic_ns() -> int:
    """Nanoseconds that also count while the computer sleeps, where the system offers that."""
    if hasattr(time, "CLOCK_BOOTTIME"):
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    return time.monotonic_ns()


class StationClock:
    """Station time and wall clock for each record."""

    def __init__(
        self,
        not_before_ns: int = 0,
        wall_ns: Callable[[], int] = time.time_ns,
        steady_ns: Callable[[], int] = monotonic_ns,
    ) -> None:
        """``not_before_ns``: the last journalled station time of a session that goes on, ns."""
        self._wall_ns = wall_ns
        self._steady_ns = steady_ns
        wall = wall_ns()
        self.held_back_ns = max(0, not_before_ns - wall)
        """How far the wall clock stood behind the session's last record: worth a warning."""
        self._offset_ns = max(wall, not_before_ns) - steady_ns()
        self._last_ns = not_before_ns

    def time_ns(self) -> int:
        """Station time, ns since the Unix epoch; never decreases."""
        self._last_ns = max(self._last_ns, self._steady_ns() + self._offset_ns)
        return self._last_ns

    def unix_us(self) -> int:
        """The wall clock as it stands, µs since the Unix epoch."""
        return self._wall_ns() // 1000

    def now(self) -> tuple[int, int]:
        """``(time_ns, unix_us)`` of this moment."""
        return self.time_ns(), self.unix_us()
