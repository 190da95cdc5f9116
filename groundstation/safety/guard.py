"""The guard: last before any radio. Every frame that is to leave is classified here.

Harmless messages pass. A command that moves a vehicle passes only with a live grant for
this vehicle, this command and this target. What stops a vehicle always passes. Everything
else is refused, with a reason and a counter. Payloads come from three places: our own
command desk, MAVSDK (which retries inside its library, long after its caller gave up), and
another ground station on a forwarding connection that was explicitly allowed to command.

A guard made for a replay refuses everything.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import StrEnum

from groundstation.domain.events import Counter
from groundstation.domain.geometry import Geodetic
from groundstation.domain.vehicle import Autopilot
from groundstation.mavlink.catalogue import CATALOGUE
from groundstation.mavlink.encode import rewrite
from groundstation.mavlink.framing import MAGIC_V2, Frame
from groundstation.safety.grants import Grants
from groundstation.safety.modes import CUSTOM_MODE_ENABLED, Airframe, hold_modes

MAV_CMD_DO_SET_MODE = 176
MAV_CMD_DO_REPOSITION = 192
MAV_CMD_DO_PAUSE_CONTINUE = 193
_MAV_FRAME_GLOBAL = (0, 5)
"""GLOBAL and GLOBAL_INT: altitude above mean sea level. Others measure height from elsewhere."""

_HEARTBEAT, _SET_MODE, _COMMAND_INT, _COMMAND_LONG = 0, 11, 75, 76

HARMLESS_MESSAGES = frozenset(
    {
        4,  # PING
        20,  # PARAM_REQUEST_READ
        21,  # PARAM_REQUEST_LIST
        40,  # MISSION_REQUEST: reads
        43,  # MISSION_REQUEST_LIST: reads
        47,  # MISSION_ACK: ends a read
        51,  # MISSION_REQUEST_INT: reads
        66,  # REQUEST_DATA_STREAM
        77,  # COMMAND_ACK
        111,  # TIMESYNC
        148,  # AUTOPILOT_VERSION: says who we are
        253,  # STATUSTEXT
        20804,  # SAR_CIR_REQUEST
        20805,  # SAR_TARGET_ESTIMATE
    }
)
"""Messages that ask or tell but move nothing."""

HARMLESS_COMMANDS = frozenset(
    {
        410,  # GET_HOME_POSITION
        510,  # GET_MESSAGE_INTERVAL
        511,  # SET_MESSAGE_INTERVAL
        512,  # REQUEST_MESSAGE
        519,  # REQUEST_PROTOCOL_VERSION
        520,  # REQUEST_AUTOPILOT_CAPABILITIES
    }
)
"""MAV_CMDs that ask for information; MAVSDK sends 511, 512 and 520 unasked."""


class Source(StrEnum):
    """Who wants to send."""

    STATION = "station"
    MAVSDK = "mavsdk"
    FORWARD = "forward"
    """Another ground station."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the guard says of one frame."""

    admitted: bool
    reason: str
    """``harmless``, ``hold``, ``grant``, ``other_station``; or why it was refused."""
    vehicle_id: int | None
    """The one vehicle it may go to; None: to all."""
    component_id: int | None
    command: int | None
    """MAV_CMD, where the frame is a command."""


@dataclass(frozen=True, slots=True)
class _Command:
    number: int
    parameters: tuple[float, ...]
    """param1–param4 of a COMMAND_INT, param1–param7 of a COMMAND_LONG."""
    target: Geodetic | None
    """Only from COMMAND_INT: a float has metres, not centimetres, of resolution here."""


class Guard:
    """Classifies outgoing frames against the live ``grants``; gives admitted ones their sequence."""

    def __init__(self, grants: Grants, *, forward_commands: bool = False, replay: bool = False) -> None:
        self._grants = grants
        self._forward_commands = forward_commands
        self._replay = replay
        self._kinds: dict[int, tuple[Autopilot, Airframe]] = {}
        self._sequences: dict[tuple[str, int, int], int] = {}
        self._counts: dict[tuple[str, str, str], int] = {}

    def note_vehicle(self, vehicle_id: int, autopilot: Autopilot, airframe: Airframe) -> None:
        """What kind of vehicle this is: mode numbers mean nothing without it."""
        self._kinds[vehicle_id] = (autopilot, airframe)

    def admit(self, frame: Frame, source: Source, time_ns: int) -> Verdict:
        """May this frame leave, and to whom?"""
        verdict = self._judge(frame, source, time_ns)
        key = ("admitted" if verdict.admitted else "refused", source.value, verdict.reason)
        self._counts[key] = self._counts.get(key, 0) + 1
        return verdict

    def stamp(self, frame: Frame, destination: str) -> bytes:
        """The admitted frame with the next sequence number of its sender towards ``destination``.

        One counter for each sender and destination, so that what reaches a vehicle has no
        gaps although the command desk, telemetry and MAVSDK speak with one identity.
        """
        key = (destination, frame.system_id, frame.component_id)
        sequence = self._sequences.get(key, 0)
        self._sequences[key] = (sequence + 1) % 256
        return rewrite(frame.raw, sequence)

    def counters(self) -> list[Counter]:
        """``guard_frames_total`` by verdict, source and reason."""
        names = ("verdict", "source", "reason")
        return [
            Counter("guard_frames_total", tuple(zip(names, key, strict=True)), count)
            for key, count in sorted(self._counts.items())
        ]

    def _judge(self, frame: Frame, source: Source, time_ns: int) -> Verdict:
        info = CATALOGUE.get(frame.message_id)
        if info is None or frame.raw[0] != MAGIC_V2:
            return Verdict(False, "not_readable", None, None, None)
        # MAVLink 2 cuts trailing zeros.
        payload = frame.payload.ljust(info.length, b"\0")
        vehicle_id = component_id = None
        if info.target_system_offset is not None:
            vehicle_id = payload[info.target_system_offset] or None
        if info.target_component_offset is not None:
            component_id = payload[info.target_component_offset] or None
        command = _command_of(frame.message_id, payload)
        number = command.number if command else None

        def verdict(admitted: bool, reason: str) -> Verdict:
            return Verdict(admitted, reason, vehicle_id, component_id, number)

        if self._replay:
            return verdict(False, "replay")
        if source is Source.FORWARD and not self._forward_commands:
            return verdict(False, "listening_only")
        if frame.message_id == _HEARTBEAT:
            if source is Source.MAVSDK:
                return verdict(False, "second_heartbeat")
            return verdict(True, "harmless")
        if frame.message_id in HARMLESS_MESSAGES or number in HARMLESS_COMMANDS:
            return verdict(True, "harmless")
        if vehicle_id is not None and self._is_hold(frame.message_id, payload, command, vehicle_id):
            return verdict(True, "hold")
        if source is Source.FORWARD:
            return self._judge_other_station(verdict(True, "other_station"), time_ns)
        if command is None or number != MAV_CMD_DO_REPOSITION or command.target is None or vehicle_id is None:
            return verdict(False, "not_allowed")
        if self._grants.match(vehicle_id, number, command.target, time_ns) is None:
            return verdict(False, "no_grant")
        return verdict(True, "grant")

    def _judge_other_station(self, allowed: Verdict, time_ns: int) -> Verdict:
        """The option gave it authority, but its library's retries must not undo our hold."""
        vehicles = sorted(self._kinds) if allowed.vehicle_id is None else [allowed.vehicle_id]
        if any(self._grants.in_hold_shadow(vehicle_id, time_ns) for vehicle_id in vehicles):
            return Verdict(False, "held", allowed.vehicle_id, allowed.component_id, allowed.command)
        return allowed

    def _is_hold(self, message_id: int, payload: bytes, command: _Command | None, vehicle_id: int) -> bool:
        modes = hold_modes(*self._kinds.get(vehicle_id, (Autopilot.UNKNOWN, Airframe.OTHER)))
        if message_id == _SET_MODE:
            (custom_mode,) = struct.unpack_from("<I", payload)
            numbers = {mode.custom_mode for mode in modes}
            return bool(payload[5] & CUSTOM_MODE_ENABLED) and custom_mode in numbers
        if command is None:
            return False
        if command.number == MAV_CMD_DO_PAUSE_CONTINUE:
            return command.parameters[0] == 0.0
        if command.number == MAV_CMD_DO_REPOSITION:
            nowhere = len(command.parameters) == 7 and all(math.isnan(p) for p in command.parameters[4:])
            return nowhere and any(mode.in_place for mode in modes)
        if command.number != MAV_CMD_DO_SET_MODE or not _has_custom_mode(command.parameters[0]):
            return False
        main_mode, sub_mode = command.parameters[1:3]
        # Only PX4 has sub modes; elsewhere senders leave 0 or NaN there.
        return any(main_mode == mode.main_mode and mode.sub_mode in (0, sub_mode) for mode in modes)


def _has_custom_mode(base_mode: float) -> bool:
    return base_mode in range(256) and bool(int(base_mode) & CUSTOM_MODE_ENABLED)


def _command_of(message_id: int, payload: bytes) -> _Command | None:
    """The command in a COMMAND_INT or COMMAND_LONG (full-length payload); None for other messages."""
    if message_id == _COMMAND_LONG:
        *parameters, number = struct.unpack_from("<7fH", payload)
        return _Command(number, tuple(parameters), None)
    if message_id != _COMMAND_INT:
        return None
    *parameters, x, y, z, number, _system, _component, frame = struct.unpack_from("<4fiifHBBB", payload)
    target = Geodetic(x * 1e-7, y * 1e-7, z) if frame in _MAV_FRAME_GLOBAL else None
    return _Command(number, tuple(parameters), target)
