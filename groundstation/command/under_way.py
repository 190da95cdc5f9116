"""A command under way and how its steps are told."""

from __future__ import annotations

from dataclasses import dataclass

from groundstation.command.protocol import Run
from groundstation.domain.command import CommandKind, CommandPhase, CommandStatus
from groundstation.domain.events import Event, Severity
from groundstation.domain.geometry import Geodetic


@dataclass(slots=True)
class UnderWay:
    """One command of one vehicle, from its confirmation to its end."""

    command_id: str
    vehicle_id: int
    kind: CommandKind
    run: Run
    target: Geodetic | None
    proposal_id: str | None
    before: Geodetic | None = None
    """Where the vehicle was going when this was sent."""


def status_of(command: UnderWay, phase: CommandPhase, detail: str, now: int) -> CommandStatus:
    """The command's step as a value for the page and the log."""
    return CommandStatus(
        command_id=command.command_id,
        vehicle_id=command.vehicle_id,
        kind=command.kind,
        phase=phase,
        time_ns=now,
        detail=detail,
        target=command.target,
        proposal_id=command.proposal_id,
        attempts=command.run.attempts,
    )


def event_of(now: int, code: str, severity: Severity, text: str, vehicle_id: int | None = None) -> Event:
    """An event of the command desk."""
    return Event(now, code, severity, text, vehicle_id)
