"""What the small autopilot reports: one function a message, from one frozen picture of it.

Keeps the rule that a message says what ArduCopter 4.6 was seen to say in the same state
(0/0/0 before a position, sensors' bits, flags), so that the station is tried on the real thing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from groundstation.domain.geometry import Enu, Geodetic, Quaternion
from groundstation.mavlink.dialect import dialect
from sim_sitl.modes import MAV_AUTOPILOT_ARDUPILOT, MAV_AUTOPILOT_PX4, Flavour

# As a recorded ArduCopter 4.6.3 in simulation had them.
_SENSORS_PRESENT = 1379007535
_SENSORS_ENABLED = 1377934383
_SENSORS_HEALTH = 1446091823
_PREARM = 1 << 28
_EKF_STARTING, _EKF_ALIGNED, _EKF_READY = 0x400, 0x0A7, 0x33F
POSITION_ONLY = 0x0DF8
"""POSITION_TARGET_TYPEMASK that ignores everything but the position."""


@dataclass(frozen=True, slots=True)
class Picture:
    """All that telemetry needs of a vehicle, at one instant."""

    flavour: Flavour
    boot_ms: int
    unix_usec: int | None
    """None before there is a fix."""
    position: Geodetic | None
    """None before there is a position estimate."""
    height_above_home_m: float
    velocity_enu_m_s: Enu
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    rates_rad_s: Enu
    attitude: Quaternion
    home: Geodetic | None
    target: Geodetic | None
    custom_mode: int
    armed: bool
    landed: bool
    booting: bool
    aligned: bool
    prearm_healthy: bool
    estimator_ready: bool
    guided: bool
    """Whether a position target is being flown to."""
    battery_percent: float


def build(message_id: int, picture: Picture) -> Any | None:
    """The message, or None where the vehicle has nothing to say (now)."""
    builder = _BUILDERS.get(message_id)
    return builder(picture) if builder else None


def is_known(message_id: int) -> bool:
    """Whether this autopilot can send the message at all."""
    return message_id in _BUILDERS


def _deg_e7(degrees: float) -> int:
    return round(degrees * 1e7)


def _ned_cm_s(velocity_enu_m_s: Enu) -> tuple[int, int, int]:
    east, north, up = velocity_enu_m_s
    return round(north * 100), round(east * 100), round(-up * 100)


def _heading_deg(picture: Picture) -> float:
    return math.degrees(picture.yaw_rad) % 360.0


def _heartbeat(p: Picture) -> Any:
    if p.flavour is Flavour.PX4:
        autopilot, base_mode = MAV_AUTOPILOT_PX4, 29
    else:
        autopilot, base_mode = MAV_AUTOPILOT_ARDUPILOT, 89 if p.custom_mode in (3, 4, 6, 9, 21) else 81
    status = 1 if p.booting else 3 if p.landed else 4
    return dialect.MAVLink_heartbeat_message(
        2, autopilot, base_mode | (128 if p.armed else 0), p.custom_mode, status, 3
    )


def _sys_status(p: Picture) -> Any:
    health = _SENSORS_HEALTH if p.prearm_healthy else _SENSORS_HEALTH & ~_PREARM
    return dialect.MAVLink_sys_status_message(
        _SENSORS_PRESENT, _SENSORS_ENABLED, health, 0, round(11000 + 16 * p.battery_percent),
        0 if not p.armed else 1800, round(p.battery_percent), 0, 0, 0, 0, 0, 0,
    )  # fmt: skip


def _system_time(p: Picture) -> Any:
    return dialect.MAVLink_system_time_message(p.unix_usec or 0, p.boot_ms)


def _gps_raw(p: Picture) -> Any:
    if p.position is None:
        return dialect.MAVLink_gps_raw_int_message(0, 0, 0, 0, 0, 65535, 65535, 0, 0, 0)
    east, north, _ = p.velocity_enu_m_s
    course = math.degrees(math.atan2(east, north)) % 360
    return dialect.MAVLink_gps_raw_int_message(
        p.boot_ms * 1000, 6, _deg_e7(p.position.latitude_deg), _deg_e7(p.position.longitude_deg),
        round(p.position.altitude_amsl_m * 1000), 121, 200, round(100 * math.hypot(east, north)),
        round(course * 100) % 36000, 10, 0, 300, 300, 40,
    )  # fmt: skip


def _attitude(p: Picture) -> Any:
    return dialect.MAVLink_attitude_message(p.boot_ms, p.roll_rad, p.pitch_rad, p.yaw_rad, *p.rates_rad_s)


def _attitude_quaternion(p: Picture) -> Any:
    return dialect.MAVLink_attitude_quaternion_message(p.boot_ms, *p.attitude, *p.rates_rad_s)


def _global_position(p: Picture) -> Any:
    if p.position is None:
        return dialect.MAVLink_global_position_int_message(p.boot_ms, 0, 0, 0, 0, 0, 0, 0, 0)
    return dialect.MAVLink_global_position_int_message(
        p.boot_ms, _deg_e7(p.position.latitude_deg), _deg_e7(p.position.longitude_deg),
        round(p.position.altitude_amsl_m * 1000), round(p.height_above_home_m * 1000),
        *_ned_cm_s(p.velocity_enu_m_s), round(_heading_deg(p) * 100) % 36000,
    )  # fmt: skip


def _vfr_hud(p: Picture) -> Any:
    east, north, up = p.velocity_enu_m_s
    speed = math.hypot(east, north)
    altitude = p.position.altitude_amsl_m if p.position else 0.0
    return dialect.MAVLink_vfr_hud_message(
        speed, speed, round(_heading_deg(p)) % 360, 0 if p.landed else 40, altitude, up
    )


def _target_e7(target: Geodetic | None) -> tuple[int, int, float]:
    if target is None:
        return 0, 0, 0.0
    return _deg_e7(target.latitude_deg), _deg_e7(target.longitude_deg), target.altitude_amsl_m


def _position_target(p: Picture) -> Any | None:
    if not p.guided:
        return None
    mask = POSITION_ONLY if p.target is not None else 0x0FFF
    return dialect.MAVLink_position_target_global_int_message(
        p.boot_ms, 0, mask, *_target_e7(p.target), 0, 0, 0, 0, 0, 0, 0, 0
    )


def _battery(p: Picture) -> Any:
    voltages = [round(11000 + 16 * p.battery_percent)] + [65535] * 9
    return dialect.MAVLink_battery_status_message(
        0, 0, 0, 32767, voltages, 0 if not p.armed else 1800, 0, 0, round(p.battery_percent), 0, 1
    )


def _ekf(p: Picture) -> Any | None:
    if p.flavour is Flavour.PX4:
        return None
    flags = _EKF_READY if p.estimator_ready else _EKF_ALIGNED if p.aligned else _EKF_STARTING
    return dialect.MAVLink_ekf_status_report_message(flags, 0.001, 0.001, 0.001, 0.02, 0.0, 0.0)


def _estimator(p: Picture) -> Any | None:
    if p.flavour is Flavour.ARDUPILOT:
        return None
    flags = _EKF_READY if p.estimator_ready else _EKF_ALIGNED if p.aligned else 0
    return dialect.MAVLink_estimator_status_message(
        p.boot_ms * 1000, flags, 0.05, 0.03, 0.03, 0.02, 0.0, 0.0, 0.3, 0.4
    )


def _home(p: Picture) -> Any | None:
    if p.home is None:
        return None
    latitude, longitude, altitude = _target_e7(p.home)
    nan = math.nan
    return dialect.MAVLink_home_position_message(
        latitude, longitude, round(altitude * 1000), 0, 0, 0, [nan] * 4, nan, nan, nan, p.boot_ms * 1000
    )


def _origin(p: Picture) -> Any | None:
    if p.home is None:
        return None
    latitude, longitude, altitude = _target_e7(p.home)
    return dialect.MAVLink_gps_global_origin_message(
        latitude, longitude, round(altitude * 1000), p.boot_ms * 1000
    )


def _extended_sys_state(p: Picture) -> Any:
    return dialect.MAVLink_extended_sys_state_message(0, 1 if p.landed else 2)


def _version(p: Picture) -> Any:
    # MISSION_INT, COMMAND_INT, SET_ATTITUDE_TARGET, SET_POSITION_TARGET_GLOBAL_INT, MAVLINK2.
    capabilities = 0x0004 | 0x0008 | 0x0040 | 0x0100 | 0x2000
    version = 0x040603FF if p.flavour is Flavour.ARDUPILOT else 0x010F00FF
    return dialect.MAVLink_autopilot_version_message(
        capabilities, version, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0
    )


_BUILDERS: dict[int, Callable[[Picture], Any | None]] = {
    0: _heartbeat,
    1: _sys_status,
    2: _system_time,
    24: _gps_raw,
    30: _attitude,
    31: _attitude_quaternion,
    33: _global_position,
    49: _origin,
    74: _vfr_hud,
    87: _position_target,
    147: _battery,
    148: _version,
    193: _ekf,
    230: _estimator,
    242: _home,
    245: _extended_sys_state,
}
