"""Routing: targeted frames go where their target was heard, all others everywhere."""

from __future__ import annotations

import pytest

from groundstation.mavlink import encode
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.framing import Frame, frame_of
from groundstation.mavlink.routing import MAX_ROUTES, RoutingTable, Target, target_of


def heard(system_id: int, component_id: int) -> Frame:
    """A heartbeat of somebody."""
    return frame_of(Encoder(system_id, component_id).pack(encode.heartbeat()))


@pytest.mark.parametrize(
    ("message", "target"),
    [
        (encode.heartbeat(), None),
        (encode.command_long(4, 1, 400), Target(4, 1)),
        (encode.command_long(4, 0, 400), Target(4, 0)),
        (encode.command_long(0, 0, 400), None),
        (encode.cir_request(9, 191, 1, captures=1, interval_ms=1), Target(9, 191)),
        # Target fields that are extensions, and cut off when they are zero.
        (dialect.MAVLink_command_ack_message(400, 0, 0, 0, 3, 1), Target(3, 1)),
        (dialect.MAVLink_command_ack_message(400, 0, 0, 0, 0, 0), None),
        (encode.timesync_reply(1, 2), None),
        (dialect.MAVLink_set_mode_message(6, 1, 4), Target(6, 0)),
        (dialect.MAVLink_manual_control_message(8, 0, 0, 0, 0, 0), Target(8, 0)),
    ],
)
def test_target_of(message: object, target: Target | None) -> None:
    assert target_of(Encoder().pack(message)) == target


def test_target_of_mavlink_1() -> None:
    link = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    assert target_of(encode.command_long(4, 1, 400).pack(link, force_mavlink1=True)) == Target(4, 1)


def test_target_of_an_unknown_id_is_everyone() -> None:
    assert target_of(bytes((0xFD, 1, 0, 0, 0, 1, 1, 0x1F, 0x4E, 0, 1, 0, 0))) is None


def test_the_newest_way_wins_and_only_to_whom_was_heard() -> None:
    table = RoutingTable()
    table.learn(heard(1, 1), "serial", None, 10)
    table.learn(heard(1, 191), "udp", ("h", 2), 20)
    route = table.route(Target(1, 1))
    assert route is not None
    assert (route.connection, route.address, route.heard_ns) == ("serial", None, 10)
    assert table.route(Target(1, 0)) == table.route(Target(1, 191))
    assert table.route(Target(1, 5)) is None
    assert table.route(Target(2, 0)) is None
    table.learn(heard(1, 1), "udp", ("h", 3), 30)
    moved = table.route(Target(1, 0))
    assert moved is not None
    assert moved.address == ("h", 3)


def test_a_closed_connection_leads_nowhere() -> None:
    table = RoutingTable()
    table.learn(heard(1, 1), "serial", None, 10)
    table.learn(heard(2, 1), "udp", ("h", 2), 20)
    table.forget("serial")
    assert list(table.heard()) == [(2, 1)]


def test_bounded() -> None:
    table = RoutingTable()
    for system in range(1, 12):
        for component in range(1, 251):
            table.learn(heard(system, component), "udp", None, 0)
    assert len(table) == MAX_ROUTES
    assert table.evicted == 11 * 250 - MAX_ROUTES
    assert table.route(Target(1, 1)) is None
    assert table.route(Target(11, 250)) is not None
