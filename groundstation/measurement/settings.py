"""Every number of this room that a field engineer may have a reason to change."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MeasurementSettings:
    """Windows, waiting, clocks and bounds of everything between a frame and a link window."""

    window_samples: int = 16
    """M: a window closes when each kind of sample heard in it has this many."""
    window_age_s: float = 4.0
    """Longest time one window may cover, seconds."""
    window_distance_m: float = 20.0
    """Longest flown path one window may cover, metres."""
    window_settle_s: float = 1.0
    """How long after its age a window waits, on ticks, for samples still under way, seconds."""
    window_captures: int = 16
    """Most impulse responses kept in one window; the oldest make room."""
    late_tolerance_s: float = 0.5
    """A sample this much older than its link's open window is still taken in, seconds."""
    link_state_max_age_s: float = 10.0
    """A sensor's own line-of-sight answer is attached to windows for this long, seconds."""
    angle_std_default_rad: float = 0.175
    """Standard error of a single angle whose sensor reports none, radians (10 degrees)."""

    pose_wait_s: float = 2.0
    """How long a sample waits for a pose newer than itself, seconds."""
    pose_extrapolate_s: float = 0.3
    """After waiting in vain, how far past the newest pose a sample may still be placed, seconds."""
    pose_gap_s: float = 2.5
    """Poses further apart than this are not interpolated across, seconds."""
    pose_history: int = 256
    """Positions, and attitudes, kept for each vehicle."""
    waiting_samples: int = 4096
    """Samples of one vehicle that may wait for a pose; the oldest make room."""

    clock_window_s: float = 30.0
    """The fastest message of this long decides a clock's offset, seconds."""
    clock_forward_step_s: float = 1.0
    """A sender's time ahead of its map by more than this is a step, once confirmed, seconds."""
    clock_backward_step_s: float = 5.0
    """A sender's time behind its map by more than this is a reboot or step, once confirmed, seconds."""
    clock_confirm_count: int = 3
    """Consecutive agreeing messages that confirm a step."""
    clock_confirm_s: float = 0.15
    """And the least time they must span, seconds: a burst of old messages is not a step."""
    clock_min_delay_s: float = 0.1
    """Assumed delay of the fastest message where no TIMESYNC bounds it, seconds (uncertainty only)."""

    cir_timeout_s: float = 3.0
    """An incomplete impulse response is given up this long after its first fragment, seconds."""
    cir_in_flight: int = 64
    """Incomplete impulse responses kept for each vehicle; the oldest make room."""
    cir_report_s: float = 10.0
    """Incomplete captures are told to the operator at most this often, seconds."""

    beacon_rate_max_hz: float = 100.0
    """Fastest believable packet rate of a beacon: a larger jump of its sequence is a restart, hertz."""
    links_per_vehicle: int = 1024
    """Beacons followed for each vehicle; samples of more are counted and dropped."""

    vehicles: int = 250
    """Systems followed; more are counted and ignored (MAVLink has 255 ids)."""
    vehicle_lost_s: float = 5.0
    """Silence of a vehicle's heartbeat that makes it lost, seconds."""
    settle_s: float = 5.0
    """Samples of a vehicle that was found less long ago and sends no pose yet are dropped without a word
    (and counted), seconds."""
    no_position_s: float = 10.0
    """A vehicle without a position for this long is told to the operator, seconds."""
    state_interval_s: float = 0.2
    """Least time between two pictures of a vehicle when nothing urgent changed, seconds."""
    activity_interval_s: float = 0.2
    """Least time between two activity reports of a link, seconds."""
    duplicate_s: float = 2.0
    """The same frame on a second connection within this time is dropped, seconds."""
    unknown_system_s: float = 5.0
    """Radio samples of a system whose autopilot stays silent this long are told to the operator, seconds."""

    listening_interval_s: float = 2.0
    """Length of the intervals by which it is told who listened where, seconds."""
    listening_alive_s: float = 3.0
    """A vehicle listens while its sensor said anything within this time, seconds."""
