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
"""Largest answer; page on with ``before_id`` or ``since_ns``."""


@dataclass(frozen=True, slots=True)
class StoredEvent:
    """An event with its place in the log."""

    event_id: int
    """Grows in the order of writing; the page asks for those before one it has."""
    event: Event


@dataclass(frozen=True, slots=True)
class TargetPoint:
    """One belief of a beacon's history."""

    beacon_id: int
    sequence: int
    time_ns: int
    """Station time."""
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    covariance_enu_m2: tuple[float | None, ...]
    """EE, EN, EU, NN, NU, UU; None where it was not finite."""
    radius_90_m: float | None
    environment: str
    """``LOS``, ``MIXED``, ``NLOS`` or ``UNKNOWN``."""
    los_links: int
    links: int
    windows: int
    method: str
    height_reference: str


@dataclass(frozen=True, slots=True)
class LinkMinute:
    """What was said of one link within one minute."""

    vehicle_id: int
    beacon_id: int
    minute_ns: int
    """Station time at which the minute began."""
    windows: int
    captures: int
    los_probability_mean: float
    los_probability_last: float
    los_probability_min: float
    los_probability_max: float
    source: str
    """Of the last verdict: ``classifier``, ``sensor`` or ``prior``."""
    rss_dbm_last: float | None


class Queries:
    """Read-only questions; may be called from several threads."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._connection: sqlite3.Connection | None = None

    def recent_events(self, limit: int = 200, before_id: int | None = None) -> list[StoredEvent]:
        """The newest events, newest first, written before the event ``before_id``."""
        sql = (
            "SELECT id, time_ns, code, severity, text, vehicle_id, beacon_id FROM events "
            "WHERE id < ? ORDER BY id DESC LIMIT ?"
        )
        return [_event(row) for row in self._ask(sql, (before_id or 2**62, _bounded(limit)))]

    def events_before(self, time_ns: int, limit: int = 200) -> list[Event]:
        """The newest events before station time ``time_ns``, oldest first."""
        sql = (
            "SELECT id, time_ns, code, severity, text, vehicle_id, beacon_id FROM events "
            "WHERE time_ns < ? ORDER BY id DESC LIMIT ?"
        )
        return [_event(row).event for row in reversed(self._ask(sql, (time_ns, _bounded(limit))))]

    def target_history(
        self, beacon_id: int, since_ns: int = 0, until_ns: int = 2**62, limit: int = 1000
    ) -> list[TargetPoint]:
        """Beliefs of one beacon with ``since_ns`` < time ≤ ``until_ns``, oldest first."""
        sql = (
            "SELECT * FROM targets WHERE beacon_id = ? AND time_ns > ? AND time_ns <= ? "
            "ORDER BY time_ns, sequence LIMIT ?"
        )
        return [_point(row) for row in self._ask(sql, (str(beacon_id), since_ns, until_ns, _bounded(limit)))]

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

    def beacon_ids(self) -> list[int]:
        """Every beacon that ever had an estimate in this session."""
        found = self._ask("SELECT DISTINCT beacon_id FROM targets", ())
        return sorted(int(row["beacon_id"]) for row in found)

    def command_log(self, limit: int = 200, before_id: int | None = None) -> list[dict[str, Any]]:
        """The newest steps of commands, newest first: the columns of ``commands``."""
        sql = "SELECT * FROM commands WHERE id < ? ORDER BY id DESC LIMIT ?"
        return [dict(row) for row in self._ask(sql, (before_id or 2**62, _bounded(limit)))]

    def operator_log(self, limit: int = 200, before_seq: int | None = None) -> list[dict[str, Any]]:
        """The newest actions of operators, newest first: the columns of ``operator_actions``."""
        sql = "SELECT * FROM operator_actions WHERE seq < ? ORDER BY seq DESC LIMIT ?"
        return [dict(row) for row in self._ask(sql, (before_seq or 2**62, _bounded(limit)))]

    def link_minutes(self, vehicle_id: int, beacon_id: int, limit: int = 60) -> list[LinkMinute]:
        """The newest minutes of one link, newest first."""
        sql = (
            "SELECT * FROM link_minutes WHERE vehicle_id = ? AND beacon_id = ? "
            "ORDER BY minute_ns DESC LIMIT ?"
        )
        return [_minute(row) for row in self._ask(sql, (vehicle_id, str(beacon_id), _bounded(limit)))]

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


def _event(row: sqlite3.Row) -> StoredEvent:
    beacon = None if row["beacon_id"] is None else int(row["beacon_id"])
    severity = Severity(row["severity"])
    event = Event(row["time_ns"], row["code"], severity, row["text"], row["vehicle_id"], beacon)
    return StoredEvent(row["id"], event)


def _point(row: sqlite3.Row) -> TargetPoint:
    covariance = tuple(row[f"covariance_{axes}_m2"] for axes in ("ee", "en", "eu", "nn", "nu", "uu"))
    return TargetPoint(
        beacon_id=int(row["beacon_id"]),
        sequence=row["sequence"],
        time_ns=row["time_ns"],
        latitude_deg=row["latitude_deg"],
        longitude_deg=row["longitude_deg"],
        altitude_amsl_m=row["altitude_amsl_m"],
        covariance_enu_m2=covariance,
        radius_90_m=row["radius_90_m"],
        environment=row["environment"],
        los_links=row["los_links"],
        links=row["links"],
        windows=row["windows"],
        method=row["method"],
        height_reference=row["height_reference"],
    )


def _minute(row: sqlite3.Row) -> LinkMinute:
    return LinkMinute(
        vehicle_id=row["vehicle_id"],
        beacon_id=int(row["beacon_id"]),
        minute_ns=row["minute_ns"],
        windows=row["windows"],
        captures=row["captures"],
        los_probability_mean=row["los_probability_sum"] / row["windows"],
        los_probability_last=row["los_probability_last"],
        los_probability_min=row["los_probability_min"],
        los_probability_max=row["los_probability_max"],
        source=row["source"],
        rss_dbm_last=row["rss_dbm_last"],
    )
