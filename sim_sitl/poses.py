"""Poses of a vehicle that is not ours, from its telemetry: for overlay.py and attach.py.

Keeps the rule that a pose is only given between (or shortly after) two that were heard: a
sensor on a vehicle that nobody has located hears nothing.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field

from groundstation.domain.geometry import Enu, Geodetic, LocalFrame, Quaternion

MAX_GAP_S = 2.0
"""Longer gaps between two positions are not bridged."""
LEVEL: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(slots=True)
class PoseTrack:
    """Positions and attitudes of one vehicle, in order of time (seconds)."""

    position_s: list[float] = field(default_factory=list)
    position: list[Geodetic] = field(default_factory=list)
    attitude_s: list[float] = field(default_factory=list)
    attitude: list[Quaternion] = field(default_factory=list)

    def add_position(self, time_s: float, place: Geodetic) -> None:
        """A position; one that is not newer than the last is left out."""
        if not self.position_s or time_s > self.position_s[-1]:
            self.position_s.append(time_s)
            self.position.append(place)

    def add_attitude(self, time_s: float, attitude: Quaternion) -> None:
        """An attitude; one that is not newer than the last is left out."""
        if not self.attitude_s or time_s > self.attitude_s[-1]:
            self.attitude_s.append(time_s)
            self.attitude.append(attitude)

    def forget_before(self, time_s: float) -> None:
        """Bound the memory of a live track."""
        for times, values in ((self.position_s, self.position), (self.attitude_s, self.attitude)):
            count = bisect_right(times, time_s)
            if count > 64:
                del times[: count - 2]
                del values[: count - 2]

    def at(self, time_s: float, frame: LocalFrame) -> tuple[Enu, Quaternion] | None:
        """(ENU metres, attitude) at ``time_s``; None where no two positions are near."""
        after = bisect_right(self.position_s, time_s)
        if len(self.position_s) < 2 or after == 0:
            return None
        after = min(after, len(self.position_s) - 1)
        first, last = self.position_s[after - 1], self.position_s[after]
        if last - first > MAX_GAP_S or time_s - last > MAX_GAP_S:
            return None
        share = (time_s - first) / (last - first)
        a, b = frame.to_enu(self.position[after - 1]), frame.to_enu(self.position[after])
        position = tuple(p + share * (q - p) for p, q in zip(a, b, strict=True))
        return (position[0], position[1], position[2]), self._attitude_at(time_s)

    def _attitude_at(self, time_s: float) -> Quaternion:
        if not self.attitude_s:
            return LEVEL
        after = bisect_right(self.attitude_s, time_s)
        if after in (0, len(self.attitude_s)):
            return self.attitude[0 if after == 0 else -1]
        first, last = self.attitude_s[after - 1], self.attitude_s[after]
        return _blend(self.attitude[after - 1], self.attitude[after], (time_s - first) / (last - first))


def _blend(a: Quaternion, b: Quaternion, share: float) -> Quaternion:
    """Normalised linear interpolation along the shorter way: a tenth of a second apart it is slerp."""
    sign = 1.0 if sum(p * q for p, q in zip(a, b, strict=True)) >= 0.0 else -1.0
    mixed = [(1 - share) * p + share * sign * q for p, q in zip(a, b, strict=True)]
    norm = math.sqrt(sum(x * x for x in mixed))
    return mixed[0] / norm, mixed[1] / norm, mixed[2] / norm, mixed[3] / norm
