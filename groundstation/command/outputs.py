"""What the desks hand to the shell."""

from __future__ import annotations

from dataclasses import dataclass

from groundstation.domain.command import CommandStatus, Proposal, ProposalGone
from groundstation.domain.events import Event


@dataclass(frozen=True, slots=True)
class SendFrame:
    """A frame that wants to leave. The guard has the last word."""

    vehicle_id: int | None
    """None: to all."""
    frame: bytes
    """Whole, CRC included; its sequence number is given by the guard's ``stamp``."""


DeskOutput = SendFrame | Proposal | ProposalGone | CommandStatus | Event
