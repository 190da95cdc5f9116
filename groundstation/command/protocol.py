"""One command's life: sent, acknowledged, repeated, verified. No input or output, no clock.

An acknowledgement is not the end: an autopilot may take the mode without the target or the
target without the mode, so both are looked for in what it says of itself. A lost
acknowledgement is not the end either: what the vehicle does counts.

A run is told of acknowledgements, vehicle states and ticks, and answers with steps: a
message to send, a new phase, or both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

from groundstation.command import outgoing
from groundstation.command.settings import CommandSettings
from groundstation.domain.command import CommandPhase
from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.vehicle import Autopilot, VehicleState
from groundstation.mavlink.messages import CommandAck
from groundstation.safety.modes import REPOSITION_MODES, HoldMode

_ACCEPTED, _TEMPORARILY_REJECTED, _IN_PROGRESS = 0, 1, 5
_RESULTS = {
    1: "temporarily rejected",
    2: "denied",
    3: "unsupported",
    4: "failed",
    6: "cancelled",
    7: "supported as COMMAND_LONG only",
    8: "supported as COMMAND_INT only",
    9: "frame not supported",
}


@dataclass(frozen=True, slots=True)
class Step:
    """What a run wants done."""

    message: Any = None
    """A dialect message to send, or None."""
    phase: CommandPhase | None = None
    """The phase just entered, or None."""
    detail: str = ""


class Run(Protocol):
    """A command under way."""

    phase: CommandPhase
    attempts: int
    done: bool

    def start(self, time_ns: int) -> list[Step]:
        """Sends it."""

    def on_ack(self, ack: CommandAck, time_ns: int) -> list[Step]:
        """The vehicle acknowledged something to us."""

    def on_state(self, state: VehicleState, time_ns: int) -> list[Step]:
        """A new picture of the vehicle."""

    def on_tick(self, time_ns: int) -> list[Step]:
        """Time passed."""


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)


def result_text(result: int) -> str:
    """MAV_RESULT in words."""
    return _RESULTS.get(result, f"result {result}")


def offset_m(a: Geodetic, b: Geodetic) -> float:
    """Distance of two places, metres."""
    return math.hypot(*LocalFrame(a).to_enu(b))


class RepositionRun:
    """Sends a vehicle to a place and watches it go there."""

    def __init__(
        self, vehicle_id: int, target: Geodetic, autopilot: Autopilot, settings: CommandSettings
    ) -> None:
        self.phase = CommandPhase.GATED
        self.attempts = 0
        self.done = False
        self._vehicle_id = vehicle_id
        self._target = target
        self._modes = REPOSITION_MODES[autopilot]
        self._settings = settings
        self._first_sent_ns = 0
        self._deadline_ns = 0
        self._start_m: float | None = None
        """Distance to the target when it was sent."""

    def start(self, time_ns: int) -> list[Step]:
        """Sends it."""
        self._first_sent_ns = time_ns
        return [self._send(time_ns), self._enter(CommandPhase.SENT, "")]

    def on_ack(self, ack: CommandAck, time_ns: int) -> list[Step]:
        """COMMAND_ACK of DO_REPOSITION."""
        if self.phase is not CommandPhase.SENT or ack.command != outgoing.MAV_CMD_DO_REPOSITION:
            return []
        if ack.result == _ACCEPTED:
            self._deadline_ns = time_ns + _ns(self._settings.verify_timeout_s)
            return [self._enter(CommandPhase.ACCEPTED, "acknowledged; verifying mode and target")]
        if ack.result == _IN_PROGRESS:
            self._deadline_ns = time_ns + _ns(self._settings.progress_timeout_s)
            self.attempts = self._settings.attempts
            return []
        if ack.result == _TEMPORARILY_REJECTED:
            # Asked again when the time-out runs out, as if nothing had come.
            return []
        return [self._finish(CommandPhase.REFUSED, f"the vehicle answered: {result_text(ack.result)}")]

    def on_state(self, state: VehicleState, time_ns: int) -> list[Step]:
        """Looks for mode and target, then for arrival."""
        if self.done or self.phase is CommandPhase.GATED or state.position is None:
            return []
        left_m = offset_m(state.position, self._target)
        if self._start_m is None:
            self._start_m = left_m
        if state.last_heartbeat_ns < self._first_sent_ns:
            return []
        mode_ok = state.mode in self._modes
        if self.phase is CommandPhase.FLYING:
            if not mode_ok:
                return [
                    self._finish(
                        CommandPhase.SUPERSEDED,
                        f"changed to {state.mode}: a pilot, another station or a fail-safe took over",
                    )
                ]
            return self._arrival(left_m)
        told = (
            state.position_target is not None
            and offset_m(state.position_target, self._target) <= self._settings.target_tolerance_m
        )
        accepted = self.phase is CommandPhase.ACCEPTED
        nearer = accepted and self._start_m - left_m >= self._settings.approach_m
        there = accepted and left_m <= self._settings.arrive_m
        if not (mode_ok and (told or nearer or there)):
            return []
        seconds = left_m / self._settings.slowest_m_s + self._settings.flight_grace_s
        self._deadline_ns = time_ns + _ns(seconds)
        flying = self._enter(CommandPhase.FLYING, f"{state.mode}, {left_m:.0f} m to go")
        return [flying, *self._arrival(left_m)]

    def on_tick(self, time_ns: int) -> list[Step]:
        """Repeats what was not acknowledged; gives up in time."""
        if self.done or self.phase is CommandPhase.GATED or time_ns < self._deadline_ns:
            return []
        if self.phase is CommandPhase.SENT:
            if self.attempts < self._settings.attempts:
                return [self._send(time_ns)]
            detail = f"no acknowledgement after {self.attempts} attempts"
            return [self._finish(CommandPhase.TIMED_OUT, detail)]
        if self.phase is CommandPhase.ACCEPTED:
            return [
                self._finish(
                    CommandPhase.TIMED_OUT,
                    "acknowledged, but the vehicle does not show mode and target; hold it if in doubt",
                )
            ]
        return [self._finish(CommandPhase.TIMED_OUT, "has not arrived in time; it may still be flying there")]

    def _arrival(self, left_m: float) -> list[Step]:
        if left_m > self._settings.arrive_m:
            return []
        return [self._finish(CommandPhase.ARRIVED, f"{left_m:.0f} m from the target")]

    def _send(self, time_ns: int) -> Step:
        self.attempts += 1
        self._deadline_ns = time_ns + _ns(self._settings.ack_timeout_s)
        return Step(message=outgoing.reposition(self._vehicle_id, self._target))

    def _enter(self, phase: CommandPhase, detail: str) -> Step:
        self.phase = phase
        return Step(phase=phase, detail=detail)

    def _finish(self, phase: CommandPhase, detail: str) -> Step:
        self.done = True
        return self._enter(phase, detail)


class HoldRun:
    """Stops a vehicle: tries the modes that stop it until it shows one, then keeps watch.

    The watch is there for what had left before the hold: a late frame that takes the vehicle
    out of its hold is answered by another hold.
    """

    def __init__(self, vehicle_id: int, modes: tuple[HoldMode, ...], settings: CommandSettings) -> None:
        self.phase = CommandPhase.GATED
        self.attempts = 0
        self.done = False
        self._vehicle_id = vehicle_id
        self._modes = modes
        self._settings = settings
        self._choice = 0
        self._sent_ns = 0
        self._deadline_ns = 0

    def start(self, time_ns: int) -> list[Step]:
        """Sends it."""
        return [self._send(time_ns), self._enter(CommandPhase.SENT, self._word())]

    def on_ack(self, ack: CommandAck, time_ns: int) -> list[Step]:
        """COMMAND_ACK of what was sent; a refusal makes the next mode be tried."""
        if self.phase is not CommandPhase.SENT or ack.command != self._expected_command():
            return []
        if ack.result == _ACCEPTED:
            if not self._modes:
                # Nothing more can be verified where modes are not known.
                return [self._finish(CommandPhase.HOLDING, "acknowledged; its mode cannot be verified")]
            return [self._enter(CommandPhase.ACCEPTED, "acknowledged; verifying the mode")]
        if ack.result in (_TEMPORARILY_REJECTED, _IN_PROGRESS):
            return []
        if self._choice + 1 < len(self._modes):
            self._choice += 1
            return [self._send(time_ns)]
        return [self._finish(CommandPhase.REFUSED, f"the vehicle answered: {result_text(ack.result)}")]

    def on_state(self, state: VehicleState, time_ns: int) -> list[Step]:
        """Looks for a mode that stops; while watching, for one that does not."""
        if self.done or not self._modes or state.last_heartbeat_ns <= self._sent_ns:
            return []
        holding = any(state.mode in mode.names for mode in self._modes) and self._stopped(state)
        if self.phase is CommandPhase.HOLDING:
            if holding:
                return []
            again = self._enter(CommandPhase.SENT, f"left its hold for {state.mode}: again")
            return [self._send(time_ns), again]
        if not holding:
            return []
        self._deadline_ns = time_ns + _ns(self._settings.hold_watch_s)
        return [self._enter(CommandPhase.HOLDING, state.mode)]

    def on_tick(self, time_ns: int) -> list[Step]:
        """Repeats until verified; ends the watch."""
        if self.done or time_ns < self._deadline_ns:
            return []
        if self.phase is CommandPhase.HOLDING:
            self.done = True
            return []
        if self.attempts < self._settings.hold_attempts:
            if self._unanswered_half() and self._choice + 1 < len(self._modes):
                self._choice += 1
            return [self._send(time_ns)]
        return [
            self._finish(
                CommandPhase.TIMED_OUT, f"not verified after {self.attempts} attempts: use the transmitter"
            )
        ]

    def _unanswered_half(self) -> bool:
        return self.attempts >= self._settings.hold_attempts // 2

    def _expected_command(self) -> int:
        if not self._modes:
            return outgoing.MAV_CMD_DO_PAUSE_CONTINUE
        return outgoing.MAV_CMD_DO_REPOSITION if self._mode.in_place else outgoing.MAV_CMD_DO_SET_MODE

    def _stopped(self, state: VehicleState) -> bool:
        """Where the mode alone does not tell: that it no longer moves."""
        if self.phase is CommandPhase.HOLDING or not any(mode.in_place for mode in self._modes):
            return True
        velocity = state.velocity_ned_m_s
        return velocity is None or math.hypot(*velocity) <= self._settings.stopped_m_s

    @property
    def _mode(self) -> HoldMode:
        return self._modes[self._choice]

    def _word(self) -> str:
        return self._mode.names[0] if self._modes else "pause"

    def _send(self, time_ns: int) -> Step:
        confirmation = min(self.attempts, 255)
        self.attempts += 1
        self._sent_ns = time_ns
        self._deadline_ns = time_ns + _ns(self._settings.hold_retry_s)
        mode = self._mode if self._modes else None
        return Step(message=outgoing.hold(self._vehicle_id, mode, confirmation))

    def _enter(self, phase: CommandPhase, detail: str) -> Step:
        self.phase = phase
        return Step(phase=phase, detail=detail)

    def _finish(self, phase: CommandPhase, detail: str) -> Step:
        self.done = True
        return self._enter(phase, detail)
