"""A telemetry radio that loses, delays, repeats and damages frames, by a seed.

Keeps the rule that time is an argument: frames come out when the caller's time says so, in the
order they went in (a radio does not reorder).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from sim_sitl.randomness import Stream, generator

MAX_QUEUED = 8192
"""Frames on their way; more are lost, counted."""


@dataclass(frozen=True, slots=True)
class LinkQuality:
    """What one direction of a radio does to frames."""

    loss: float = 0.0
    """Probability that a frame is lost."""
    delay_s: float = 0.0
    jitter_s: float = 0.0
    """Added to the delay, uniform from 0."""
    duplication: float = 0.0
    """Probability that a frame comes twice."""
    corruption: float = 0.0
    """Probability that one byte of a frame is damaged."""


class LossyLink:
    """One direction of one vehicle's radio."""

    def __init__(self, quality: LinkQuality, seed: int, *key: int) -> None:
        self._quality = quality
        self._rng = generator(seed, Stream.LOSSY_LINK, *key)
        self._queue: deque[tuple[float, bytes]] = deque()
        self._last_due_s = 0.0
        self.lost = self.duplicated = self.corrupted = self.overflowed = 0

    def offer(self, time_s: float, frame: bytes) -> None:
        """A frame is given to the radio at ``time_s``."""
        quality = self._quality
        lost, twice, damaged, jitter, where = self._rng.random(5)
        if lost < quality.loss:
            self.lost += 1
            return
        if damaged < quality.corruption:
            self.corrupted += 1
            index = int(where * len(frame))
            frame = frame[:index] + bytes([frame[index] ^ 0x55]) + frame[index + 1 :]
        self._last_due_s = max(self._last_due_s, time_s + quality.delay_s + quality.jitter_s * float(jitter))
        copies = 1
        if twice < quality.duplication:
            self.duplicated += 1
            copies = 2
        for _ in range(copies):
            if len(self._queue) >= MAX_QUEUED:
                self.overflowed += 1
            else:
                self._queue.append((self._last_due_s, frame))

    def due(self, time_s: float) -> list[bytes]:
        """Frames that have arrived by ``time_s``."""
        arrived: list[bytes] = []
        while self._queue and self._queue[0][0] <= time_s:
            arrived.append(self._queue.popleft()[1])
        return arrived
