"""What the server asks of the database. Each call is bounded and blocks shortly.

Rule: readers have a connection of their own, read-only, and give values, not cursors. Call
from a worker thread, not from the event loop.
"""

from __future__ import annotations

import sqlite3
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from groundstation.domain.errors import ResourceError
from groundstation.domain.events import Event, Severity

MAX_ROWS = 10_000
"""Largest answer; page on with a time."""


@dataclass(frozen=True, slots=True)
class TargetPoint:
    """One belief of a beacon's history."""

    time_ns: int
    """Station time."""
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    radius_90_m: float | None
    links: int
    windows: int


class Queries:
    """Read-only questions; may be called from several threads."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._connection: sqlite3.Connection | None = None

    def events_before(self, time_ns: int, limit: int = 200) -> list[Event]:
        """The newest events before station time ``time_ns``, oldest first."""
        sql = (
            "SELECT time_ns, code, severity, text, vehicle_id, beacon_id FROM events "
            "WHERE time_ns < ? ORDER BY id DESC LIMIT ?"
        )
        return [_event(row) for row in reversed(self._ask(sql, (time_ns, _bounded(limit))))]

    def target_curve(self, beacon_id: int, since_ns: int = 0, limit: int = 200) -> list[TargetPoint]:
        """At most ``limit`` beliefs after ``since_ns``, evenly in time, oldest first, the newest last."""
        spans = self._ask(
            "SELECT min(time_ns), max(time_ns) FROM targets WHERE beacon_id = ? AND time_ns > ?",
            (str(beacon_id), since_ns),
        )
        first, last = spans[0]
        if first is None:
            return []
        # Counted from the newest: of each span of time its last belief.
        span_ns = (last - first) // max(_bounded(limit), 1) + 1
        sql = (
            "SELECT *, max(time_ns) FROM targets WHERE beacon_id = ? AND time_ns > ? "
            "GROUP BY (? - time_ns) / ? ORDER BY time_ns, sequence"
        )
        return [_point(row) for row in self._ask(sql, (str(beacon_id), since_ns, last, span_ns))]

    def close(self) -> None:
        """Close the connection; a later question opens it again."""
        with self._lock:
            if self._connection is not None:
                self._connection.close()
                self._connection = None

    def _ask(self, sql: str, values: tuple[Any, ...]) -> list[sqlite3.Row]:
        with self._lock:
            try:
                if self._connection is None:
                    self._connection = sqlite3.connect(
                        f"{self._path.absolute().as_uri()}?mode=ro", uri=True, check_same_thread=False
                    )
                    self._connection.row_factory = sqlite3.Row
                return self._connection.execute(sql, values).fetchall()
            except sqlite3.Error as error:
                raise ResourceError(f"cannot read {self._path}: {error}") from error


def _bounded(limit: int) -> int:
    return max(0, min(limit, MAX_ROWS))


def _event(row: sqlite3.Row) -> Event:
    beacon = None if row["beacon_id"] is None else int(row["beacon_id"])
    severity = Severity(row["severity"])
    return Event(row["time_ns"], row["code"], severity, row["text"], row["vehicle_id"], beacon)


def _point(row: sqlite3.Row) -> TargetPoint:
    return TargetPoint(
        time_ns=row["time_ns"],
        latitude_deg=row["latitude_deg"],
        longitude_deg=row["longitude_deg"],
        altitude_amsl_m=row["altitude_amsl_m"],
        radius_90_m=row["radius_90_m"],
        links=row["links"],
        windows=row["windows"],
    )
