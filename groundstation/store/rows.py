"""Outputs as rows: one statement and its values for each kind.

Rule: each statement may run twice for the same output and the second changes nothing.
"""

from __future__ import annotations

import math
from typing import Any

from groundstation.domain.command import CommandStatus
from groundstation.domain.events import Event
from groundstation.domain.inputs import OperatorInput
from groundstation.domain.target import LinkVerdict, TargetState

_MINUTE_NS = 60_000_000_000


def _insert(table: str, columns: str) -> str:
    marks = ", ".join("?" * len(columns.split(",")))
    return f"INSERT INTO {table} ({columns}) VALUES ({marks}) ON CONFLICT DO NOTHING"


_EVENT = _insert("events", "time_ns, code, severity, text, vehicle_id, beacon_id")
FORGET_TARGETS = "DELETE FROM targets WHERE time_ns > ?"
_TARGET = _insert(
    "targets",
    "beacon_id, sequence, time_ns, first_heard_ns, last_heard_ns, latitude_deg, longitude_deg, "
    "altitude_amsl_m, covariance_ee_m2, covariance_en_m2, covariance_eu_m2, covariance_nn_m2, "
    "covariance_nu_m2, covariance_uu_m2, "
    "radius_90_m, environment, los_links, links, windows, method, height_reference",
)
_COMMAND = _insert(
    "commands",
    "command_id, vehicle_id, kind, phase, time_ns, detail, latitude_deg, longitude_deg, altitude_amsl_m, "
    "proposal_id, attempts",
)
_OPERATOR = _insert("operator_actions", "seq, time_ns, who, decision, proposal_id, vehicle_id")
# A verdict that is not newer than the minute's last one came before: from the replayed tail.
_VERDICT = """
    INSERT INTO link_minutes VALUES (?, ?, ?, ?, 1, ?, ?, ?, ?, ?, ?, ?)
    ON CONFLICT (vehicle_id, beacon_id, minute_ns) DO UPDATE SET
        last_ns = excluded.last_ns,
        windows = windows + 1,
        captures = captures + excluded.captures,
        los_probability_sum = los_probability_sum + excluded.los_probability_sum,
        los_probability_last = excluded.los_probability_last,
        los_probability_min = min(los_probability_min, excluded.los_probability_min),
        los_probability_max = max(los_probability_max, excluded.los_probability_max),
        source = excluded.source,
        rss_dbm_last = excluded.rss_dbm_last
    WHERE excluded.last_ns > last_ns
"""


def event_row(event: Event) -> tuple[str, tuple[Any, ...]]:
    """Row of ``events``."""
    beacon = None if event.beacon_id is None else str(event.beacon_id)
    values = (event.time_ns, event.code, event.severity.value, event.text, event.vehicle_id, beacon)
    return _EVENT, values


def target_row(target: TargetState) -> tuple[str, tuple[Any, ...]]:
    """Row of ``targets``; numbers that are not finite become NULL."""
    return _TARGET, (
        str(target.beacon_id),
        target.sequence,
        target.time_ns,
        target.first_heard_ns,
        target.last_heard_ns,
        target.position.latitude_deg,
        target.position.longitude_deg,
        target.position.altitude_amsl_m,
        *(_finite(value) for value in target.covariance_enu_m2),
        _finite(target.radius_90_m),
        target.environment.name,
        target.los_links,
        target.links,
        target.windows,
        target.method,
        target.height_reference,
    )


def command_row(status: CommandStatus) -> tuple[str, tuple[Any, ...]]:
    """Row of ``commands``."""
    place = status.target
    return _COMMAND, (
        status.command_id,
        status.vehicle_id,
        status.kind.value,
        status.phase.value,
        status.time_ns,
        status.detail,
        None if place is None else place.latitude_deg,
        None if place is None else place.longitude_deg,
        None if place is None else place.altitude_amsl_m,
        status.proposal_id,
        status.attempts,
    )


def operator_row(seq: int, time_ns: int, action: OperatorInput) -> tuple[str, tuple[Any, ...]]:
    """Row of ``operator_actions``."""
    values = (seq, time_ns, action.who, action.decision.value, action.proposal_id, action.vehicle_id)
    return _OPERATOR, values


def verdict_row(verdict: LinkVerdict) -> tuple[str, tuple[Any, ...]]:
    """Adds one verdict to its minute of ``link_minutes``."""
    probability = verdict.los_probability
    return _VERDICT, (
        verdict.vehicle_id,
        str(verdict.beacon_id),
        verdict.time_ns // _MINUTE_NS * _MINUTE_NS,
        verdict.time_ns,
        verdict.captures,
        probability,
        probability,
        probability,
        probability,
        verdict.source.value,
        _finite(verdict.rss_dbm),
    )


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
