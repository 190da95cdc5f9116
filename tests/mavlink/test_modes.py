"""Mode names: those of the dialect's enums and of a real autopilot."""

from __future__ import annotations

import pytest

from groundstation.domain.vehicle import Autopilot
from groundstation.mavlink.decode import decode
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.framing import frame_of
from groundstation.mavlink.messages import Heartbeat
from groundstation.mavlink.modes import autopilot_of, is_armed, mode_name


@pytest.mark.parametrize(
    ("enum", "prefix", "vehicle_type"),
    [("COPTER_MODE", "COPTER_MODE_", 2), ("PLANE_MODE", "PLANE_MODE_", 1), ("ROVER_MODE", "ROVER_MODE_", 10)],
)
def test_ardupilot_numbers_are_the_dialects(enum: str, prefix: str, vehicle_type: int) -> None:
    for number, entry in dialect.enums[enum].items():
        if entry.name.endswith("_ENUM_END"):
            continue
        name = mode_name(Autopilot.ARDUPILOT, number, 81, vehicle_type)
        if not name.startswith("MODE_"):
            spelled = entry.name.removeprefix(prefix).replace("FLY_BY_WIRE_", "FBW")
            spelled = spelled.replace("INITIALIZING", "INITIALISING")
            assert name.replace("_", "") == spelled.replace("_", "")


@pytest.mark.parametrize(
    ("main", "sub", "name"),
    [(3, 0, "POSCTL"), (4, 3, "AUTO.LOITER"), (4, 4, "AUTO.MISSION"), (6, 0, "OFFBOARD"), (4, 5, "AUTO.RTL")],
)
def test_px4_main_and_sub(main: int, sub: int, name: str) -> None:
    number = main << 16 | sub << 24
    assert mode_name(Autopilot.PX4, number, 1) == name


def test_what_is_not_known_says_so() -> None:
    assert mode_name(Autopilot.ARDUPILOT, 99, 1) == "MODE_99"
    assert mode_name(Autopilot.PX4, 4 << 16 | 77 << 24, 1) == "AUTO.MODE_77"
    assert mode_name(Autopilot.UNKNOWN, 4, 1) == "unknown"
    assert mode_name(Autopilot.ARDUPILOT, 4, 0) == "unknown"


def test_the_recorded_flight_was_guided(recorded_frames: list[bytes]) -> None:
    names, armed = set(), set()
    for raw in recorded_frames:
        frame = frame_of(raw)
        if frame.message_id == 0 and frame.component_id == 1:
            beat = decode(frame)
            assert isinstance(beat, Heartbeat)
            assert autopilot_of(beat.autopilot) is Autopilot.ARDUPILOT
            names.add(mode_name(autopilot_of(beat.autopilot), beat.custom_mode, beat.base_mode))
            armed.add(is_armed(beat.base_mode))
    assert names == {"STABILIZE", "GUIDED"}
    assert armed == {False, True}
