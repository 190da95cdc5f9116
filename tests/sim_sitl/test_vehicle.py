"""The simulated autopilot answers as data recorded from a live ArduCopter 4.6 did."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from groundstation.domain.geometry import Geodetic, distance_m

SET_MODE, ARM, TAKEOFF, SET_INTERVAL, REQUEST, PAUSE = 176, 400, 22, 511, 512, 193
STABILIZE, GUIDED, LOITER, LAND, BRAKE = 0, 4, 5, 9, 17


def kinds(messages: list[Any]) -> set[str]:
    return {m.get_type() for m in messages if m.get_srcComponent() == 1}


def somewhere(talker: Any, east_m: float = 20.0, north_m: float = 30.0, up_m: float = 40.0) -> Geodetic:
    return talker.simulation.scenario.frame.to_geodetic((east_m, north_m, up_m))


def test_says_nothing_but_heartbeats_and_texts_until_asked(talk: Callable[..., Any]) -> None:
    talker = talk(airborne=False)
    assert kinds(talker.run(8.0)) == {"HEARTBEAT", "STATUSTEXT"}
    assert talker.long(SET_INTERVAL, 33, 200_000) == 0
    positions = [m for m in talker.run(2.0) if m.get_type() == "GLOBAL_POSITION_INT"]
    assert 9 <= len(positions) <= 11


def test_interval_of_a_message_it_does_not_have_fails_and_minus_one_stops(airborne: Any) -> None:
    assert airborne.long(SET_INTERVAL, 11_000, 100_000) == 4
    assert airborne.long(SET_INTERVAL, 30, 100_000) == 0
    assert "ATTITUDE" in kinds(airborne.run(1.0))
    assert airborne.long(SET_INTERVAL, 30, -1) == 0
    assert "ATTITUDE" not in kinds(airborne.run(1.0))


def test_boot_goes_from_zeros_to_ready_and_arms_only_then(talk: Callable[..., Any]) -> None:
    talker = talk(airborne=False)
    for message_id in (1, 2, 33, 193):
        talker.long(SET_INTERVAL, message_id, 500_000)
    talker.run(4.0)
    position, ekf = talker.last("GLOBAL_POSITION_INT"), talker.last("EKF_STATUS_REPORT")
    assert (position.lat, position.lon, position.alt) == (0, 0, 0)
    assert ekf.flags & 0x210 != 0x210
    assert talker.last("SYSTEM_TIME").time_unix_usec == 0
    assert talker.long(ARM, 1) == 4
    text = [m for m in talker.heard if m.get_type() == "STATUSTEXT" and m.severity == 2]
    assert text
    assert text[-1].text.startswith("Arm: ")
    assert talker.long(SET_MODE, 1, GUIDED) == 4, "GUIDED needs a position"
    talker.run(16.0)
    assert talker.last("GLOBAL_POSITION_INT").lat == pytest.approx(-353625000, abs=100)
    assert not talker.last("SYS_STATUS").onboard_control_sensors_health >> 28 & 1
    talker.run(24.0)
    assert talker.last("EKF_STATUS_REPORT").flags & 0x210 == 0x210
    assert talker.last("SYS_STATUS").onboard_control_sensors_health >> 28 & 1
    assert talker.last("SYSTEM_TIME").time_unix_usec > 1_700_000_000_000_000
    assert talker.long(ARM, 1) == 0


def test_takes_off_when_armed_and_guided_only_and_disarms_by_itself(talk: Callable[..., Any]) -> None:
    talker = talk(airborne=False, ready_after_s=1.0)
    talker.run(2.0)
    assert talker.long(SET_MODE, 1, GUIDED) == 0
    assert talker.long(TAKEOFF, 0, 0, 0, 0, 0, 0, 20) == 4, "disarmed"
    assert talker.long(ARM, 1) == 0
    talker.run(9.0)
    assert talker.simulation.vehicles[1].armed
    talker.run(1.5)
    assert not talker.simulation.vehicles[1].armed, "10 s without a take-off"
    assert talker.long(ARM, 1) == 0
    assert talker.long(TAKEOFF, 0, 0, 0, 0, 0, 0, 20) == 0
    talker.run(20.0)
    assert talker.simulation.vehicles[1].flight.position_m[2] == pytest.approx(20.0, abs=0.7)
    assert talker.last("HEARTBEAT").base_mode == 217
    assert talker.long(ARM, 0) == 4, "in the air"
    assert talker.long(SET_MODE, 1, LAND) == 0
    talker.run(40.0)
    assert not talker.simulation.vehicles[1].armed
    assert talker.simulation.vehicles[1].flight.position_m[2] == 0.0


@pytest.mark.parametrize(("frame", "result"), [(0, 0), (3, 0), (6, 0), (11, 4), (1, 2)])
def test_reposition_as_command_int_by_frame(airborne: Any, frame: int, result: int) -> None:
    place = somewhere(airborne)
    if frame in (3, 6):
        place = replace(place, altitude_amsl_m=40.0)
    assert airborne.reposition(place, frame) == result
    airborne.run(30.0)
    arrived = distance_m(airborne.simulation.vehicles[1].flight.position_enu_m, (20.0, 30.0, 40.0)) < 1.0
    assert arrived == (result == 0)


def test_reposition_as_command_long_is_unsupported(airborne: Any) -> None:
    assert airborne.long(192, -1, 1, 0, math.nan, -35.3625, 149.1654, 620) == 3


def test_reposition_with_an_impossible_latitude_is_denied(airborne: Any) -> None:
    assert airborne.reposition(Geodetic(100.0, 149.0, 620.0), 0, 1) == 2


def test_reposition_far_away_is_accepted(airborne: Any) -> None:
    assert airborne.reposition(Geodetic(-34.3625, 149.1654, 634.0)) == 0


def test_reposition_from_loiter_needs_the_flag_and_switches_to_guided(airborne: Any) -> None:
    assert airborne.long(SET_MODE, 1, LOITER) == 0
    airborne.run(8.0)
    assert math.hypot(*airborne.simulation.vehicles[1].flight.velocity_m_s) < 0.3
    assert airborne.reposition(somewhere(airborne)) == 2
    assert airborne.simulation.vehicles[1].mode == "LOITER"
    assert airborne.reposition(somewhere(airborne), 0, 1) == 0
    assert airborne.simulation.vehicles[1].mode == "GUIDED"


def test_unknown_mode_fails_and_unknown_command_is_unsupported(airborne: Any) -> None:
    assert airborne.long(SET_MODE, 1, 99) == 4
    assert airborne.long(SET_MODE, 0, GUIDED) == 2, "custom mode flag missing"
    assert airborne.long(31_999) == 3


def test_commands_to_others_are_not_answered(airborne: Any) -> None:
    from groundstation.mavlink.dialect import dialect

    airborne.send(dialect.MAVLink_command_long_message(2, 1, ARM, 0, 0, 0, 0, 0, 0, 0, 0))
    assert "COMMAND_ACK" not in kinds(airborne.run(0.2))


def test_reports_the_position_it_flies_to(airborne: Any) -> None:
    place = somewhere(airborne)
    airborne.reposition(place)
    assert airborne.long(REQUEST, 87) == 0
    target = airborne.last("POSITION_TARGET_GLOBAL_INT")
    assert target.lat_int == pytest.approx(place.latitude_deg * 1e7, abs=2)
    assert target.alt == pytest.approx(place.altitude_amsl_m, abs=0.01)
    assert target.type_mask & 0b111 == 0
    assert airborne.long(SET_MODE, 1, BRAKE) == 0
    assert airborne.long(REQUEST, 87) == 4, "no target outside GUIDED"


def test_home_on_request(airborne: Any) -> None:
    assert airborne.long(REQUEST, 242) == 0
    assert airborne.last("HOME_POSITION").altitude == 584_000


def test_pause_stops_and_continue_flies_on(airborne: Any) -> None:
    vehicle = airborne.simulation.vehicles[1]
    airborne.run(5.0)
    assert airborne.long(PAUSE, 0) == 0
    airborne.run(6.0)
    assert math.hypot(*vehicle.flight.velocity_m_s) < 0.3
    assert airborne.long(PAUSE, 1) == 0
    airborne.run(6.0)
    assert math.hypot(*vehicle.flight.velocity_m_s) == pytest.approx(8.0, abs=0.7)
    assert airborne.long(SET_MODE, 1, LOITER) == 0
    assert airborne.long(PAUSE, 0) == 4


def test_airborne_start_flies_the_ring_until_commanded(airborne: Any) -> None:
    vehicle = airborne.simulation.vehicles[1]
    for _ in range(6):
        airborne.run(5.0)
        east, north, up = vehicle.flight.position_enu_m
        assert math.hypot(east, north) == pytest.approx(100.0, abs=2.0)
        assert up == pytest.approx(50.0, abs=1.0)
        assert math.hypot(*vehicle.flight.velocity_m_s) == pytest.approx(8.0, abs=0.7)
    assert airborne.reposition(somewhere(airborne)) == 0
    airborne.run(30.0)
    assert distance_m(vehicle.flight.position_enu_m, (20.0, 30.0, 40.0)) < 1.0


def test_answers_timesync_with_its_own_clock(airborne: Any) -> None:
    from groundstation.mavlink.dialect import dialect

    airborne.send(dialect.MAVLink_timesync_message(0, 123_456_789))
    answers = [m for m in airborne.run(0.1) if m.get_type() == "TIMESYNC" and m.ts1 == 123_456_789]
    assert {m.get_srcComponent() for m in answers} == {1, 191}
    first, second = (m.tc1 for m in answers)
    assert abs(first - second) > 10_000_000, "autopilot and sensor have clocks of their own"


def test_px4_speaks_unasked_in_its_own_modes_and_loiters_on_reposition(px4: Any) -> None:
    messages = px4.run(2.0)
    assert {"GLOBAL_POSITION_INT", "ATTITUDE", "SYS_STATUS", "ESTIMATOR_STATUS"} <= kinds(messages)
    heartbeat = px4.last("HEARTBEAT")
    assert heartbeat.autopilot == 12
    assert heartbeat.custom_mode == 4 << 16 | 3 << 24, "AUTO.LOITER"
    assert px4.reposition(somewhere(px4), 0, 0) == 3, "PX4 wants the mode switch"
    assert px4.reposition(somewhere(px4), 0, 1) == 0
    px4.run(30.0)
    assert px4.last("HEARTBEAT").custom_mode == 4 << 16 | 3 << 24, "AUTO.LOITER"
    assert distance_m(px4.simulation.vehicles[1].flight.position_enu_m, (20.0, 30.0, 40.0)) < 1.0


def test_px4_flies_on_when_its_mode_is_set_again_and_stops_at_a_reposition_to_nowhere(px4: Any) -> None:
    vehicle = px4.simulation.vehicles[1]
    px4.reposition(somewhere(px4, -100.0, 0.0), 0, 1)
    px4.run(4.0)
    assert px4.long(SET_MODE, 1, 4, 3) == 0
    px4.run(1.0)
    assert math.hypot(*vehicle.flight.velocity_m_s) > 5.0
    assert px4.long(192, -1, 1, 0, math.nan, math.nan, math.nan, math.nan) == 0
    px4.run(6.0)
    assert math.hypot(*vehicle.flight.velocity_m_s) < 0.3


def test_px4_takes_off_and_lands(talk: Callable[..., Any]) -> None:
    from sim_sitl.modes import Flavour

    talker = talk(flavour=Flavour.PX4, airborne=False, ready_after_s=1.0)
    talker.run(2.0)
    assert talker.long(TAKEOFF, 0, 0, 0, math.nan, math.nan, math.nan, 604) == 1
    assert talker.long(ARM, 1) == 0
    assert talker.long(TAKEOFF, 0, 0, 0, math.nan, math.nan, math.nan, 604) == 0
    assert talker.simulation.vehicles[1].mode == "AUTO.TAKEOFF"
    talker.run(20.0)
    assert talker.simulation.vehicles[1].mode == "AUTO.LOITER"
    assert talker.long(ARM, 0) == 1
    assert talker.long(21) == 0
    talker.run(40.0)
    assert not talker.simulation.vehicles[1].armed
