"""Flight modes as ArduPilot and PX4 number them, and what our small autopilot does in each.

Keeps the rule that the two families differ only here and in their default streams.
"""

from __future__ import annotations

from enum import StrEnum

MAV_AUTOPILOT_ARDUPILOT = 3
MAV_AUTOPILOT_PX4 = 12


class Flavour(StrEnum):
    """Which autopilot is imitated."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"


class Behaviour(StrEnum):
    """What a mode makes of the vehicle."""

    MANUAL = "manual"
    """Nobody at the sticks: stays where it is."""
    HOLD = "hold"
    GUIDED = "guided"
    """Flies to where it is told."""
    AUTO = "auto"
    """Flies its own pattern."""
    RETURN = "return"
    LAND = "land"
    TAKEOFF = "takeoff"


ARDUCOPTER_MODES = {
    0: ("STABILIZE", Behaviour.MANUAL),
    2: ("ALT_HOLD", Behaviour.MANUAL),
    3: ("AUTO", Behaviour.AUTO),
    4: ("GUIDED", Behaviour.GUIDED),
    5: ("LOITER", Behaviour.HOLD),
    6: ("RTL", Behaviour.RETURN),
    9: ("LAND", Behaviour.LAND),
    16: ("POSHOLD", Behaviour.HOLD),
    17: ("BRAKE", Behaviour.HOLD),
    21: ("SMART_RTL", Behaviour.RETURN),
}
"""custom_mode: (name, behaviour)."""


def px4_mode(main: int, sub: int = 0) -> int:
    """PX4's custom_mode: main mode in the third byte, sub mode in the fourth."""
    return main << 16 | sub << 24


PX4_MODES = {
    px4_mode(2): ("ALTCTL", Behaviour.MANUAL),
    px4_mode(3): ("POSCTL", Behaviour.HOLD),
    px4_mode(4, 2): ("AUTO.TAKEOFF", Behaviour.TAKEOFF),
    px4_mode(4, 3): ("AUTO.LOITER", Behaviour.GUIDED),
    px4_mode(4, 4): ("AUTO.MISSION", Behaviour.AUTO),
    px4_mode(4, 5): ("AUTO.RTL", Behaviour.RETURN),
    px4_mode(4, 6): ("AUTO.LAND", Behaviour.LAND),
    px4_mode(7): ("STABILIZED", Behaviour.MANUAL),
}


def modes_of(flavour: Flavour) -> dict[int, tuple[str, Behaviour]]:
    """custom_mode → (name, behaviour)."""
    return ARDUCOPTER_MODES if flavour is Flavour.ARDUPILOT else PX4_MODES


def mode_number(flavour: Flavour, name: str) -> int:
    """custom_mode of a mode's name."""
    for number, (known, _) in modes_of(flavour).items():
        if known == name:
            return number
    raise ValueError(f"no mode {name!r}")
