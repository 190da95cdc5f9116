"""Flight modes by name: HEARTBEAT.custom_mode means what each autopilot says it means.

ArduPilot numbers its modes per airframe; PX4 packs a main and a sub mode. Names are the
autopilots' own words, as their other ground stations show them.
"""

from __future__ import annotations

from groundstation.domain.vehicle import Autopilot

CUSTOM_MODE_ENABLED = 0x01
"""MAV_MODE_FLAG_CUSTOM_MODE_ENABLED."""
SAFETY_ARMED = 0x80
"""MAV_MODE_FLAG_SAFETY_ARMED."""
UNKNOWN_MODE = "unknown"

_AUTOPILOTS = {3: Autopilot.ARDUPILOT, 12: Autopilot.PX4}
"""MAV_AUTOPILOT_ARDUPILOTMEGA, MAV_AUTOPILOT_PX4."""

_COPTER = {
    0: "STABILIZE",
    1: "ACRO",
    2: "ALT_HOLD",
    3: "AUTO",
    4: "GUIDED",
    5: "LOITER",
    6: "RTL",
    7: "CIRCLE",
    9: "LAND",
    11: "DRIFT",
    13: "SPORT",
    14: "FLIP",
    15: "AUTOTUNE",
    16: "POSHOLD",
    17: "BRAKE",
    18: "THROW",
    19: "AVOID_ADSB",
    20: "GUIDED_NOGPS",
    21: "SMART_RTL",
    22: "FLOWHOLD",
    23: "FOLLOW",
    24: "ZIGZAG",
    25: "SYSTEMID",
    26: "AUTOROTATE",
    27: "AUTO_RTL",
    28: "TURTLE",
}
_PLANE = {
    0: "MANUAL",
    1: "CIRCLE",
    2: "STABILIZE",
    3: "TRAINING",
    4: "ACRO",
    5: "FBWA",
    6: "FBWB",
    7: "CRUISE",
    8: "AUTOTUNE",
    10: "AUTO",
    11: "RTL",
    12: "LOITER",
    13: "TAKEOFF",
    14: "AVOID_ADSB",
    15: "GUIDED",
    16: "INITIALISING",
    17: "QSTABILIZE",
    18: "QHOVER",
    19: "QLOITER",
    20: "QLAND",
    21: "QRTL",
    22: "QAUTOTUNE",
    23: "QACRO",
    24: "THERMAL",
    25: "LOITER_ALT_QLAND",
}
_ROVER = {
    0: "MANUAL",
    1: "ACRO",
    3: "STEERING",
    4: "HOLD",
    5: "LOITER",
    6: "FOLLOW",
    7: "SIMPLE",
    8: "DOCK",
    9: "CIRCLE",
    10: "AUTO",
    11: "RTL",
    12: "SMART_RTL",
    15: "GUIDED",
    16: "INITIALISING",
}
_PX4_MAIN = {
    1: "MANUAL",
    2: "ALTCTL",
    3: "POSCTL",
    4: "AUTO",
    5: "ACRO",
    6: "OFFBOARD",
    7: "STABILIZED",
    8: "RATTITUDE",
    10: "TERMINATION",
}
_PX4_SUB = {
    (3, 1): "ORBIT",
    (3, 2): "SLOW",
    (4, 1): "READY",
    (4, 2): "TAKEOFF",
    (4, 3): "LOITER",
    (4, 4): "MISSION",
    (4, 5): "RTL",
    (4, 6): "LAND",
    (4, 8): "FOLLOW_TARGET",
    (4, 9): "PRECLAND",
    (4, 10): "VTOL_TAKEOFF",
}
_PLANE_TYPES = frozenset({1, 16, 19, 20, 21, 22, 23, 24, 25, 28})
_ROVER_TYPES = frozenset({10, 11})
_COPTER_TYPE = 2
"""MAV_TYPE_QUADROTOR."""


def autopilot_of(mav_autopilot: int) -> Autopilot:
    """Family of a HEARTBEAT's MAV_AUTOPILOT."""
    return _AUTOPILOTS.get(mav_autopilot, Autopilot.UNKNOWN)


def is_armed(base_mode: int) -> bool:
    """Whether a HEARTBEAT's base_mode says armed."""
    return bool(base_mode & SAFETY_ARMED)


def mode_name(
    autopilot: Autopilot, custom_mode: int, base_mode: int, vehicle_type: int = _COPTER_TYPE
) -> str:
    """The mode's name (``GUIDED``, ``AUTO.LOITER``); ``unknown`` where nothing says what it means.

    ``vehicle_type`` is HEARTBEAT's MAV_TYPE: ArduPilot's numbers depend on it. A number that the
    tables lack is shown as ``MODE_<number>``.
    """
    if not base_mode & CUSTOM_MODE_ENABLED:
        return UNKNOWN_MODE
    if autopilot is Autopilot.ARDUPILOT:
        return _ardupilot_table(vehicle_type).get(custom_mode, f"MODE_{custom_mode}")
    if autopilot is Autopilot.PX4:
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        name = _PX4_MAIN.get(main, f"MODE_{main}")
        if not sub:
            return name
        return f"{name}.{_PX4_SUB.get((main, sub), f'MODE_{sub}')}"
    return UNKNOWN_MODE


def _ardupilot_table(vehicle_type: int) -> dict[int, str]:
    if vehicle_type in _PLANE_TYPES:
        return _PLANE
    return _ROVER if vehicle_type in _ROVER_TYPES else _COPTER
