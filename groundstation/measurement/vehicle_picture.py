"""The newest picture of one vehicle, drawn from whatever messages it sends.

Rule: nothing is assumed. What was never heard is None, and a vehicle is ready only when its
own estimator and its own pre-arm checks say so.
"""

from __future__ import annotations

from dataclasses import astuple
from typing import Any

from groundstation.domain.geometry import Geodetic, Quaternion
from groundstation.domain.vehicle import Autopilot, PlaceAccuracy, VehicleState
from groundstation.mavlink.messages import (
    EkfStatus,
    GlobalPosition,
    GpsRaw,
    Heartbeat,
    HomePosition,
    PositionTarget,
    SysStatus,
)
from groundstation.mavlink.modes import autopilot_of, is_armed, mode_name

MAV_AUTOPILOT_INVALID = 8
"""Heartbeats of what is no vehicle: ground stations, sensors, cameras."""
_MAV_TYPE_GCS = 6
_POSITION_ABSOLUTE = 0x210
"""POS_HORIZ_ABS and PRED_POS_HORIZ_ABS, alike in EKF_STATUS_REPORT and ESTIMATOR_STATUS."""
_FIX_3D = 3
_FIX_RTK = frozenset({5, 6})
"""GPS_FIX_TYPE: RTK float and fixed."""
_FRAMES_AMSL = frozenset({0, 5})
_FRAMES_ABOVE_HOME = frozenset({3, 6})
_CONNECTION_KEPT_NS = 60_000_000_000
_CONNECTIONS_MAX = 16

_PLAIN = (
    "heartbeat_ns",
    "autopilot",
    "mode",
    "armed",
    "lost",
    "ekf_flags",
    "prearm_healthy",
    "position_time_ns",
    "height_above_home_m",
    "battery_percent",
    "battery_voltage_v",
    "gps_fix_type",
    "satellites",
    "target_frame",
    "sensor_heard_ns",
)


def is_vehicle(heartbeat: Heartbeat) -> bool:
    """Whether a heartbeat is an autopilot's."""
    return heartbeat.autopilot != MAV_AUTOPILOT_INVALID and heartbeat.vehicle_type != _MAV_TYPE_GCS


class VehiclePicture:
    """What a vehicle said of itself last."""

    def __init__(self, vehicle_id: int) -> None:
        self.vehicle_id = vehicle_id
        self.heartbeat_ns = 0
        self.autopilot = Autopilot.UNKNOWN
        self.mode = "unknown"
        self.armed = False
        self.lost = False
        self.ekf_flags: int | None = None
        self.prearm_healthy: bool | None = None
        self.position: Geodetic | None = None
        self.position_time_ns: int | None = None
        self.height_above_home_m: float | None = None
        self.velocity_ned_m_s: tuple[float, float, float] | None = None
        self.home: Geodetic | None = None
        self.attitude: Quaternion | None = None
        self.battery_percent: float | None = None
        self.battery_voltage_v: float | None = None
        self.gps_fix_type: int | None = None
        self.satellites: int | None = None
        self.place_accuracy: PlaceAccuracy | None = None
        self.target: Geodetic | None = None
        self.target_frame: int | None = None
        self.sensor_heard_ns: int | None = None
        self.connections: dict[str, int] = {}

    def heartbeat(self, message: Heartbeat, time_ns: int) -> None:
        """HEARTBEAT of the autopilot."""
        self.heartbeat_ns = time_ns
        self.autopilot = autopilot_of(message.autopilot)
        self.mode = mode_name(self.autopilot, message.custom_mode, message.base_mode, message.vehicle_type)
        self.armed = is_armed(message.base_mode)

    def global_position(self, message: GlobalPosition, station_ns: int) -> None:
        """GLOBAL_POSITION_INT with a valid position."""
        self.position = message.position
        self.position_time_ns = station_ns
        self.height_above_home_m = message.height_above_home_m
        self.velocity_ned_m_s = message.velocity_ned_m_s

    def sys_status(self, message: SysStatus) -> None:
        """SYS_STATUS."""
        self.battery_percent = message.battery_percent
        self.battery_voltage_v = message.battery_voltage_v
        self.prearm_healthy = message.prearm_healthy

    def gps_raw(self, message: GpsRaw) -> None:
        """GPS_RAW_INT."""
        self.gps_fix_type = message.fix_type
        self.satellites = message.satellites
        told_m, fix = message.horizontal_accuracy_m, message.fix_type
        self.place_accuracy = (
            None
            if told_m is None or fix < _FIX_3D
            else PlaceAccuracy(told_m, message.vertical_accuracy_m, fix in _FIX_RTK)
        )

    def ekf_status(self, message: EkfStatus) -> None:
        """EKF_STATUS_REPORT or ESTIMATOR_STATUS."""
        self.ekf_flags = message.flags

    def home_position(self, message: HomePosition) -> None:
        """HOME_POSITION; one without a fix is not taken."""
        if message.position.is_valid():
            self.home = message.position

    def position_target(self, message: PositionTarget) -> None:
        """POSITION_TARGET_GLOBAL_INT."""
        self.target = message.target
        self.target_frame = message.frame

    @property
    def ready(self) -> bool:
        """Position estimate valid and pre-arm checks healthy."""
        flags = self.ekf_flags
        return (
            flags is not None
            and flags & _POSITION_ABSOLUTE == _POSITION_ABSOLUTE
            and bool(self.prearm_healthy)
        )

    @property
    def urgent(self) -> tuple[str, bool, bool, bool]:
        """What must be shown at once when it changes."""
        return self.mode, self.armed, self.lost, self.ready

    def missing(self) -> str:
        """Why there is no position, in the operator's words."""
        if self.gps_fix_type is None:
            return "it sends no GLOBAL_POSITION_INT with a position and no GPS_RAW_INT"
        if self.gps_fix_type < _FIX_3D:
            seen = "" if self.satellites is None else f", {self.satellites} satellites"
            return f"its GPS has no fix (type {self.gps_fix_type}{seen})"
        if self.ekf_flags is None or self.ekf_flags & _POSITION_ABSOLUTE != _POSITION_ABSOLUTE:
            return "its GPS has a fix, but its position estimate is not valid yet"
        return "it sends no GLOBAL_POSITION_INT"

    def snapshot(
        self, time_ns: int, packet_loss_percent: float | None, clock_uncertainty_ns: int | None
    ) -> VehicleState:
        """The picture as a value; ``clock_uncertainty_ns`` is None until the clock is mapped."""
        connections = sorted(self.connections.items(), key=lambda item: (-item[1], item[0]))
        if len(connections) > _CONNECTIONS_MAX:
            connections = connections[:_CONNECTIONS_MAX]
            self.connections = dict(connections)
        recent = [name for name, heard_ns in connections if time_ns - heard_ns < _CONNECTION_KEPT_NS]
        return VehicleState(
            vehicle_id=self.vehicle_id,
            time_ns=time_ns,
            connections=tuple(recent or [name for name, _ in connections[:1]]),
            autopilot=self.autopilot,
            mode=self.mode,
            armed=self.armed,
            ready=self.ready,
            lost=self.lost,
            last_heartbeat_ns=self.heartbeat_ns,
            position=self.position,
            position_time_ns=self.position_time_ns,
            height_above_home_m=self.height_above_home_m,
            home=self.home,
            attitude=self.attitude,
            velocity_ned_m_s=self.velocity_ned_m_s,
            battery_percent=self.battery_percent,
            battery_voltage_v=self.battery_voltage_v,
            gps_fix_type=self.gps_fix_type,
            satellites=self.satellites,
            position_target=self._target_amsl(),
            sensor_heard_ns=self.sensor_heard_ns,
            packet_loss_percent=packet_loss_percent,
            clock_offset_known=clock_uncertainty_ns is not None,
            clock_uncertainty_ns=clock_uncertainty_ns,
            place_accuracy=self.place_accuracy,
        )

    def _target_amsl(self) -> Geodetic | None:
        target = self.target
        if target is None or self.target_frame in _FRAMES_AMSL:
            return target
        if self.target_frame not in _FRAMES_ABOVE_HOME:
            # Above terrain: the station does not know the vehicle's terrain.
            return None
        if self.home is not None:
            home_m = self.home.altitude_amsl_m
        elif self.position is not None and self.height_above_home_m is not None:
            home_m = self.position.altitude_amsl_m - self.height_above_home_m
        else:
            return None
        return Geodetic(target.latitude_deg, target.longitude_deg, target.altitude_amsl_m + home_m)

    def state(self) -> dict[str, Any]:
        """Everything, as a tree for a snapshot."""
        return {
            **{name: getattr(self, name) for name in _PLAIN},
            "autopilot": self.autopilot.value,
            "position": _place_state(self.position),
            "home": _place_state(self.home),
            "target": _place_state(self.target),
            "velocity_ned_m_s": None if self.velocity_ned_m_s is None else list(self.velocity_ned_m_s),
            "attitude": None if self.attitude is None else list(self.attitude),
            "place_accuracy": None if self.place_accuracy is None else list(astuple(self.place_accuracy)),
            "connections": [list(item) for item in self.connections.items()],
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state()`` gave."""
        for name in _PLAIN:
            setattr(self, name, tree[name])
        self.autopilot = Autopilot(tree["autopilot"])
        self.position = _place_of(tree["position"])
        self.home = _place_of(tree["home"])
        self.target = _place_of(tree["target"])
        velocity, attitude = tree["velocity_ned_m_s"], tree["attitude"]
        self.velocity_ned_m_s = None if velocity is None else (velocity[0], velocity[1], velocity[2])
        self.attitude = None if attitude is None else (attitude[0], attitude[1], attitude[2], attitude[3])
        accuracy = tree.get("place_accuracy")
        self.place_accuracy = None if accuracy is None else PlaceAccuracy(*accuracy)
        self.connections = dict(tree["connections"])


def _place_state(place: Geodetic | None) -> list[float] | None:
    return None if place is None else [place.latitude_deg, place.longitude_deg, place.altitude_amsl_m]


def _place_of(kept: list[float] | None) -> Geodetic | None:
    return None if kept is None else Geodetic(kept[0], kept[1], kept[2])
