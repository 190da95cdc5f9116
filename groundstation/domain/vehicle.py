"""What a vehicle is and says of itself. Angles in radians, quaternions as in geometry.py."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from groundstation.domain.geometry import Geodetic, Quaternion

AUTOPILOT_COMPONENT = 1
"""MAV_COMP_ID_AUTOPILOT1."""
SENSOR_COMPONENT = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER: where the radio sensor speaks from."""


class Autopilot(StrEnum):
    """Which family of flight modes and answers to expect."""

    UNKNOWN = "unknown"
    ARDUPILOT = "ardupilot"
    PX4 = "px4"


@dataclass(frozen=True, slots=True)
class PlaceAccuracy:
    """How well a vehicle says that it knows where it is (GPS_RAW_INT)."""

    horizontal_m: float
    """Root mean square of the horizontal error, both axes together."""
    vertical_m: float | None
    """The same in height; None: it does not say."""
    corrected: bool
    """Whether a reference station corrects it (RTK, fix types 5 and 6)."""

    def std_m(self, assumed_m: tuple[float, float]) -> tuple[float, float]:
        """Standard deviation of each horizontal axis, and of height; ``assumed_m``: what is assumed unsaid.

        Without corrections never better than assumed: a receiver alone does not see what the ionosphere
        and reflections do to it.
        """
        said = self.horizontal_m / math.sqrt(2.0), self.vertical_m
        flat, upright = (mine if told is None else told for told, mine in zip(said, assumed_m, strict=True))
        if self.corrected:
            return flat, upright
        return max(flat, assumed_m[0]), max(upright, assumed_m[1])


@dataclass(frozen=True, slots=True)
class VehicleState:
    """The newest picture of one vehicle. A field that was never heard is None."""

    vehicle_id: int
    """MAVLink system id."""
    time_ns: int
    """Station time of this picture."""
    connections: tuple[str, ...]
    """Names of the connections it is heard on, newest first."""
    autopilot: Autopilot
    mode: str
    """Flight mode in the autopilot's own word (``GUIDED``, ``LOITER``, …) or ``unknown``."""
    armed: bool
    ready: bool
    """Position estimate valid and pre-arm checks healthy."""
    lost: bool
    """No heartbeat for five seconds."""
    last_heartbeat_ns: int
    position: Geodetic | None
    """None until the vehicle has a valid position."""
    position_time_ns: int | None
    height_above_home_m: float | None
    """GLOBAL_POSITION_INT.relative_alt."""
    home: Geodetic | None
    attitude: Quaternion | None
    velocity_ned_m_s: tuple[float, float, float] | None
    battery_percent: float | None
    battery_voltage_v: float | None
    gps_fix_type: int | None
    """MAVLink GPS_FIX_TYPE."""
    satellites: int | None
    position_target: Geodetic | None
    """Where the autopilot says it is going (POSITION_TARGET_GLOBAL_INT)."""
    sensor_heard_ns: int | None
    """Last frame of the radio sensor (component 191)."""
    packet_loss_percent: float | None
    """Sequence gaps over the last minute, all of this vehicle's components."""
    clock_offset_known: bool
    """Whether its times can be mapped to station time yet."""
    clock_uncertainty_ns: int | None = None
    """How far the autopilot's times may be off station time; None until they can be mapped."""
    place_accuracy: PlaceAccuracy | None = None
    """What its satellite receiver says of its place; None: nothing, or it has no fix."""
