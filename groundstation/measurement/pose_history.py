"""Where a vehicle was, at any recent instant of its own clock.

Why: position (about 5 Hz) and attitude (about 10 Hz) come in different messages, and a radio
sample falls between them. Position is interpolated linearly, attitude along the great circle.

Rule: nothing is guessed. A time not covered yet is answered ``NOT_YET`` and the sample waits;
only who waited in vain may ask to extrapolate, and then by no more than the setting.
"""

from __future__ import annotations

import math
from bisect import bisect_right, insort
from enum import StrEnum
from typing import Any, NamedTuple

from groundstation.domain.geometry import Quaternion
from groundstation.measurement.angles import slerp
from groundstation.measurement.settings import MeasurementSettings

Row = tuple[float, ...]

_RADIANS_PER_DEGREE = math.pi / 180.0
_METRES_PER_DEGREE = 6_378_137.0 * _RADIANS_PER_DEGREE


class PoseOutcome(StrEnum):
    """Why there is no pose at the time asked for."""

    NOT_YET = "pose_not_yet"
    """Newer than the newest pose."""
    TOO_OLD = "pose_too_old"
    """Older than the oldest pose kept, or the newest one stayed too far behind."""
    GAP = "pose_gap"
    """Between two poses too far apart."""
    MISSING = "pose_missing"
    """No pose was ever heard."""


class Pose(NamedTuple):
    """A vehicle's pose at one instant."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    attitude: Quaternion | None
    """None where no attitude covers the instant."""


class _Track:
    """Rows of numbers by time, in order, bounded."""

    __slots__ = ("limit", "rows", "times")

    def __init__(self, limit: int) -> None:
        self.limit = max(2, limit)
        self.times: list[int] = []
        self.rows: list[Row] = []

    def add(self, time_ns: int, row: Row) -> bool:
        """Keep ``row``; False where the time is already taken."""
        times = self.times
        if not times or time_ns > times[-1]:
            times.append(time_ns)
            self.rows.append(row)
        else:
            at = bisect_right(times, time_ns)
            if at and times[at - 1] == time_ns:
                return False
            insort(times, time_ns)
            self.rows.insert(at, row)
        # Cut in one go: shifting the lists for every message would cost more than the rest.
        if len(times) >= 2 * self.limit:
            del times[: -self.limit]
            del self.rows[: -self.limit]
        return True

    def bracket(self, time_ns: int, gap_ns: int, beyond_ns: int) -> tuple[int, int, float] | PoseOutcome:
        """Indices of the rows round ``time_ns`` and the fraction between them (beyond [0, 1] if allowed)."""
        times = self.times
        if not times:
            return PoseOutcome.MISSING
        at = bisect_right(times, time_ns)
        if at == len(times):
            past_ns = time_ns - times[-1]
            if past_ns > beyond_ns:
                return PoseOutcome.NOT_YET
            if past_ns == 0 or at == 1 or times[-1] - times[-2] > gap_ns:
                return at - 1, at - 1, 0.0
            return at - 2, at - 1, (time_ns - times[-2]) / (times[-1] - times[-2])
        if at == 0:
            return (0, 0, 0.0) if times[0] - time_ns <= beyond_ns else PoseOutcome.TOO_OLD
        before_ns = times[at - 1]
        if before_ns == time_ns:
            return at - 1, at - 1, 0.0
        width_ns = times[at] - before_ns
        if width_ns > gap_ns:
            return PoseOutcome.GAP
        return at - 1, at, (time_ns - before_ns) / width_ns

    def state(self) -> dict[str, Any]:
        return {"times": list(self.times), "rows": [list(row) for row in self.rows]}

    def restore(self, tree: dict[str, Any]) -> None:
        self.times = list(tree["times"])
        self.rows = [tuple(row) for row in tree["rows"]]


class PoseHistory:
    """Positions and attitudes of one vehicle by time since its boot, nanoseconds."""

    __slots__ = ("_attitudes", "_beyond_ns", "_gap_ns", "_positions")

    def __init__(self, settings: MeasurementSettings) -> None:
        self._positions = _Track(settings.pose_history)
        self._attitudes = _Track(settings.pose_history)
        self._gap_ns = round(settings.pose_gap_s * 1e9)
        self._beyond_ns = round(settings.pose_extrapolate_s * 1e9)

    def add_position(
        self, boot_ns: int, latitude_deg: float, longitude_deg: float, altitude_amsl_m: float
    ) -> bool:
        """Keep a position; False where one of that time is already kept."""
        return self._positions.add(boot_ns, (latitude_deg, longitude_deg, altitude_amsl_m))

    def add_attitude(self, boot_ns: int, attitude: Quaternion) -> bool:
        """Keep an attitude; False where one of that time is already kept."""
        return self._attitudes.add(boot_ns, attitude)

    def covered_ns(self) -> int | None:
        """Newest time that both position and attitude cover; None before both were heard."""
        positions, attitudes = self._positions.times, self._attitudes.times
        if not positions or not attitudes:
            return None
        return min(positions[-1], attitudes[-1])

    def at(self, boot_ns: int, *, final: bool = False) -> Pose | PoseOutcome:
        """Pose at ``boot_ns``, or why there is none.

        ``final`` is asked by a sample that waited long enough: then the newest pose may be
        carried on by ``pose_extrapolate_s`` along its last velocity, and a missing attitude
        does not withhold the position.
        """
        beyond_ns = self._beyond_ns if final else 0
        found = self._positions.bracket(boot_ns, self._gap_ns, beyond_ns)
        if isinstance(found, PoseOutcome):
            return PoseOutcome.TOO_OLD if final and found is PoseOutcome.NOT_YET else found
        turned = self._attitudes.bracket(boot_ns, self._gap_ns, beyond_ns)
        attitude: Quaternion | None = None
        if not isinstance(turned, PoseOutcome):
            low, high, fraction = turned
            rows = self._attitudes.rows
            # An airframe's turn is not carried on: it would overshoot where a position does not.
            attitude = _quaternion(
                rows[low]
                if low == high
                else slerp(_quaternion(rows[low]), _quaternion(rows[high]), min(fraction, 1.0))
            )
        elif not final and turned in {PoseOutcome.NOT_YET, PoseOutcome.MISSING}:
            return PoseOutcome.NOT_YET
        low, high, fraction = found
        a = self._positions.rows[low]
        if low == high:
            return Pose(a[0], a[1], a[2], attitude)
        b = self._positions.rows[high]
        east_deg = b[1] - a[1]
        if abs(east_deg) > 180.0:
            east_deg -= math.copysign(360.0, east_deg)
        longitude = a[1] + fraction * east_deg
        if abs(longitude) > 180.0:
            longitude -= math.copysign(360.0, longitude)
        return Pose(a[0] + fraction * (b[0] - a[0]), longitude, a[2] + fraction * (b[2] - a[2]), attitude)

    def clear(self) -> None:
        """Forget everything: the vehicle's clock began anew."""
        self._positions = _Track(self._positions.limit)
        self._attitudes = _Track(self._attitudes.limit)

    def state(self) -> dict[str, Any]:
        """Everything, as a tree for a snapshot."""
        return {"positions": self._positions.state(), "attitudes": self._attitudes.state()}

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state()`` gave."""
        self._positions.restore(tree["positions"])
        self._attitudes.restore(tree["attitudes"])


def flown_m(a: Pose, b: Pose) -> float:
    """Distance between two poses a short flight apart, metres (equirectangular, on a sphere)."""
    lat_a, lon_a, alt_a, _ = a
    lat_b, lon_b, alt_b, _ = b
    east_deg = (lon_b - lon_a + 180.0) % 360.0 - 180.0
    east = east_deg * _METRES_PER_DEGREE * math.cos(lat_a * _RADIANS_PER_DEGREE)
    return math.hypot((lat_b - lat_a) * _METRES_PER_DEGREE, east, alt_b - alt_a)


def _quaternion(row: Row) -> Quaternion:
    return row[0], row[1], row[2], row[3]
