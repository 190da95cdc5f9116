"""The guard, on real frames: what leaves, what does not, and that each refusal is counted."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.domain.geometry import Geodetic
from groundstation.domain.vehicle import Autopilot
from groundstation.mavlink import encode
from groundstation.mavlink.catalogue import CATALOGUE
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.framing import Framer, frame_of
from groundstation.safety.grants import Grants
from groundstation.safety.guard import HARMLESS_COMMANDS, HARMLESS_MESSAGES, Guard, Source
from groundstation.safety.modes import Airframe

NOW = 100 * 10**9
TARGET = Geodetic(-35.3625, 149.1654, 634.0)
NAN = math.nan


def frame(message):
    return frame_of(encode.Encoder().pack(message))


def reposition(vehicle_id=1, target=TARGET, mav_frame=0):
    return encode.command_int(vehicle_id, 1, 192, frame=mav_frame, params=(-1, 1, 0, NAN), place=target)


def set_mode(main, sub=0.0, vehicle_id=1, base=1.0):
    return encode.command_long(vehicle_id, 1, 176, (base, main, sub))


@pytest.fixture
def grants():
    return Grants()


@pytest.fixture
def guard(grants):
    guard = Guard(grants)
    guard.note_vehicle(1, Autopilot.ARDUPILOT, Airframe.COPTER)
    guard.note_vehicle(2, Autopilot.PX4, Airframe.COPTER)
    guard.note_vehicle(3, Autopilot.ARDUPILOT, Airframe.PLANE)
    return guard


def verdict(guard, message, source=Source.STATION, now=NOW):
    answer = guard.admit(frame(message), source, now)
    return answer.admitted, answer.reason


def test_a_reposition_needs_its_grant(guard, grants):
    assert verdict(guard, reposition()) == (False, "no_grant")
    grants.issue("c1", 1, 192, TARGET, NOW)
    assert verdict(guard, reposition()) == (True, "grant")
    assert verdict(guard, reposition(), Source.MAVSDK) == (True, "grant")
    assert verdict(guard, reposition(mav_frame=5)) == (True, "grant")
    assert verdict(guard, reposition(vehicle_id=2)) == (False, "no_grant")
    assert verdict(guard, reposition(target=Geodetic(-35.3635, 149.1654, 634.0))) == (False, "no_grant")
    # The same number, but above home: 584 m too high.
    assert verdict(guard, reposition(mav_frame=3)) == (False, "not_allowed")
    assert verdict(guard, reposition(vehicle_id=0)) == (False, "not_allowed")
    grants.hold(1, NOW)
    assert verdict(guard, reposition()) == (False, "no_grant")


def test_a_float_command_to_the_same_place_is_refused(guard, grants):
    grants.issue("c1", 1, 192, TARGET, NOW)
    message = encode.command_long(
        1, 1, 192, (-1, 1, 0, NAN, TARGET.latitude_deg, TARGET.longitude_deg, 634.0)
    )
    assert verdict(guard, message) == (False, "not_allowed")


@pytest.mark.parametrize(
    ("message", "admitted"),
    [
        (set_mode(17), True),
        (set_mode(5), True),
        (set_mode(17, NAN), True),
        (set_mode(4), False),  # GUIDED
        (set_mode(4, 3), False),  # PX4's hold is GUIDED here
        (set_mode(0), False),
        (set_mode(17, base=0.0), False),
        (set_mode(NAN), False),
        (set_mode(4, 3, vehicle_id=2), True),
        (set_mode(4, 4, vehicle_id=2), False),  # AUTO.MISSION
        (set_mode(5, vehicle_id=2), False),  # ACRO
        (set_mode(12, vehicle_id=3), True),
        (set_mode(17, vehicle_id=3), False),  # a plane's QSTABILIZE
        (set_mode(17, vehicle_id=9), False),  # never heard: numbers mean nothing
        (set_mode(17, vehicle_id=0), False),
        (encode.command_long(9, 1, 193, (0.0,)), True),
        (encode.command_long(1, 1, 193, (1.0,)), False),  # continue
        (encode.command_long(2, 1, 192, (-1, 1, 0, NAN, NAN, NAN, NAN)), True),  # PX4 stops in place
        (encode.command_long(2, 1, 192, (-1, 1, 0, NAN, NAN, NAN, 600.0)), False),
        (encode.command_long(1, 1, 192, (-1, 1, 0, NAN, NAN, NAN, NAN)), False),
        (dialect.MAVLink_set_mode_message(1, 1, 17), True),
        (dialect.MAVLink_set_mode_message(1, 1, 4), False),
        (dialect.MAVLink_set_mode_message(2, 1, 4 << 16 | 3 << 24), True),
    ],
)
def test_what_stops_a_vehicle_always_passes_and_nothing_that_looks_like_it(guard, message, admitted):
    assert verdict(guard, message) == (admitted, "hold" if admitted else "not_allowed")


@pytest.mark.parametrize(
    "message",
    [
        encode.heartbeat(),
        encode.set_message_interval(1, 1, 33, 200_000),
        encode.command_long(1, 1, 512, (242.0,)),
        encode.command_long(1, 1, 520, (1.0,)),
        encode.timesync_request(NOW),
        encode.cir_request(1, 191, 7, captures=10, interval_ms=1000),
        dialect.MAVLink_param_request_list_message(1, 1),
        dialect.MAVLink_mission_request_list_message(1, 1),
    ],
)
def test_what_moves_nothing_passes(guard, message):
    assert verdict(guard, message) == (True, "harmless")


@pytest.mark.parametrize("number", [20, 21, 22, 400, 185, 179, 178, 300, 192, 246])
def test_every_other_command_is_refused(guard, number):
    assert verdict(guard, encode.command_long(1, 1, number, (1.0,)))[0] is False


@pytest.mark.parametrize(
    "message",
    [
        dialect.MAVLink_param_set_message(1, 1, b"FENCE_ENABLE", 0.0, 9),
        dialect.MAVLink_mission_count_message(1, 1, 3, 0),
        dialect.MAVLink_rc_channels_override_message(1, 1, *([1500] * 8)),
        dialect.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0),
        dialect.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 6, 0, 0, 0, 50, 0, 0, 0, 0, 0, 0, 0, 0
        ),
        encode.heartbeat(),
    ],
)
def test_mavsdk_gets_nothing_else_out_and_no_second_heartbeat(guard, message):
    assert verdict(guard, message, Source.MAVSDK)[0] is False


@pytest.mark.parametrize("source", list(Source))
def test_a_replay_sends_nothing_ever(grants, source):
    guard = Guard(grants, forward_commands=True, replay=True)
    guard.note_vehicle(1, Autopilot.ARDUPILOT, Airframe.COPTER)
    grants.issue("c1", 1, 192, TARGET, NOW)
    for message in (encode.heartbeat(), set_mode(17), reposition(), encode.timesync_request(1)):
        assert verdict(guard, message, source) == (False, "replay")


class TestAnotherStation:
    def test_listens_only_by_default(self, guard):
        for message in (encode.heartbeat(), set_mode(17), reposition()):
            assert verdict(guard, message, Source.FORWARD) == (False, "listening_only")

    def test_commands_when_it_was_allowed_to_but_not_right_after_a_hold(self, grants):
        guard = Guard(grants, forward_commands=True)
        guard.note_vehicle(1, Autopilot.ARDUPILOT, Airframe.COPTER)
        broadcast = encode.command_long(0, 0, 22, (0.0,))
        assert verdict(guard, reposition(), Source.FORWARD) == (True, "other_station")
        grants.hold(1, NOW)
        assert verdict(guard, reposition(), Source.FORWARD) == (False, "held")
        assert verdict(guard, broadcast, Source.FORWARD) == (False, "held")
        assert verdict(guard, reposition(vehicle_id=2), Source.FORWARD) == (True, "other_station")
        assert verdict(guard, set_mode(17), Source.FORWARD) == (True, "hold")
        assert verdict(guard, reposition(), Source.FORWARD, NOW + 6 * 10**9) == (True, "other_station")


def test_the_verdict_says_where_it_goes(guard):
    answer = guard.admit(frame(encode.set_message_interval(2, 1, 33, 200_000)), Source.STATION, NOW)
    assert (answer.vehicle_id, answer.component_id, answer.command) == (2, 1, 511)
    assert guard.admit(frame(encode.heartbeat()), Source.STATION, NOW).vehicle_id is None
    request = guard.admit(
        frame(encode.cir_request(3, 191, 7, captures=1, interval_ms=9)), Source.STATION, NOW
    )
    assert (request.vehicle_id, request.component_id) == (3, 191)


def test_stamped_frames_have_no_gaps_and_a_good_crc(guard):
    framer = Framer()
    encoders = [encode.Encoder(), encode.Encoder()]
    sequences = []
    for index in range(300):
        raw = encoders[index % 2].pack(encode.heartbeat())
        (stamped,) = framer.feed(guard.stamp(frame_of(raw), "udp"))
        sequences.append(stamped.sequence)
    assert sequences == [index % 256 for index in range(300)]
    assert guard.stamp(frame_of(encoders[0].pack(encode.heartbeat())), "serial")[4] == 0


def test_each_verdict_is_counted(guard):
    verdict(guard, reposition())
    verdict(guard, reposition())
    verdict(guard, encode.heartbeat(), Source.MAVSDK)
    counted = {tuple(value for _, value in counter.labels): counter.value for counter in guard.counters()}
    assert counted == {("refused", "station", "no_grant"): 2, ("refused", "mavsdk", "second_heartbeat"): 1}


def test_the_harmless_lists_name_real_messages_and_commands():
    assert set(CATALOGUE) >= HARMLESS_MESSAGES
    assert set(dialect.enums["MAV_CMD"]) >= HARMLESS_COMMANDS
    for name in ("DO_REPOSITION", "DO_SET_MODE", "NAV_TAKEOFF", "COMPONENT_ARM_DISARM", "DO_PAUSE_CONTINUE"):
        assert getattr(dialect, f"MAV_CMD_{name}") not in HARMLESS_COMMANDS


@given(message_id=st.sampled_from(sorted(CATALOGUE)), payload=st.binary(min_size=1, max_size=255))
def test_without_a_grant_only_listed_messages_and_holds_leave_whatever_the_bytes(message_id, payload):
    guard = Guard(Grants())
    guard.note_vehicle(1, Autopilot.ARDUPILOT, Airframe.COPTER)
    raw = encode.Encoder().pack_payload(message_id, payload[: CATALOGUE[message_id].length])
    answer = guard.admit(frame_of(raw), Source.STATION, NOW)
    if not answer.admitted:
        return
    listed = message_id == 0 or message_id in HARMLESS_MESSAGES or answer.command in HARMLESS_COMMANDS
    assert listed or (answer.reason == "hold" and message_id in (11, 75, 76))
