"""Maps a sender's own times to station time: one clock per (system, component).

Why: a vehicle's autopilot and its radio sensor stamp their messages by clocks of their
own, off by hours and drifting apart; a sample must be set beside the pose of its instant.

How: the network only delays. Each message bounds the offset from above,

    offset = station time − sender time ≤ arrival − sender time,

so the smallest difference of the last half minute, the lower envelope, belongs to the fastest
message. Its delay remains as a bias. All components of a vehicle share the radio, so the
bias cancels between a sample and its pose, which is where it would hurt; that is also why
TIMESYNC, which could remove it for the one component that answers, only bounds the
uncertainty here. The window bounds what a drifting clock may do: 1e-4 (recorded autopilots in
simulation drift by 1.3e-4) moves the map by at most 3 ms.

SYSTEM_TIME is one more pair of times, never an authority: autopilots send it as zero before
a fix and some 300 ms behind arrival afterwards. Times since boot and Unix times are told
apart by size, as MAVLink does, and mapped separately, even of one sender.

Steps: a reboot puts the sender's time back, a first fix may put it forward. One odd message
proves neither, so a step counts once a few consecutive messages agree on the new offset
over some time; messages in between have no station time and are reported as unsettled.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from groundstation.measurement.settings import MeasurementSettings

UNIX_FROM_USEC = 1_000_000_000_000_000
"""Larger times are Unix microseconds (September 2001), smaller ones microseconds since boot."""

WRAP_MS = 1 << 32
_WRAP_NEAR_MS = 600_000
_BUCKETS = 12
_AGREE_NS = 1_000_000_000
_TIMESYNC_ROUND_TRIP_MAX_NS = 5_000_000_000


class StepKind(StrEnum):
    """How a sender's clock left its map."""

    REBOOT = "reboot"
    """Its time went back."""
    FORWARD = "forward"
    """Its time jumped ahead."""
    STALL = "stall"
    """Its time stood still for a while and went on."""


@dataclass(frozen=True, slots=True)
class ClockStep:
    """A confirmed step of a sender's clock."""

    kind: StepKind
    change_ns: int
    """New offset minus old offset."""


class OffsetMap:
    """Offset of one time scale of one sender, from pairs of (sender, arrival) time.

    All times and offsets are integer nanoseconds, so that a replay is exact.
    """

    __slots__ = (
        "_agreeing",
        "_backward_ns",
        "_bucket_ns",
        "_candidate_first_ns",
        "_candidate_ns",
        "_confirm_count",
        "_confirm_ns",
        "_forward_ns",
        "_lowest",
        "_min_delay_ns",
        "_newest_sender_ns",
        "_timesync_lower_ns",
        "_timesync_ns",
        "_window_ns",
        "offset_ns",
        "step",
        "strays",
    )

    def __init__(self, settings: MeasurementSettings) -> None:
        self._bucket_ns = max(1, round(settings.clock_window_s * 1e9 / _BUCKETS))
        self._window_ns = self._bucket_ns * _BUCKETS
        self._forward_ns = round(settings.clock_forward_step_s * 1e9)
        self._backward_ns = round(settings.clock_backward_step_s * 1e9)
        self._confirm_count = settings.clock_confirm_count
        self._confirm_ns = round(settings.clock_confirm_s * 1e9)
        self._min_delay_ns = round(settings.clock_min_delay_s * 1e9)
        self.offset_ns: int | None = None
        """Station time minus sender time; None before the first message."""
        self.step: ClockStep | None = None
        """The step that the newest message confirmed, if it did."""
        self.strays = 0
        """Messages that disagreed with the map and were not followed by a step, since the last step."""
        self._lowest: list[list[int]] = []
        self._newest_sender_ns = 0
        self._candidate_ns: int | None = None
        self._candidate_first_ns = 0
        self._agreeing = 0
        self._timesync_lower_ns: int | None = None
        self._timesync_ns = 0

    def observe(self, sender_ns: int, arrival_ns: int) -> int | None:
        """Take in one message; returns its station time, or None while a step is unconfirmed."""
        self.step = None
        found_ns = arrival_ns - sender_ns
        offset_ns = self.offset_ns
        if offset_ns is None:
            self._begin(found_ns, sender_ns, arrival_ns)
            return arrival_ns
        if -self._forward_ns <= found_ns - offset_ns <= self._backward_ns:
            if self._candidate_ns is not None:
                self.strays += self._agreeing
                self._candidate_ns = None
            self._newest_sender_ns = max(self._newest_sender_ns, sender_ns)
            self._note_lowest(found_ns, arrival_ns)
            assert self.offset_ns is not None
            return sender_ns + self.offset_ns
        return self._suspect(found_ns, sender_ns, arrival_ns)

    def timesync(self, sender_ns: int, sent_ns: int, arrival_ns: int) -> bool:
        """An answered TIMESYNC bounds the offset from below; returns whether it is believable."""
        if self.offset_ns is None or not 0 <= arrival_ns - sent_ns <= _TIMESYNC_ROUND_TRIP_MAX_NS:
            return False
        lower_ns = sent_ns - sender_ns
        if not -self._forward_ns <= self.offset_ns - lower_ns <= self._backward_ns:
            return False
        kept_ns = self._timesync_lower_ns
        if kept_ns is None or lower_ns > kept_ns or arrival_ns - self._timesync_ns > self._window_ns:
            self._timesync_lower_ns = lower_ns
            self._timesync_ns = arrival_ns
        return True

    def uncertainty_ns(self) -> int:
        """How far ``offset_ns`` may be off, by TIMESYNC where one was answered within the window.

        Elsewhere the assumed delay of the fastest message and the spread of the window's fastest ones.
        """
        if self.offset_ns is None:
            return self._window_ns
        if self._timesync_lower_ns is not None:
            # The clock drifts on: an old bound says nothing of an offset that has moved past it.
            newest_ns = self._lowest[-1][0] * self._bucket_ns
            if newest_ns - self._timesync_ns <= self._window_ns:
                return abs(self.offset_ns - self._timesync_lower_ns)
        lowest = [bucket[1] for bucket in self._lowest]
        return self._min_delay_ns + (max(lowest) - min(lowest) if lowest else 0)

    def _begin(self, offset_ns: int, sender_ns: int, arrival_ns: int) -> None:
        self.offset_ns = offset_ns
        self._lowest = [[arrival_ns // self._bucket_ns, offset_ns]]
        self._newest_sender_ns = sender_ns
        self._candidate_ns = None
        self._timesync_lower_ns = None
        self.strays = 0

    def _note_lowest(self, found_ns: int, arrival_ns: int) -> None:
        bucket = arrival_ns // self._bucket_ns
        lowest = self._lowest
        if lowest[-1][0] == bucket:
            if found_ns < lowest[-1][1]:
                lowest[-1][1] = found_ns
                assert self.offset_ns is not None
                self.offset_ns = min(self.offset_ns, found_ns)
            return
        lowest.append([bucket, found_ns])
        if lowest[0][0] <= bucket - _BUCKETS:
            self._lowest = lowest = [kept for kept in lowest if kept[0] > bucket - _BUCKETS]
        self.offset_ns = min(kept[1] for kept in lowest)

    def _suspect(self, found_ns: int, sender_ns: int, arrival_ns: int) -> int | None:
        if self._candidate_ns is None or abs(found_ns - self._candidate_ns) > _AGREE_NS:
            if self._candidate_ns is not None:
                self.strays += self._agreeing
            self._candidate_ns = found_ns
            self._candidate_first_ns = arrival_ns
            self._agreeing = 1
            return None
        self._agreeing += 1
        self._candidate_ns = min(self._candidate_ns, found_ns)
        spanned_ns = arrival_ns - self._candidate_first_ns
        if self._agreeing < self._confirm_count or spanned_ns < self._confirm_ns:
            return None
        assert self.offset_ns is not None
        change_ns = self._candidate_ns - self.offset_ns
        if change_ns < 0:
            kind = StepKind.FORWARD
        else:
            kind = StepKind.REBOOT if sender_ns < self._newest_sender_ns else StepKind.STALL
        self._begin(self._candidate_ns, sender_ns, arrival_ns)
        self.step = ClockStep(kind, change_ns)
        return sender_ns + self.offset_ns

    def state(self) -> dict[str, Any]:
        """Everything, as a tree for a snapshot."""
        return {
            "offset_ns": self.offset_ns,
            "strays": self.strays,
            "lowest": [list(bucket) for bucket in self._lowest],
            "newest_sender_ns": self._newest_sender_ns,
            "candidate_ns": self._candidate_ns,
            "candidate_first_ns": self._candidate_first_ns,
            "agreeing": self._agreeing,
            "timesync_lower_ns": self._timesync_lower_ns,
            "timesync_ns": self._timesync_ns,
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state()`` gave."""
        self.offset_ns = tree["offset_ns"]
        self.step = None
        self.strays = tree["strays"]
        self._lowest = [list(bucket) for bucket in tree["lowest"]]
        self._newest_sender_ns = tree["newest_sender_ns"]
        self._candidate_ns = tree["candidate_ns"]
        self._candidate_first_ns = tree["candidate_first_ns"]
        self._agreeing = tree["agreeing"]
        self._timesync_lower_ns = tree["timesync_lower_ns"]
        self._timesync_ns = tree["timesync_ns"]


class SenderClock:
    """Clock of one (system, component): a map for times since boot and one for Unix times."""

    __slots__ = ("_last_boot_ms", "_wraps", "boot", "unix")

    def __init__(self, settings: MeasurementSettings) -> None:
        self.boot = OffsetMap(settings)
        """Map of times since boot."""
        self.unix = OffsetMap(settings)
        """Map of Unix times."""
        self._last_boot_ms = 0
        self._wraps = 0

    def boot_ns(self, boot_ms: int) -> int:
        """Nanoseconds since boot of a 32-bit millisecond counter, which wraps after 49.7 days."""
        wraps = self._wraps
        if boot_ms < _WRAP_NEAR_MS and self._last_boot_ms > WRAP_MS - _WRAP_NEAR_MS:
            self._wraps = wraps = wraps + 1
        elif wraps and boot_ms > WRAP_MS - _WRAP_NEAR_MS and self._last_boot_ms < _WRAP_NEAR_MS:
            return (boot_ms + (wraps - 1) * WRAP_MS) * 1_000_000
        self._last_boot_ms = boot_ms
        return (boot_ms + wraps * WRAP_MS) * 1_000_000

    def map_of_usec(self, time_usec: int) -> OffsetMap:
        """The map that a ``time_usec`` belongs to, by its size."""
        return self.unix if time_usec >= UNIX_FROM_USEC else self.boot

    def observe_usec(self, time_usec: int, arrival_ns: int) -> int | None:
        """Take in a message stamped in microseconds; its station time, None while unsettled."""
        scale = self.unix if time_usec >= UNIX_FROM_USEC else self.boot
        return scale.observe(time_usec * 1000, arrival_ns)

    def observe_boot_ms(self, boot_ms: int, arrival_ns: int) -> int | None:
        """Take in a message stamped in milliseconds since boot; its station time, None while unsettled."""
        station_ns = self.boot.observe(self.boot_ns(boot_ms), arrival_ns)
        step = self.boot.step
        if step is not None and step.kind is StepKind.REBOOT:
            self._wraps = 0
        return station_ns

    def state(self) -> dict[str, Any]:
        """Everything, as a tree for a snapshot."""
        return {
            "boot": self.boot.state(),
            "unix": self.unix.state(),
            "last_boot_ms": self._last_boot_ms,
            "wraps": self._wraps,
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state()`` gave."""
        self.boot.restore(tree["boot"])
        self.unix.restore(tree["unix"])
        self._last_boot_ms = tree["last_boot_ms"]
        self._wraps = tree["wraps"]
