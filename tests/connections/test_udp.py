"""UDP: many vehicles behind one socket, each answered at its own address."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

import pytest

from groundstation.connections.hub import Hub
from groundstation.connections.settings import ConnectionSettings
from groundstation.domain.errors import InputError
from groundstation.mavlink import encode
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.framing import Frame, frame_of

URL = "udpin:127.0.0.1:0"


async def test_each_vehicle_is_answered_at_its_own_address(run_hub: Any, udp_peer: Any) -> None:
    async with run_hub([URL]) as running:
        address = await running.is_open()
        vehicles = {system_id: udp_peer() for system_id in (1, 2, 3)}
        for system_id, peer in vehicles.items():
            peer.send(Encoder(system_id, 1).pack(encode.heartbeat()), address)
        await running.until(lambda: len(running.heard) == 3, "three heartbeats")
        assert {(frame.system_id, where) for _name, frame, where in running.heard} == {
            (system_id, peer.address) for system_id, peer in vehicles.items()
        }
        station = Encoder()
        command = station.pack(encode.command_long(2, 1, 400))
        assert running.hub.send(command) == 1
        assert await vehicles[2].receive() == command
        beat = station.pack(encode.heartbeat())
        assert running.hub.send(beat) == 3
        for peer in vehicles.values():
            assert await peer.receive() == beat
        assert all(peer.nothing_came() for peer in vehicles.values())
        assert running.hub.send(station.pack(encode.command_long(9, 1, 400))) == 0
        assert running.hub.send(station.pack(encode.command_long(2, 154, 400))) == 0
        assert running.counter("routing_unroutable_total") == 2
        assert running.counter("connection_sent_frames_total") == 4


async def test_a_vehicle_that_changes_its_port_is_followed(run_hub: Any, udp_peer: Any) -> None:
    async with run_hub([URL]) as running:
        address = await running.is_open()
        encoder, old, new = Encoder(1, 1), udp_peer(), udp_peer()
        old.send(encoder.pack(encode.heartbeat()), address)
        await running.until(lambda: len(running.heard) == 1, "the first heartbeat")
        new.send(encoder.pack(encode.heartbeat()), address)
        await running.until(lambda: len(running.heard) == 2, "the second heartbeat")
        command = Encoder().pack(encode.command_long(1, 0, 400))
        assert running.hub.send(command) == 1
        assert await new.receive() == command
        assert old.nothing_came()


async def test_garbage_of_one_peer_harms_no_other_and_earns_no_answer(run_hub: Any, udp_peer: Any) -> None:
    async with run_hub([URL]) as running:
        address = await running.is_open()
        noisy, vehicle = udp_peer(), udp_peer()
        raw = Encoder(1, 1).pack(encode.heartbeat())
        # Half a frame from each, interleaved with garbage that begins a long one.
        vehicle.send(raw[:9], address)
        noisy.send(b"\xfd\xff\x00\x00" + bytes(40), address)
        vehicle.send(raw[9:], address)
        await running.until(lambda: running.heard, "the heartbeat")
        assert [frame.raw for _name, frame, _where in running.heard] == [raw]
        noisy.send(bytes(400), address)
        await running.until(lambda: running.counter("mavlink_garbage_bytes_total") >= 400, "garbage counted")
        beat = Encoder().pack(encode.heartbeat())
        assert running.hub.send(beat) == 1
        assert await vehicle.receive() == beat
        assert noisy.nothing_came()


async def test_peers_are_bounded(run_hub: Any, udp_peer: Any) -> None:
    settings = ConnectionSettings(max_peers=4)
    async with run_hub([URL], settings=settings) as running:
        address = await running.is_open()
        for system_id in range(1, 11):
            udp_peer().send(Encoder(system_id, 1).pack(encode.heartbeat()), address)
        await running.until(lambda: len(running.heard) == 10, "ten heartbeats")
        assert running.counter("connection_peers_evicted_total") == 6
        assert running.counter("mavlink_frames_received_total") == 10
        assert running.hub.send(Encoder().pack(encode.heartbeat())) == 4


async def test_udpout_speaks_first(run_hub: Any, udp_peer: Any) -> None:
    vehicle = udp_peer()
    url = f"udpout:127.0.0.1:{vehicle.address[1]}"
    async with run_hub([url]) as running:
        await running.is_open()
        beat = Encoder().pack(encode.heartbeat())
        assert running.hub.send(beat) == 1
        assert await vehicle.receive() == beat
        vehicle.send(Encoder(5, 1).pack(encode.heartbeat()), ("127.0.0.1", running.hub.local_address(url)[1]))
        await running.until(lambda: running.heard, "the answer")
        assert running.hub.send(Encoder().pack(encode.command_long(5, 1, 400))) == 1
        assert running.hub.send(beat) == 1


async def test_an_occupied_port_is_one_line_and_the_rest_goes_on(run_hub: Any, udp_peer: Any) -> None:
    taken = udp_peer()
    url = f"udpin:127.0.0.1:{taken.address[1]}"
    async with run_hub([url, URL]) as running:
        address = await running.is_open(URL)
        udp_peer().send(Encoder(1, 1).pack(encode.heartbeat()), address)
        await running.until(lambda: running.heard, "the other connection hears")
        name, state, detail = next(entry for entry in running.states if entry[0] == url)
        assert (name, state) == (url, "waiting")
        assert f"port {taken.address[1]} is in use by another program" in detail
        assert "\n" not in detail
        taken.socket.close()
        await running.is_open(url)


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("udpin:192.0.2.77:14550", "has no address 192.0.2.77"),
        ("udpout:no.such.host.invalid:1", "cannot find host"),
    ],
)
async def test_what_can_never_open_is_told(run_hub: Any, url: str, said: str) -> None:
    async with run_hub([url]) as running:
        await running.until(lambda: running.states, "a state", timeout_s=12.0)
        assert running.states[0][1] == "waiting"
        assert said in running.states[0][2]


def test_a_link_given_twice() -> None:
    with pytest.raises(InputError, match="given twice"):
        Hub(["udpin:0.0.0.0:14550", "udp://:14550"], lambda *_: None, lambda *_: None)


async def test_duplicates_over_two_links_come_once(run_hub: Any, udp_peer: Any) -> None:
    second = "udpin:localhost:0"
    async with run_hub([URL, second]) as running:
        one, two = await running.is_open(URL), await running.is_open(second)
        raw = Encoder(1, 1).pack(encode.heartbeat())
        peer = udp_peer()
        if socket.getaddrinfo("localhost", 0)[0][0] != socket.AF_INET:
            pytest.skip("localhost is no IPv4 address here")
        peer.send(raw, one)
        await running.until(lambda: running.heard, "the heartbeat")
        peer.send(raw, two)
        await running.until(lambda: running.counter("mavlink_duplicates_total") == 1, "the duplicate")
        assert len(running.heard) == 1


async def test_a_fault_of_the_receiver_does_not_close_the_radio(run_hub: Any, udp_peer: Any) -> None:
    faults: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _loop, context: faults.append(context))

    class Broken(list[Any]):
        def extend(self, _frames: Any) -> None:
            raise ValueError("a fault of ours")

    async with run_hub([URL], heard=Broken()) as running:
        address = await running.is_open()
        peer, encoder = udp_peer(), Encoder(1, 1)
        for count in (1, 2):
            peer.send(encoder.pack(encode.heartbeat()), address)
            await running.until(lambda count=count: len(faults) == count, "the fault")
        assert running.hub.is_open(URL)
        assert running.counter("mavlink_frames_received_total") == 2


async def test_each_peer_gets_a_sequence_of_its_own(run_hub: Any, udp_peer: Any) -> None:
    async with run_hub([URL]) as running:
        address = await running.is_open()
        vehicles = {system_id: udp_peer() for system_id in (1, 2)}
        for system_id, peer in vehicles.items():
            peer.send(Encoder(system_id, 1).pack(encode.heartbeat()), address)
        await running.until(lambda: len(running.heard) == 2, "both heartbeats")
        numbers: dict[str, int] = {}

        def stamp(frame: Frame, peer: str) -> bytes:
            numbers[peer] = numbers.get(peer, -1) + 1
            return encode.rewrite(frame.raw, numbers[peer])

        station = Encoder()
        for message in (encode.heartbeat(), encode.command_long(2, 1, 400), encode.heartbeat()):
            left = running.hub.send_stamped(frame_of(station.pack(message)), stamp)
            assert {connection for connection, _raw in left} == {URL}
        assert running.hub.send_stamped(frame_of(station.pack(encode.command_long(9, 1, 400))), stamp) == []
        assert running.counter("routing_unroutable_total") == 1
        for system_id, expected in ((1, [0, 1]), (2, [0, 1, 2])):
            got = [frame_of(await vehicles[system_id].receive()).sequence for _ in expected]
            assert got == expected
            assert vehicles[system_id].nothing_came()
