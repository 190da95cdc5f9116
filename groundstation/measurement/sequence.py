"""What sequence counters say: packets of a beacon that were lost, frames of a link that were.

Rule: a restart is not a loss. A counter that jumps further than the elapsed time can explain
began anew; one that steps back a little was overtaken on the way.
"""

from __future__ import annotations

from typing import Any

_REMEMBERED = 48
_ALL_HEARD = (1 << _REMEMBERED) - 1
_BURST = 64
_BUCKET_NS = 10_000_000_000
_BUCKETS = 6


class BeaconSequence:
    """A beacon's uint16 counter as one sensor sees it."""

    __slots__ = ("_heard", "_last", "_last_ns", "_rate_max_hz", "missed", "restarts")

    def __init__(self, rate_max_hz: float) -> None:
        self._rate_max_hz = rate_max_hz
        self._last: int | None = None
        self._last_ns = 0
        self._heard = _ALL_HEARD
        self.missed = 0
        """Lost packets not yet told: the caller takes them and sets 0. Negative: some came after all."""
        self.restarts = 0
        """Restarts seen, running total."""

    def observe(self, sequence: int, arrival_ns: int) -> None:
        """Take in the counter of a new packet (duplicates are sorted out before)."""
        last = self._last
        if last is None:
            self._begin(sequence, arrival_ns)
            return
        ahead = (sequence - last) & 0xFFFF
        if ahead == 1:
            self._heard = (self._heard << 1 | 1) & _ALL_HEARD
            self._last, self._last_ns = sequence, arrival_ns
            return
        if ahead == 0:
            return
        behind = 0x10000 - ahead
        if behind < _REMEMBERED:
            bit = 1 << behind
            if self._heard & bit:
                # A number already heard comes again with another time: the sensor began anew.
                self.restarts += 1
                self._begin(sequence, arrival_ns)
            else:
                self._heard |= bit
                self.missed -= 1
            return
        elapsed_ns = arrival_ns - self._last_ns
        if ahead < 0x8000 and ahead <= _BURST + self._rate_max_hz * elapsed_ns * 1e-9:
            self.missed += ahead - 1
            self._heard = (self._heard << ahead | 1) & _ALL_HEARD if ahead < _REMEMBERED else 1
            self._last, self._last_ns = sequence, arrival_ns
        else:
            self.restarts += 1
            self._begin(sequence, arrival_ns)

    def _begin(self, sequence: int, arrival_ns: int) -> None:
        self._last, self._last_ns = sequence, arrival_ns
        self._heard = _ALL_HEARD

    def state(self) -> list[Any]:
        """Everything, for a snapshot."""
        return [self._last, self._last_ns, self._heard, self.missed, self.restarts]

    def restore(self, kept: list[Any]) -> None:
        """Take back what ``state()`` gave."""
        self._last, self._last_ns, self._heard, self.missed, self.restarts = kept


class FrameLoss:
    """Share of a vehicle's frames lost over the last minute, from each component's uint8 counter."""

    __slots__ = ("_buckets", "_last")

    def __init__(self) -> None:
        self._last: dict[int, int] = {}
        self._buckets: list[list[int]] = []

    def observe(self, component_id: int, sequence: int, arrival_ns: int) -> None:
        """Take in the header of a frame."""
        buckets = self._buckets
        index = arrival_ns // _BUCKET_NS
        if not buckets or buckets[-1][0] != index:
            buckets.append([index, 0, 0])
            self._buckets = buckets = [kept for kept in buckets if kept[0] > index - _BUCKETS]
        bucket = buckets[-1]
        bucket[1] += 1
        last = self._last.get(component_id)
        if last is not None:
            ahead = (sequence - last) & 0xFF
            if ahead == 0 or ahead >= 128:
                return
            bucket[2] += ahead - 1
        self._last[component_id] = sequence

    def percent(self) -> float | None:
        """Lost frames of those sent, percent; None before any frame."""
        heard = sum(bucket[1] for bucket in self._buckets)
        lost = sum(bucket[2] for bucket in self._buckets)
        return 100.0 * lost / (heard + lost) if heard else None

    def state(self) -> dict[str, Any]:
        """Everything, as a tree for a snapshot."""
        return {
            "last": [list(item) for item in self._last.items()],
            "buckets": [list(b) for b in self._buckets],
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state()`` gave."""
        self._last = dict(tree["last"])
        self._buckets = [list(bucket) for bucket in tree["buckets"]]
