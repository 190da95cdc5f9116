"""Typed messages: what the rest of the station sees of MAVLink.

SI units, radians, None where the wire says invalid or unknown. ``time_usec`` and
``boot_ms`` are in the sender's own clock; measurement/ maps them to station time.
"""

from __future__ import annotations

from dataclasses import dataclass

from groundstation.domain.geometry import Geodetic, Quaternion


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """HEARTBEAT (0)."""

    vehicle_type: int
    autopilot: int
    base_mode: int
    custom_mode: int
    system_status: int


@dataclass(frozen=True, slots=True)
class SysStatus:
    """SYS_STATUS (1)."""

    battery_voltage_v: float | None
    battery_percent: float | None
    prearm_healthy: bool
    """MAV_SYS_STATUS_PREARM_CHECK present, enabled and healthy."""


@dataclass(frozen=True, slots=True)
class SystemTime:
    """SYSTEM_TIME (2). ``unix_usec`` is None until the vehicle knows it."""

    unix_usec: int | None
    boot_ms: int


@dataclass(frozen=True, slots=True)
class GpsRaw:
    """GPS_RAW_INT (24). An accuracy is None where it is not told."""

    fix_type: int
    satellites: int | None
    horizontal_accuracy_m: float | None
    vertical_accuracy_m: float | None


@dataclass(frozen=True, slots=True)
class Attitude:
    """ATTITUDE (30) or ATTITUDE_QUATERNION (31)."""

    boot_ms: int
    attitude: Quaternion


@dataclass(frozen=True, slots=True)
class GlobalPosition:
    """GLOBAL_POSITION_INT (33). ``position`` is None before the vehicle has an estimate (0/0/0)."""

    boot_ms: int
    position: Geodetic | None
    height_above_home_m: float
    velocity_ned_m_s: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class CommandAck:
    """COMMAND_ACK (77)."""

    command: int
    result: int
    """MAV_RESULT."""
    progress: int | None
    target_system: int
    target_component: int


@dataclass(frozen=True, slots=True)
class PositionTarget:
    """POSITION_TARGET_GLOBAL_INT (87); None where the mask ignores the position."""

    boot_ms: int
    target: Geodetic | None
    """Altitude as sent: see ``frame``."""
    frame: int
    """MAV_FRAME."""


@dataclass(frozen=True, slots=True)
class RadioStatus:
    """RADIO_STATUS (109), injected by SiK radios, never signed."""

    rssi: int
    remote_rssi: int
    tx_buffer_percent: int
    noise: int
    remote_noise: int
    rx_errors: int
    fixed: int


@dataclass(frozen=True, slots=True)
class Timesync:
    """TIMESYNC (111), ns; ``tc1`` is 0 in a request."""

    tc1: int
    ts1: int


@dataclass(frozen=True, slots=True)
class EkfStatus:
    """EKF_STATUS_REPORT (193, ArduPilot) or ESTIMATOR_STATUS (230)."""

    flags: int


@dataclass(frozen=True, slots=True)
class HomePosition:
    """HOME_POSITION (242)."""

    position: Geodetic


@dataclass(frozen=True, slots=True)
class StatusText:
    """STATUSTEXT (253), one chunk."""

    severity: int
    text: str
    chunk_id: int
    chunk_seq: int


@dataclass(frozen=True, slots=True)
class ExtendedSysState:
    """EXTENDED_SYS_STATE (245)."""

    landed_state: int


@dataclass(frozen=True, slots=True)
class RssSample:
    """SAR_RSS (20800)."""

    time_usec: int
    beacon_id: int
    frequency_hz: int
    rss_dbm: float | None
    noise_dbm: float | None
    sequence: int


@dataclass(frozen=True, slots=True)
class AoaSample:
    """SAR_AOA (20801), as sent: azimuth from x towards y, elevation positive up."""

    time_usec: int
    beacon_id: int
    azimuth_rad: float
    elevation_rad: float
    azimuth_std_rad: float
    elevation_std_rad: float
    body_frame: bool
    """True: airframe (forward, right); False: earth (north, east)."""


@dataclass(frozen=True, slots=True)
class CirFragment:
    """SAR_CIR (20802): one fragment of a capture's bytes."""

    time_usec: int
    beacon_id: int
    tap_spacing_ns: float
    scale: float
    first_path_index: float | None
    capture_id: int
    first_tap: int
    tap_count: int
    offset: int
    fragment: int
    fragment_count: int
    encoding: int
    data: bytes
    """Cut to ``length``."""


@dataclass(frozen=True, slots=True)
class LinkStateReport:
    """SAR_LINK_STATE (20803)."""

    time_usec: int
    beacon_id: int
    los_probability: float
    classifier_version: int


Message = (
    Heartbeat
    | SysStatus
    | SystemTime
    | GpsRaw
    | Attitude
    | GlobalPosition
    | CommandAck
    | PositionTarget
    | RadioStatus
    | Timesync
    | EkfStatus
    | HomePosition
    | StatusText
    | ExtendedSysState
    | RssSample
    | AoaSample
    | CirFragment
    | LinkStateReport
)
