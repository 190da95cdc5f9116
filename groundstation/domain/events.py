"""What the operator or the log must know: events with codes, counters with names."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Severity(StrEnum):
    """How much it matters to the operator."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class Event:
    """Something happened. Never dropped on the way to the page."""

    time_ns: int
    code: str
    """Dotted and stable, for machines: ``vehicle.lost``, ``cir.incomplete``, …"""
    severity: Severity
    text: str
    """One line, for people."""
    vehicle_id: int | None = None
    beacon_id: int | None = None


@dataclass(frozen=True, slots=True)
class Counter:
    """A running total: each drop, late sample or rejection has one."""

    name: str
    """Prometheus style, ending in ``_total``: ``cir_incomplete_total``."""
    labels: tuple[tuple[str, str], ...]
    value: int
