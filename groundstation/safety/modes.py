"""Flight modes that matter to safety: which stop a vehicle, and which may be taken over.

A mode number means nothing without the autopilot and the airframe: 17 stops an ArduPilot
copter (BRAKE) and lets an ArduPilot plane hover by stick (QSTABILIZE); 4 is GUIDED to an
ArduPilot copter and the automatic modes to PX4. So each table is keyed by both.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from groundstation.domain.vehicle import Autopilot

CUSTOM_MODE_ENABLED = 1
"""MAV_MODE_FLAG_CUSTOM_MODE_ENABLED."""


class Airframe(StrEnum):
    """What a mode number depends on besides the autopilot."""

    COPTER = "copter"
    PLANE = "plane"
    GROUND = "ground"
    OTHER = "other"


_COPTER_TYPES = frozenset({2, 3, 4, 13, 14, 15, 29, 35})
_PLANE_TYPES = frozenset({1, 19, 20, 21, 22, 23, 24, 25, 28})
_GROUND_TYPES = frozenset({10, 11})


def airframe_of(mav_type: int) -> Airframe:
    """Airframe of a HEARTBEAT's MAV_TYPE."""
    if mav_type in _COPTER_TYPES:
        return Airframe.COPTER
    if mav_type in _PLANE_TYPES:
        return Airframe.PLANE
    return Airframe.GROUND if mav_type in _GROUND_TYPES else Airframe.OTHER


@dataclass(frozen=True, slots=True)
class HoldMode:
    """A way to make a vehicle stay where it is."""

    names: tuple[str, ...]
    """Words for it, as ``VehicleState.mode`` may have them."""
    main_mode: int
    """param2 of MAV_CMD_DO_SET_MODE."""
    sub_mode: int = 0
    """param3 (PX4)."""
    in_place: bool = False
    """Sent as MAV_CMD_DO_REPOSITION to no place (NaN), not as MAV_CMD_DO_SET_MODE."""

    @property
    def custom_mode(self) -> int:
        """HEARTBEAT's custom_mode; PX4 packs its main and sub mode into the two upper bytes."""
        return self.main_mode << 16 | self.sub_mode << 24 if self.sub_mode else self.main_mode


# BRAKE first: LOITER takes its climb rate from the throttle stick, and without a
# transmitter, or with the stick low, the vehicle descends. BRAKE ignores the sticks and,
# unlike GUIDED at its own place, does not follow a stray position target.
_ARDUPILOT_HOLDS: dict[Airframe, tuple[HoldMode, ...]] = {
    Airframe.COPTER: (HoldMode(("BRAKE",), 17), HoldMode(("LOITER",), 5)),
    Airframe.PLANE: (HoldMode(("LOITER",), 12),),
    Airframe.GROUND: (HoldMode(("HOLD",), 4),),
    Airframe.OTHER: (),
}
_PX4_LOITER_NAMES = ("AUTO.LOITER", "HOLD", "LOITER", "AUTO_LOITER")
# PX4 flies to a reposition target in the mode that also holds it: setting that mode again
# changes nothing and it flies on. A reposition to nowhere stops it.
_PX4_HOLDS = (HoldMode(_PX4_LOITER_NAMES, 4, 3, in_place=True), HoldMode(_PX4_LOITER_NAMES, 4, 3))


def hold_modes(autopilot: Autopilot, airframe: Airframe) -> tuple[HoldMode, ...]:
    """Modes that stop the vehicle, best first; empty where none is known."""
    if autopilot is Autopilot.ARDUPILOT:
        return _ARDUPILOT_HOLDS[airframe]
    return _PX4_HOLDS if autopilot is Autopilot.PX4 else ()


REPOSITION_MODES: dict[Autopilot, frozenset[str]] = {
    Autopilot.ARDUPILOT: frozenset({"GUIDED"}),
    Autopilot.PX4: frozenset(_PX4_LOITER_NAMES),
    Autopilot.UNKNOWN: frozenset(),
}
"""Modes in which a vehicle flies to a DO_REPOSITION target."""

# Not RTL, LAND or another fail-safe, not AUTO (somebody's mission), not a pilot's manual
# modes: from those nobody is taken over by a click.
COMMANDABLE_MODES: dict[Autopilot, frozenset[str]] = {
    Autopilot.ARDUPILOT: frozenset({"GUIDED", "LOITER", "BRAKE", "POSHOLD"}),
    Autopilot.PX4: frozenset({*_PX4_LOITER_NAMES, "POSCTL", "POSITION"}),
    Autopilot.UNKNOWN: frozenset(),
}
"""Modes from which a vehicle may be sent somewhere."""
