"""Mode tables against the dialect's own enums."""

from __future__ import annotations

import pytest

from groundstation.domain.vehicle import Autopilot
from groundstation.mavlink.modes import mode_name
from groundstation.safety.modes import COMMANDABLE_MODES, REPOSITION_MODES, Airframe, airframe_of, hold_modes


@pytest.mark.parametrize(
    ("mav_type", "airframe"),
    [
        (2, Airframe.COPTER),
        (13, Airframe.COPTER),
        (1, Airframe.PLANE),
        (10, Airframe.GROUND),
        (6, Airframe.OTHER),
    ],
)
def test_airframes(mav_type, airframe):
    assert airframe_of(mav_type) is airframe


@pytest.mark.parametrize(
    ("autopilot", "mav_type"),
    [(Autopilot.ARDUPILOT, 2), (Autopilot.ARDUPILOT, 1), (Autopilot.ARDUPILOT, 10), (Autopilot.PX4, 2)],
)
def test_a_hold_mode_is_recognised_by_the_name_the_vehicle_will_show(autopilot, mav_type):
    modes = hold_modes(autopilot, airframe_of(mav_type))
    assert modes
    for mode in modes:
        assert mode_name(autopilot, mode.custom_mode, 1, mav_type) in mode.names


def test_copters_brake_first():
    assert [mode.names[0] for mode in hold_modes(Autopilot.ARDUPILOT, Airframe.COPTER)] == ["BRAKE", "LOITER"]


def test_no_mode_is_guessed_where_none_is_known():
    assert hold_modes(Autopilot.UNKNOWN, Airframe.COPTER) == ()
    assert hold_modes(Autopilot.ARDUPILOT, Airframe.OTHER) == ()


def test_a_vehicle_may_be_commanded_again_from_where_it_was_held_or_sent():
    for autopilot in (Autopilot.ARDUPILOT, Autopilot.PX4):
        held = {mode.names[0] for mode in hold_modes(autopilot, Airframe.COPTER)}
        assert held | REPOSITION_MODES[autopilot] <= COMMANDABLE_MODES[autopilot]
        assert not COMMANDABLE_MODES[autopilot] & {
            "RTL",
            "LAND",
            "AUTO",
            "AUTO.RTL",
            "AUTO.LAND",
            "STABILIZE",
        }
