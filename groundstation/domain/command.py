"""Proposals, commands and how they ended. A command leaves only with a live grant."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from groundstation.domain.geometry import Geodetic


@dataclass(frozen=True, slots=True)
class Proposal:
    """A place where a vehicle would learn most, offered to the operator."""

    proposal_id: str
    """Unique within the session, stable under replay."""
    vehicle_id: int
    beacon_id: int
    position: Geodetic
    height_above_home_m: float
    reason: str
    """In the operator's words."""
    created_ns: int
    expires_ns: int
    mission_revision: int
    target_sequence: int
    """The belief it was based on."""


class CommandKind(StrEnum):
    """What a vehicle is told to do."""

    REPOSITION = "reposition"
    HOLD = "hold"


class CommandPhase(StrEnum):
    """Life of a command. The last six are final."""

    GATED = "gated"
    """Confirmed and passed by the gate, about to leave."""
    SENT = "sent"
    """Left, not acknowledged yet."""
    ACCEPTED = "accepted"
    """Acknowledged; mode and target are being verified."""
    FLYING = "flying"
    """Mode and target verified, on the way."""
    ARRIVED = "arrived"
    HOLDING = "holding"
    """Hold verified by mode."""
    REFUSED = "refused"
    """By the gate or by the vehicle."""
    TIMED_OUT = "timed_out"
    """No acknowledgement, or never verified."""
    REVOKED = "revoked"
    """A hold took its grant."""
    SUPERSEDED = "superseded"
    """A newer command of the same vehicle took its place."""


@dataclass(frozen=True, slots=True)
class CommandStatus:
    """One step in a command's life."""

    command_id: str
    vehicle_id: int
    kind: CommandKind
    phase: CommandPhase
    time_ns: int
    detail: str
    """Why it was refused, what the vehicle answered, …"""
    target: Geodetic | None
    proposal_id: str | None
    attempts: int


@dataclass(frozen=True, slots=True)
class ProposalGone:
    """A proposal that can no longer be confirmed."""

    proposal_id: str
    time_ns: int
    reason: str
    """``confirmed``, ``dismissed``, ``expired``, ``replaced`` or why the gate withdrew it."""
