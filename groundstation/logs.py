"""Logs with event codes, from the first line: for people on a terminal, as JSON for machines."""

from __future__ import annotations

import logging
import sys
from datetime import UTC, datetime
from typing import Any

import orjson

from groundstation.domain.events import Event, Severity

_LEVELS = {Severity.INFO: logging.INFO, Severity.WARNING: logging.WARNING, Severity.ERROR: logging.ERROR}
_logger = logging.getLogger("groundstation.events")


def log_event(event: Event) -> None:
    """One line for one event."""
    _logger.log(
        _LEVELS[event.severity],
        "%s",
        event.text,
        extra={"code": event.code, "vehicle_id": event.vehicle_id, "beacon_id": event.beacon_id},
    )


class _Plain(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        moment = datetime.fromtimestamp(record.created, UTC).strftime("%H:%M:%SZ")
        code = getattr(record, "code", record.name.removeprefix("groundstation."))
        return f"{moment} {record.levelname.lower():7} {code:24} {record.getMessage()}"


class _Json(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        line: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(),
            "level": record.levelname.lower(),
            "code": getattr(record, "code", record.name),
            "text": record.getMessage(),
        }
        for name in ("vehicle_id", "beacon_id"):
            value = getattr(record, name, None)
            if value is not None:
                line[name] = str(value) if name == "beacon_id" else value
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return orjson.dumps(line).decode()


def set_up(*, json: bool, quiet: bool) -> None:
    """Logs go to stderr; ``quiet`` leaves warnings and errors."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Json() if json else _Plain())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
    logging.getLogger("groundstation").setLevel(logging.WARNING if quiet else logging.INFO)
