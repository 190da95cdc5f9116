"""How the small autopilot answers: commands, requests, refusals, as a live ArduCopter was seen to.

Keeps the rule that each answer here is one that data recorded from ArduCopter 4.6 (or PX4's
source, for its flavour) shows: the station's handling of refusals is tested against these.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from groundstation.domain.geometry import Enu, Geodetic
from groundstation.domain.vehicle import AUTOPILOT_COMPONENT
from groundstation.mavlink.dialect import dialect
from sim_sitl import telemetry
from sim_sitl.flight import Grounded, Stay
from sim_sitl.modes import Behaviour, Flavour, mode_number, px4_mode
from sim_sitl.vehicle import Vehicle

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
FORCE = 21196
"""param2 of arm/disarm that overrides."""
_INT32_MAX = 0x7FFFFFFF
"""COMMAND_INT's NaN."""
_FRAMES_AMSL, _FRAMES_HOME, _FRAMES_TERRAIN = (0, 5), (3, 6), (10, 11)
_PARAMETERS = {b"SYSID_THISMAV": 1.0, b"WPNAV_SPEED": 1000.0, b"FENCE_ENABLE": 0.0, b"FRAME_CLASS": 1.0}


@dataclass(frozen=True, slots=True)
class Command:
    """COMMAND_LONG or COMMAND_INT, made alike."""

    number: int
    params: tuple[float, float, float, float]
    """param1 to param4."""
    latitude_deg: float
    """Or param5."""
    longitude_deg: float
    """Or param6."""
    z: float
    """param7."""
    frame: int | None
    """MAV_FRAME of COMMAND_INT; None: COMMAND_LONG."""


class CommandHandler:
    """Everything a vehicle's autopilot does with a message that reached it."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._handlers: dict[int, Callable[[Command], int]] = {
            20: lambda _: self._set_mode_by_name("RTL", "AUTO.RTL"),
            21: lambda _: self._set_mode_by_name("LAND", "AUTO.LAND"),
            22: self._take_off,
            176: self._set_mode,
            178: self._change_speed,
            192: self._reposition,
            193: self._pause,
            400: self._arm,
            510: self._get_interval,
            511: self._set_interval,
            512: self._request_message,
            520: lambda command: self._request_one(148),
        }

    def handle(self, message: Any) -> None:
        """One decoded message from anybody."""
        kind = message.get_type()
        target = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        if target not in (0, self._vehicle.system_id) or component not in (0, AUTOPILOT_COMPONENT):
            return
        handler = getattr(self, f"_on_{kind.lower()}", None)
        if handler is not None:
            handler(message)

    # ── messages ──────────────────────────────────────────────────────────────────────────────

    def _on_command_long(self, m: Any) -> None:
        command = Command(
            m.command, (m.param1, m.param2, m.param3, m.param4), m.param5, m.param6, m.param7, None
        )
        self._answer(m, command)

    def _on_command_int(self, m: Any) -> None:
        params = (m.param1, m.param2, m.param3, m.param4)
        x, y = (math.nan if value == _INT32_MAX else value * 1e-7 for value in (m.x, m.y))
        self._answer(m, Command(m.command, params, x, y, m.z, m.frame))

    def _answer(self, m: Any, command: Command) -> None:
        handler = self._handlers.get(command.number)
        result = handler(command) if handler else UNSUPPORTED
        self._vehicle.send(
            dialect.MAVLink_command_ack_message(
                command.number, result, 0, 0, m.get_srcSystem(), m.get_srcComponent()
            )
        )

    def _on_set_mode(self, m: Any) -> None:
        if m.base_mode & 1:
            self._vehicle.enter_mode(m.custom_mode)

    def _on_timesync(self, m: Any) -> None:
        if m.tc1 == 0:
            self._vehicle.send(dialect.MAVLink_timesync_message(self._vehicle.boot_ns(), m.ts1))

    def _on_set_position_target_global_int(self, m: Any) -> None:
        if self._vehicle.behaviour is not Behaviour.GUIDED or m.type_mask & 0b111:
            return
        target = self._place(m.lat_int * 1e-7, m.lon_int * 1e-7, m.alt, m.coordinate_frame)
        if not isinstance(target, int):
            self._vehicle.fly_to(target)

    def _on_param_request_read(self, m: Any) -> None:
        name = m.param_id.encode() if isinstance(m.param_id, str) else bytes(m.param_id)
        self._send_parameter(name.rstrip(b"\0"))

    def _on_param_request_list(self, _: Any) -> None:
        for name in _PARAMETERS:
            self._send_parameter(name)

    def _send_parameter(self, name: bytes) -> None:
        if name not in _PARAMETERS:
            return
        value = float(self._vehicle.system_id) if name == b"SYSID_THISMAV" else _PARAMETERS[name]
        index = list(_PARAMETERS).index(name)
        self._vehicle.send(dialect.MAVLink_param_value_message(name, value, 9, len(_PARAMETERS), index))

    def _on_mission_request_list(self, m: Any) -> None:
        self._vehicle.send(
            dialect.MAVLink_mission_count_message(m.get_srcSystem(), m.get_srcComponent(), 0, m.mission_type)
        )

    def _on_mission_count(self, m: Any) -> None:
        # MAV_MISSION_UNSUPPORTED: this autopilot stores no missions.
        self._vehicle.send(
            dialect.MAVLink_mission_ack_message(m.get_srcSystem(), m.get_srcComponent(), 3, m.mission_type)
        )

    # ── commands ──────────────────────────────────────────────────────────────────────────────

    def _arm(self, command: Command) -> int:
        vehicle = self._vehicle
        if command.params[0] not in (0.0, 1.0):
            return UNSUPPORTED
        forced = command.params[1] == FORCE
        if command.params[0] == 0.0:
            if vehicle.armed and not vehicle.landed and not forced:
                return FAILED if vehicle.flavour is Flavour.ARDUPILOT else TEMPORARILY_REJECTED
            if vehicle.armed:
                vehicle.disarm()
            return ACCEPTED
        if vehicle.armed:
            return ACCEPTED
        if not vehicle.ready and not forced:
            vehicle.say(
                2, "Arm: Need Position Estimate" if not vehicle.has_position else "Arm: EKF3 not using GPS"
            )
            return FAILED if vehicle.flavour is Flavour.ARDUPILOT else TEMPORARILY_REJECTED
        vehicle.arm()
        return ACCEPTED

    def _take_off(self, command: Command) -> int:
        vehicle = self._vehicle
        if not vehicle.armed or not vehicle.landed:
            return FAILED if vehicle.flavour is Flavour.ARDUPILOT else TEMPORARILY_REJECTED
        if vehicle.flavour is Flavour.PX4:
            height = command.z - (vehicle.home.altitude_amsl_m if vehicle.home else 0.0)
            vehicle.enter_mode(mode_number(vehicle.flavour, "AUTO.TAKEOFF"))
            vehicle.take_off(height if math.isfinite(height) and height > 1.0 else 10.0)
            return ACCEPTED
        if vehicle.behaviour is not Behaviour.GUIDED or not math.isfinite(command.z) or command.z <= 0.0:
            return FAILED
        vehicle.take_off(command.z)
        return ACCEPTED

    def _set_mode_by_name(self, ardupilot: str, px4: str) -> int:
        vehicle = self._vehicle
        name = ardupilot if vehicle.flavour is Flavour.ARDUPILOT else px4
        return ACCEPTED if vehicle.enter_mode(mode_number(vehicle.flavour, name)) else FAILED

    def _set_mode(self, command: Command) -> int:
        base, custom, sub = command.params[:3]
        if not math.isfinite(base) or not int(base) & 1:
            return DENIED
        if not math.isfinite(custom):
            return FAILED
        number = int(custom)
        if self._vehicle.flavour is Flavour.PX4:
            number = px4_mode(number, int(sub) if math.isfinite(sub) else 0)
        if self._vehicle.enter_mode(number):
            return ACCEPTED
        return FAILED if self._vehicle.flavour is Flavour.ARDUPILOT else TEMPORARILY_REJECTED

    def _change_speed(self, command: Command) -> int:
        speed = command.params[1]
        if not math.isfinite(speed) or not 0.5 <= speed <= 20.0:
            return FAILED
        self._vehicle.speed_m_s = speed
        return ACCEPTED

    def _reposition(self, command: Command) -> int:
        vehicle = self._vehicle
        flags = int(command.params[1]) if math.isfinite(command.params[1]) else 0
        px4 = vehicle.flavour is Flavour.PX4
        if command.frame is None and not px4:
            return UNSUPPORTED
        if px4 and flags != 1:
            return UNSUPPORTED
        nowhere = math.isnan(command.latitude_deg) and math.isnan(command.longitude_deg)
        if px4 and nowhere:
            # PX4 stops where it is; QGroundControl pauses it so.
            if not vehicle.enter_mode(mode_number(vehicle.flavour, "AUTO.LOITER")):
                return DENIED
            vehicle.paused = None
            if not vehicle.landed:
                vehicle.flight.set_goal(Stay())
            return ACCEPTED
        target = self._place(command.latitude_deg, command.longitude_deg, command.z, command.frame or 0)
        if isinstance(target, int):
            return target
        guided = "AUTO.LOITER" if px4 else "GUIDED"
        if vehicle.mode != guided:
            if not flags & 1:
                return DENIED
            if not vehicle.enter_mode(mode_number(vehicle.flavour, guided)):
                return DENIED
        if math.isfinite(command.params[0]) and command.params[0] > 0:
            vehicle.speed_m_s = min(command.params[0], 20.0)
        vehicle.fly_to(target)
        return ACCEPTED

    def _place(self, latitude_deg: float, longitude_deg: float, z: float, frame: int) -> Enu | int:
        """ENU metres of a commanded place, or the MAV_RESULT of refusing it."""
        vehicle = self._vehicle
        if frame in _FRAMES_TERRAIN:
            return FAILED
        if frame not in _FRAMES_AMSL + _FRAMES_HOME:
            return DENIED
        if (
            not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180)
            or not math.isfinite(z)
            or vehicle.home is None
        ):
            return DENIED
        altitude = z + (vehicle.home.altitude_amsl_m if frame in _FRAMES_HOME else 0.0)
        return vehicle.to_enu(Geodetic(latitude_deg, longitude_deg, altitude))

    def _pause(self, command: Command) -> int:
        vehicle = self._vehicle
        if command.params[0] not in (0.0, 1.0):
            return DENIED
        if vehicle.behaviour not in (Behaviour.GUIDED, Behaviour.AUTO) or vehicle.landed:
            vehicle.say(6, "Failed to pause" if command.params[0] == 0.0 else "Failed to continue")
            return FAILED
        if command.params[0] == 0.0:
            if vehicle.paused is None and not isinstance(vehicle.flight.goal, Stay | Grounded):
                vehicle.paused = vehicle.flight.goal
                vehicle.flight.set_goal(Stay())
        elif vehicle.paused is not None:
            vehicle.flight.set_goal(vehicle.paused)
            vehicle.paused = None
        return ACCEPTED

    # ── requests ──────────────────────────────────────────────────────────────────────────────

    def _set_interval(self, command: Command) -> int:
        message_id, interval_us = command.params[:2]
        if not (math.isfinite(message_id) and math.isfinite(interval_us)) or not telemetry.is_known(
            int(message_id)
        ):
            return FAILED
        self._vehicle.set_interval(int(message_id), interval_us)
        return ACCEPTED

    def _get_interval(self, command: Command) -> int:
        if not math.isfinite(command.params[0]):
            return FAILED
        message_id = int(command.params[0])
        interval_us = self._vehicle.interval_us(message_id)
        self._vehicle.send(dialect.MAVLink_message_interval_message(message_id & 0xFFFF, interval_us))
        return ACCEPTED

    def _request_message(self, command: Command) -> int:
        return self._request_one(int(command.params[0])) if math.isfinite(command.params[0]) else FAILED

    def _request_one(self, message_id: int) -> int:
        message = telemetry.build(message_id, self._vehicle.picture())
        if message is None:
            return FAILED
        self._vehicle.send(message)
        return ACCEPTED
