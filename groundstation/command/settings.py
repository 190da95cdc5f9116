"""What the command room may be told."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class CommandSettings:
    """Identity on the air, patience with commands."""

    system_id: int = 255
    """MAVLink system id of this ground station."""
    component_id: int = 190
    """MAVLink component id of this ground station (MAV_COMP_ID_MISSIONPLANNER)."""
    ack_timeout_s: float = 1.0
    """Wait for an acknowledgement before a reposition is sent again, seconds."""
    attempts: int = 3
    """How often a reposition is sent at most."""
    use_mavsdk: bool = False
    """Whether repositions leave through MAVSDK instead of our own protocol; holds never do."""
    progress_timeout_s: float = 10.0
    """Wait for the final answer after ``in progress``, seconds."""
    verify_timeout_s: float = 5.0
    """Wait for mode and target after an acknowledgement, seconds."""
    target_tolerance_m: float = 3.0
    """How far the autopilot's own target may be from the commanded one, metres."""
    approach_m: float = 5.0
    """A vehicle this much nearer to its target is on its way, metres."""
    arrive_m: float = 4.0
    """A vehicle this near to its target has arrived, metres."""
    slowest_m_s: float = 1.0
    """A vehicle that flies slower than this to its target has not arrived in time, m/s."""
    flight_grace_s: float = 30.0
    """Added to the longest time a flight may take, seconds."""
    hold_retry_s: float = 0.5
    """Wait before a hold is sent again, seconds."""
    hold_attempts: int = 20
    """How often a hold is sent at most, all its modes together."""
    stopped_m_s: float = 1.0
    """A vehicle slower than this has stopped, m/s."""
    hold_watch_s: float = 5.0
    """How long after a verified hold a vehicle that moves on is held again, seconds."""


@dataclass(frozen=True, slots=True)
class StreamRequest:
    """A message that every autopilot is asked for."""

    message_id: int
    """MAVLink message id."""
    rate_hz: float
    """How often it shall come, 1/s."""
    optional: bool = False
    """Asked for a few times only: not every autopilot has it."""


DEFAULT_STREAMS = (
    StreamRequest(33, 5.0),  # GLOBAL_POSITION_INT
    StreamRequest(30, 5.0),  # ATTITUDE
    StreamRequest(1, 0.5),  # SYS_STATUS
    StreamRequest(24, 0.5),  # GPS_RAW_INT
    StreamRequest(2, 0.5),  # SYSTEM_TIME
    StreamRequest(87, 1.0, optional=True),  # POSITION_TARGET_GLOBAL_INT
    StreamRequest(193, 1.0, optional=True),  # EKF_STATUS_REPORT (ArduPilot)
    StreamRequest(230, 1.0, optional=True),  # ESTIMATOR_STATUS (PX4)
)
"""About 330 B/s a vehicle."""


@dataclass(frozen=True, slots=True)
class TelemetrySettings:
    """What the station asks of vehicles and tells them."""

    heartbeat_s: float = 1.0
    """Interval of our HEARTBEAT, seconds."""
    streams: tuple[StreamRequest, ...] = DEFAULT_STREAMS
    """Messages asked for with SET_MESSAGE_INTERVAL."""
    request_retry_s: float = 2.0
    """First wait before an unanswered request is repeated, doubled each time, seconds."""
    request_retry_max_s: float = 30.0
    """Longest wait between repetitions, seconds."""
    optional_attempts: int = 4
    """How often an optional message is asked for."""
    home_refresh_s: float = 30.0
    """Home is asked for again this often: arming moves it, seconds."""
    timesync_s: float = 10.0
    """Interval of TIMESYNC requests to each vehicle after the first few, seconds."""
    estimate_s: float = 1.0
    """Interval of SAR_TARGET_ESTIMATE for each beacon, seconds; 0: never."""
    cir_interval_ms: int = 1000
    """Smallest interval between impulse responses of one link, milliseconds; 0: none are asked for."""
    cir_taps: int = 0
    """Window asked for, taps; 0: the sensor's own round the first path (64 taps, one frame)."""
    cir_captures: int = 10
    """Responses asked for at once; asked again before they run out (at most 255)."""
    cir_budget_serial_bytes_s: float = 600.0
    """Bytes a second that impulse responses may take on a serial connection (a telemetry radio)."""
    cir_budget_network_bytes_s: float = 60_000.0
    """Bytes a second that impulse responses may take on any other connection."""
    link_active_s: float = 10.0
    """A link without samples for longer is not asked for responses, seconds."""


@dataclass(frozen=True, slots=True)
class CommandRoomSettings:
    """All settings of this room."""

    command: CommandSettings = field(default_factory=CommandSettings)
    telemetry: TelemetrySettings = field(default_factory=TelemetrySettings)
