"""Encoding: frames that pymavlink reads back, with their sequence, and rewriting that keeps the CRC right."""

from __future__ import annotations

from typing import Any

import pytest

from groundstation.domain.errors import InternalError, PeerError
from groundstation.domain.geometry import Geodetic
from groundstation.domain.target import Environment, TargetState
from groundstation.mavlink import encode
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder, rewrite
from groundstation.mavlink.framing import Framer, frame_of


def decoded(raw: bytes) -> Any:
    """The reference decoder's answer; it checks the CRC."""
    return dialect.MAVLink(None).decode(bytearray(raw))


def test_frames_are_those_of_pymavlink(recorded_frames: list[bytes]) -> None:
    reference = dialect.MAVLink(None, srcSystem=3, srcComponent=7)
    encoder = Encoder(3, 7)
    for raw in recorded_frames[::97]:
        message = decoded(raw)
        reference.seq = encoder.sequence
        expected = message.pack(reference)
        assert encoder.pack(message) == expected


def test_sequence_counts_and_comes_round() -> None:
    encoder = Encoder()
    frames = [frame_of(encoder.pack(encode.heartbeat())) for _ in range(257)]
    assert [frame.sequence for frame in frames] == [*range(256), 0]
    assert {(frame.system_id, frame.component_id) for frame in frames} == {(255, 190)}


def test_heartbeat_is_a_ground_stations() -> None:
    message = decoded(Encoder().pack(encode.heartbeat()))
    assert (message.type, message.autopilot, message.mavlink_version) == (6, 8, 3)


def test_command_int_carries_the_place() -> None:
    place = Geodetic(-35.3625, 149.1654, 634.5)
    message = decoded(
        Encoder().pack(encode.command_int(2, 1, 192, frame=0, params=(-1.0, 1.0, 0.0, 0.5), place=place))
    )
    assert (message.target_system, message.target_component, message.frame, message.command) == (2, 1, 0, 192)
    assert (message.x, message.y, message.z) == (-353_625_000, 1_491_654_000, 634.5)
    assert (message.param1, message.param2, message.param4) == (-1.0, 1.0, 0.5)
    other = decoded(Encoder().pack(encode.command_int(2, 1, 192, frame=6, place=place, altitude_m=50.0)))
    assert (other.frame, other.z) == (6, 50.0)


def test_the_stations_other_messages() -> None:
    encoder = Encoder()
    interval = decoded(encoder.pack(encode.set_message_interval(4, 1, 33, 200_000)))
    assert (interval.command, interval.param1, interval.param2) == (511, 33.0, 200_000.0)
    again = decoded(encoder.pack(encode.command_long(4, 1, 400, (1.0, 21196.0), confirmation=2)))
    assert (again.confirmation, again.param2, again.param7) == (2, 21196.0, 0.0)
    asked = decoded(encoder.pack(encode.timesync_request(5)))
    assert (asked.tc1, asked.ts1) == (0, 5)
    answer = decoded(encoder.pack(encode.timesync_reply(5, 77)))
    assert (answer.tc1, answer.ts1) == (77, 5)
    request = decoded(
        encoder.pack(encode.cir_request(4, 191, 2**60, captures=3, interval_ms=500, tap_count=64, encoding=1))
    )
    assert (request.beacon_id, request.captures, request.interval_ms) == (2**60, 3, 500)
    assert (request.first_tap, request.tap_count, request.encoding) == (0, 64, 1)


def test_target_estimate() -> None:
    target = TargetState(
        beacon_id=2**63 + 1,
        time_ns=1,
        first_heard_ns=1,
        last_heard_ns=1,
        position=Geodetic(-35.1234567, 149.7654321, 584.25),
        covariance_enu_m2=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
        radius_90_m=12.5,
        environment=Environment.MIXED,
        los_links=2,
        links=300,
        windows=9,
        method="m",
        height_reference="home",
        sequence=41,
        snapshot=None,
    )
    message = decoded(Encoder().pack(encode.target_estimate(target, 1_700_000_000_000_000)))
    assert (message.beacon_id, message.time_usec) == (2**63 + 1, 1_700_000_000_000_000)
    assert (message.lat, message.lon, message.alt) == (-351_234_567, 1_497_654_321, 584_250)
    assert list(message.covariance_enu) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert (message.radius_90_m, message.environment, message.los_links, message.links) == (12.5, 2, 2, 255)
    assert message.sequence == 41


def test_a_field_that_does_not_fit_is_our_fault() -> None:
    with pytest.raises(InternalError, match="cannot encode HEARTBEAT"):
        Encoder().pack(dialect.MAVLink_heartbeat_message(300, 0, 0, 0, 0, 3))


def test_rewrite_keeps_everything_else(recorded_frames: list[bytes]) -> None:
    for raw in recorded_frames[::211]:
        before = frame_of(raw)
        again = rewrite(raw, 200, system_id=254, component_id=5)
        (frame,) = Framer().feed(again)
        assert (frame.sequence, frame.system_id, frame.component_id) == (200, 254, 5)
        assert (frame.message_id, frame.payload) == (before.message_id, before.payload)
        assert rewrite(again, before.sequence, before.system_id, before.component_id) == raw


def test_rewrite_takes_a_signature_off() -> None:
    link = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    link.signing.secret_key = bytes(32)
    link.signing.sign_outgoing = True
    link.signing.timestamp = 1
    raw = encode.heartbeat().pack(link)
    assert frame_of(raw).signed
    (frame,) = Framer().feed(rewrite(raw, 9))
    assert (frame.signed, frame.sequence, len(frame.raw)) == (False, 9, len(raw) - 13)


def test_rewrite_refuses_what_it_cannot_sum() -> None:
    unknown = bytes((0xFD, 1, 0, 0, 0, 1, 1, 0x1F, 0x4E, 0, 1, 0, 0))
    with pytest.raises(PeerError, match="unknown message id 19999"):
        rewrite(unknown, 1)
