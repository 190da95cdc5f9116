"""Verified frames to typed messages, and only those that somebody here wants.

Each wanted message is read with one ``struct`` straight from the payload: the generated classes
take ten times as long and would be built for every frame. MAVLink 2 cuts trailing zeros, so a
payload is filled up first; one that is longer than the definition is from a newer dialect and
is read as far as it is known.

An implementation check against pymavlink's own decoder, message by message, is in the tests.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from struct import Struct

from groundstation.domain.geometry import Geodetic, Quaternion
from groundstation.mavlink import messages as m
from groundstation.mavlink.catalogue import CATALOGUE
from groundstation.mavlink.framing import Frame
from groundstation.mavlink.tunnel import TUNNEL_ID, unwrap

_PREARM_CHECK = 0x10000000
"""MAV_SYS_STATUS_PREARM_CHECK."""
_IGNORE_POSITION = 0x7
"""POSITION_TARGET_TYPEMASK_{X,Y,Z}_IGNORE."""
_IN_PROGRESS = 5
"""MAV_RESULT_IN_PROGRESS."""
_FRAME_BODY_FRD = 12
"""MAV_FRAME_BODY_FRD."""
_INT16_MIN = -32768
_CIR_FIXED_LENGTH = 40
"""SAR_CIR up to its data."""

_HEARTBEAT = Struct("<IBBBBB").unpack_from
_SYS_STATUS = Struct("<IIIHHhHHHHHHb").unpack_from
_SYSTEM_TIME = Struct("<QI").unpack_from
_GPS_RAW = Struct("<28xBB4xII").unpack_from
_ATTITUDE = Struct("<Ifff").unpack_from
_ATTITUDE_QUATERNION = Struct("<Iffff").unpack_from
_GLOBAL_POSITION = Struct("<Iiiiihhh").unpack_from
_COMMAND_ACK = Struct("<HBBiBB").unpack_from
_POSITION_TARGET = Struct("<Iiif32xHB").unpack_from
_RADIO_STATUS = Struct("<HHBBBBB").unpack_from
_TIMESYNC = Struct("<qq").unpack_from
_EKF_STATUS = Struct("<20xH").unpack_from
_ESTIMATOR_STATUS = Struct("<40xH").unpack_from
_HOME_POSITION = Struct("<iii").unpack_from
_EXTENDED_SYS_STATE = Struct("<BB").unpack_from
_STATUSTEXT = Struct("<B50sHB").unpack_from
_SAR_RSS = Struct("<QQIhhH").unpack_from
_SAR_AOA = Struct("<QQffffB").unpack_from
_SAR_CIR = Struct("<QQfffHHHHBBBB").unpack_from
_SAR_LINK_STATE = Struct("<QQfI").unpack_from


def _heartbeat(payload: bytes) -> m.Heartbeat:
    custom_mode, vehicle_type, autopilot, base_mode, system_status, _version = _HEARTBEAT(payload)
    return m.Heartbeat(vehicle_type, autopilot, base_mode, custom_mode, system_status)


def _sys_status(payload: bytes) -> m.SysStatus:
    fields = _SYS_STATUS(payload)
    present, enabled, health, voltage_mv, remaining = fields[0], fields[1], fields[2], fields[4], fields[12]
    return m.SysStatus(
        None if voltage_mv == 0xFFFF else voltage_mv / 1000.0,
        None if remaining < 0 else float(remaining),
        bool(present & enabled & health & _PREARM_CHECK),
    )


def _system_time(payload: bytes) -> m.SystemTime:
    unix_usec, boot_ms = _SYSTEM_TIME(payload)
    return m.SystemTime(unix_usec or None, boot_ms)


def _gps_raw(payload: bytes) -> m.GpsRaw:
    fix_type, satellites, horizontal_mm, vertical_mm = _GPS_RAW(payload)
    return m.GpsRaw(
        fix_type,
        None if satellites == 0xFF else satellites,
        _accuracy_m(horizontal_mm),
        _accuracy_m(vertical_mm),
    )


def _accuracy_m(millimetres: int) -> float | None:
    """0 stands for unknown: MAVLink 1 and older receivers have no such field."""
    return None if millimetres in (0, 0xFFFFFFFF) else millimetres / 1000.0


def quaternion_of_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion:
    """Airframe to north-east-down, rotations about z, then y, then x (ATTITUDE's convention)."""
    cos_roll, sin_roll = math.cos(roll_rad / 2.0), math.sin(roll_rad / 2.0)
    cos_pitch, sin_pitch = math.cos(pitch_rad / 2.0), math.sin(pitch_rad / 2.0)
    cos_yaw, sin_yaw = math.cos(yaw_rad / 2.0), math.sin(yaw_rad / 2.0)
    return (
        cos_roll * cos_pitch * cos_yaw + sin_roll * sin_pitch * sin_yaw,
        sin_roll * cos_pitch * cos_yaw - cos_roll * sin_pitch * sin_yaw,
        cos_roll * sin_pitch * cos_yaw + sin_roll * cos_pitch * sin_yaw,
        cos_roll * cos_pitch * sin_yaw - sin_roll * sin_pitch * cos_yaw,
    )


def _attitude(payload: bytes) -> m.Attitude | None:
    boot_ms, roll_rad, pitch_rad, yaw_rad = _ATTITUDE(payload)
    if not math.isfinite(roll_rad + pitch_rad + yaw_rad):
        return None
    return m.Attitude(boot_ms, quaternion_of_euler(roll_rad, pitch_rad, yaw_rad))


def _attitude_quaternion(payload: bytes) -> m.Attitude | None:
    boot_ms, w, x, y, z = _ATTITUDE_QUATERNION(payload)
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not 0.5 < norm < 2.0:
        return None
    return m.Attitude(boot_ms, (w / norm, x / norm, y / norm, z / norm))


def _global_position(payload: bytes) -> m.GlobalPosition:
    boot_ms, lat, lon, alt_mm, relative_mm, vx, vy, vz = _GLOBAL_POSITION(payload)
    position = None if lat == 0 and lon == 0 else Geodetic(lat / 1e7, lon / 1e7, alt_mm / 1e3)
    return m.GlobalPosition(boot_ms, position, relative_mm / 1e3, (vx / 100.0, vy / 100.0, vz / 100.0))


def _command_ack(payload: bytes) -> m.CommandAck:
    command, result, progress, _param2, target_system, target_component = _COMMAND_ACK(payload)
    known = result == _IN_PROGRESS and progress <= 100
    return m.CommandAck(command, result, progress if known else None, target_system, target_component)


def _position_target(payload: bytes) -> m.PositionTarget:
    boot_ms, lat, lon, alt_m, type_mask, frame = _POSITION_TARGET(payload)
    usable = not type_mask & _IGNORE_POSITION and math.isfinite(alt_m)
    return m.PositionTarget(boot_ms, Geodetic(lat / 1e7, lon / 1e7, alt_m) if usable else None, frame)


def _radio_status(payload: bytes) -> m.RadioStatus:
    rx_errors, fixed, rssi, remote_rssi, tx_buffer, noise, remote_noise = _RADIO_STATUS(payload)
    return m.RadioStatus(rssi, remote_rssi, tx_buffer, noise, remote_noise, rx_errors, fixed)


def _timesync(payload: bytes) -> m.Timesync:
    return m.Timesync(*_TIMESYNC(payload))


def _ekf_status(payload: bytes) -> m.EkfStatus:
    return m.EkfStatus(*_EKF_STATUS(payload))


def _estimator_status(payload: bytes) -> m.EkfStatus:
    return m.EkfStatus(*_ESTIMATOR_STATUS(payload))


def _home_position(payload: bytes) -> m.HomePosition:
    lat, lon, alt_mm = _HOME_POSITION(payload)
    return m.HomePosition(Geodetic(lat / 1e7, lon / 1e7, alt_mm / 1e3))


def _extended_sys_state(payload: bytes) -> m.ExtendedSysState:
    return m.ExtendedSysState(_EXTENDED_SYS_STATE(payload)[1])


def _statustext(payload: bytes) -> m.StatusText:
    severity, text, chunk_id, chunk_seq = _STATUSTEXT(payload)
    return m.StatusText(severity, text.split(b"\0", 1)[0].decode("utf-8", "replace"), chunk_id, chunk_seq)


def _sar_rss(payload: bytes) -> m.RssSample:
    time_usec, beacon_id, frequency_hz, rss_cdbm, noise_cdbm, sequence = _SAR_RSS(payload)
    return m.RssSample(
        time_usec,
        beacon_id,
        frequency_hz,
        None if rss_cdbm == _INT16_MIN else rss_cdbm / 100.0,
        None if noise_cdbm == _INT16_MIN else noise_cdbm / 100.0,
        sequence,
    )


def _sar_aoa(payload: bytes) -> m.AoaSample:
    time_usec, beacon_id, azimuth, elevation, azimuth_std, elevation_std, frame = _SAR_AOA(payload)
    body_frame = frame == _FRAME_BODY_FRD
    return m.AoaSample(time_usec, beacon_id, azimuth, elevation, azimuth_std, elevation_std, body_frame)


def _sar_cir(payload: bytes) -> m.CirFragment:
    time_usec, beacon_id, spacing_ns, scale, first_path, *counts, encoding, length = _SAR_CIR(payload)
    capture_id, first_tap, tap_count, offset, fragment, fragment_count = counts
    return m.CirFragment(
        time_usec,
        beacon_id,
        spacing_ns,
        scale,
        first_path if math.isfinite(first_path) else None,
        capture_id,
        first_tap,
        tap_count,
        offset,
        fragment,
        fragment_count,
        encoding,
        payload[_CIR_FIXED_LENGTH : _CIR_FIXED_LENGTH + length],
    )


def _sar_link_state(payload: bytes) -> m.LinkStateReport:
    return m.LinkStateReport(*_SAR_LINK_STATE(payload))


_READERS: dict[int, Callable[[bytes], m.Message | None]] = {
    0: _heartbeat,
    1: _sys_status,
    2: _system_time,
    24: _gps_raw,
    30: _attitude,
    31: _attitude_quaternion,
    33: _global_position,
    77: _command_ack,
    87: _position_target,
    109: _radio_status,
    111: _timesync,
    193: _ekf_status,
    230: _estimator_status,
    242: _home_position,
    245: _extended_sys_state,
    253: _statustext,
    20800: _sar_rss,
    20801: _sar_aoa,
    20802: _sar_cir,
    20803: _sar_link_state,
}
_WANTED: dict[int, tuple[int, Callable[[bytes], m.Message | None]]] = {
    message_id: (CATALOGUE[message_id].length, reader) for message_id, reader in _READERS.items()
}
_TUNNELLED: dict[int, tuple[int, Callable[[bytes], m.Message | None]]] = {
    # What a tunnel cut off a SAR_CIR are no zeros that MAVLink cut: its data stays short.
    message_id: (_CIR_FIXED_LENGTH if message_id == 20802 else _WANTED[message_id][0], reader)
    for message_id, reader in _READERS.items()
    if message_id >= 20800
}

WANTED_IDS: frozenset[int] = frozenset(_WANTED) | {TUNNEL_ID}
"""Message ids that ``decode`` reads; all others are None."""


def decode(frame: Frame) -> m.Message | None:
    """The typed message of a verified frame.

    None for ids nobody wants, for tunnels of other payloads, and for an attitude that is none
    (NaN, or a quaternion whose norm is off by more than a factor of two). Never raises.
    """
    message_id = frame.message_id
    wanted = _WANTED.get(message_id)
    if wanted is None:
        if message_id != TUNNEL_ID:
            return None
        inner = unwrap(frame.payload)
        if inner is None:
            return None
        message_id, payload = inner
        wanted = _TUNNELLED.get(message_id)
        if wanted is None:
            return None
    else:
        payload = frame.payload
    length, reader = wanted
    if len(payload) < length:
        payload = payload.ljust(length, b"\0")
    return reader(payload)
