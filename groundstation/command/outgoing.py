"""The two commands of this room as messages: go there, stop."""

from __future__ import annotations

import math
from typing import Any

from groundstation.domain.geometry import Geodetic
from groundstation.domain.vehicle import AUTOPILOT_COMPONENT
from groundstation.mavlink import encode
from groundstation.safety.guard import MAV_CMD_DO_PAUSE_CONTINUE, MAV_CMD_DO_REPOSITION, MAV_CMD_DO_SET_MODE
from groundstation.safety.modes import CUSTOM_MODE_ENABLED, HoldMode

__all__ = [
    "MAV_CMD_DO_PAUSE_CONTINUE",
    "MAV_CMD_DO_REPOSITION",
    "MAV_CMD_DO_SET_MODE",
    "hold",
    "reposition",
]

_MAV_FRAME_GLOBAL = 0
_DEFAULT_SPEED = -1.0
_CHANGE_MODE = 1.0
"""MAV_DO_REPOSITION_FLAGS_CHANGE_MODE: leave LOITER or BRAKE for the mode that flies there."""
_NAN = math.nan


def reposition(vehicle_id: int, target: Geodetic) -> Any:
    """COMMAND_INT DO_REPOSITION: heading as it is, altitude above mean sea level."""
    return encode.command_int(
        vehicle_id,
        AUTOPILOT_COMPONENT,
        MAV_CMD_DO_REPOSITION,
        frame=_MAV_FRAME_GLOBAL,
        params=(_DEFAULT_SPEED, _CHANGE_MODE, 0.0, _NAN),
        place=target,
    )


def hold(vehicle_id: int, mode: HoldMode | None, confirmation: int) -> Any:
    """COMMAND_LONG that stops the vehicle; without a known mode DO_PAUSE_CONTINUE."""
    params: tuple[float, ...]
    if mode is None:
        command, params = MAV_CMD_DO_PAUSE_CONTINUE, (0.0,)
    elif mode.in_place:
        command, params = MAV_CMD_DO_REPOSITION, (_DEFAULT_SPEED, _CHANGE_MODE, 0.0, _NAN, _NAN, _NAN, _NAN)
    else:
        command = MAV_CMD_DO_SET_MODE
        params = (float(CUSTOM_MODE_ENABLED), float(mode.main_mode), float(mode.sub_mode))
    return encode.command_long(vehicle_id, AUTOPILOT_COMPONENT, command, params, confirmation)
