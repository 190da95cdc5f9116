"""Everything that may change what the station believes: the inputs, one union, journalled.

The engines and the command desk are state machines over these. What is not here did not
happen: a replay feeds the same inputs in the same order and gets the same answers.

Station time (``time_ns``): nanoseconds since the Unix epoch by a monotonic clock that was
set by the wall clock when the session began; it never steps. ``unix_us`` is the wall clock
as it stood, for other tools.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from groundstation.domain.command import Proposal
from groundstation.domain.mission import Mission


class Direction(StrEnum):
    """Of a frame, seen from the station."""

    IN = "in"
    OUT = "out"


@dataclass(frozen=True, slots=True)
class FrameInput:
    """One whole frame (CRC verified, signature if required), in or out."""

    connection: str
    """Name of the connection, unique in the session (``udpin:0.0.0.0:14550``)."""
    direction: Direction
    frame: bytes


@dataclass(frozen=True, slots=True)
class TickInput:
    """Time passed. Ten a second; all time-outs are decided on ticks and frames only."""


@dataclass(frozen=True, slots=True)
class MissionInput:
    """A new revision of the mission."""

    mission: Mission
    who: str


class Decision(StrEnum):
    """What an operator may decide."""

    CONFIRM = "confirm"
    DISMISS = "dismiss"
    HOLD = "hold"
    HOLD_ALL = "hold_all"


@dataclass(frozen=True, slots=True)
class OperatorInput:
    """An operator's action. A confirmation names proposal and vehicle: both must match."""

    who: str
    decision: Decision
    proposal_id: str | None = None
    vehicle_id: int | None = None


@dataclass(frozen=True, slots=True)
class JoinInput:
    """An operator says that two ids are one transmitter (a phone that changed its random address)."""

    who: str
    beacon_id: int
    """The id that is another one's."""
    into_beacon_id: int | None
    """The id whose belief takes its windows in; None: taken back, ``beacon_id`` stands for itself again."""


@dataclass(frozen=True, slots=True)
class ConnectionInput:
    """A connection changed state."""

    connection: str
    state: str
    """``open``, ``closed``, ``waiting`` (for the next try) or ``failed``."""
    detail: str


@dataclass(frozen=True, slots=True)
class DropInput:
    """A bounded queue was full: which windows never reached the estimator."""

    queue: str
    window_keys: tuple[tuple[int, int, int], ...]


@dataclass(frozen=True, slots=True)
class PlanInput:
    """The planning lane's result, with what it was based on."""

    mission_revision: int
    proposals: tuple[Proposal, ...]
    notes: tuple[str, ...] = field(default=())
    """Why a vehicle got no proposal."""


@dataclass(frozen=True, slots=True)
class SessionInput:
    """The session began, was resumed after a stop, or ended.

    On ``resumed`` all state that lives by the stream (open windows, partial captures, pose
    histories, clocks, grants, commands under way) is forgotten; beliefs are kept.
    """

    event: str
    """``began``, ``resumed`` or ``ended``."""
    version: str


AnyInput = (
    FrameInput
    | TickInput
    | MissionInput
    | OperatorInput
    | ConnectionInput
    | DropInput
    | PlanInput
    | SessionInput
    | JoinInput
)


@dataclass(frozen=True, slots=True)
class Record:
    """One line of the journal."""

    seq: int
    """From 0, without gaps, over the whole session."""
    time_ns: int
    """Station time; never decreases."""
    unix_us: int
    """Wall clock as it stood."""
    input: AnyInput
