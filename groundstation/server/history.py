"""How each beacon's estimate came about: few points over all the time, in bounded memory.

Exists because a replay has no database, and a page that is opened late wants the whole curve.
Rule: points are evenly spaced in time; when there are too many every second one goes, and from
then on they stand twice as far apart. The newest belief is always the last point.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from groundstation.domain.target import TargetState

_FIRST_SPACING_NS = 1_000_000_000


@dataclass(slots=True)
class _Curve:
    spacing_ns: int = _FIRST_SPACING_NS
    points: list[TargetState] = field(default_factory=list)
    newest: TargetState | None = None


class Histories:
    """Thinned beliefs of every beacon."""

    def __init__(self, beacons: int, points: int) -> None:
        """``beacons`` kept, the one not updated for longest gives way; ``points`` of each."""
        self._beacons = beacons
        self._points = max(points, 2)
        self._curves: dict[int, _Curve] = {}

    def add(self, state: TargetState) -> None:
        """The next belief of a beacon."""
        curve = self._curves.pop(state.beacon_id, None) or _Curve()
        self._curves[state.beacon_id] = curve
        if len(self._curves) > self._beacons:
            del self._curves[next(iter(self._curves))]
        curve.newest = state
        if curve.points and state.time_ns - curve.points[-1].time_ns < curve.spacing_ns:
            return
        curve.points.append(state)
        if len(curve.points) > self._points:
            curve.points = curve.points[::2]
            curve.spacing_ns *= 2

    def of(self, beacon_id: int, since_ns: int, limit: int) -> list[TargetState]:
        """At most ``limit`` beliefs later than ``since_ns``, oldest first, the newest among them."""
        curve = self._curves.get(beacon_id)
        if curve is None or curve.newest is None:
            return []
        found = [state for state in curve.points if since_ns < state.time_ns < curve.newest.time_ns]
        if curve.newest.time_ns > since_ns:
            found.append(curve.newest)
        step = -(-len(found) // limit)
        # Counted from the newest, so that it stays whatever the step is.
        return found[::-1][:: max(step, 1)][::-1]
