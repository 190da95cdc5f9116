"""Another ground station: it sees the vehicles, real programs among them, and commands only when told to."""

from __future__ import annotations

import asyncio
import socket
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from groundstation.connections.forward import Forward
from groundstation.mavlink import encode
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.framing import Frame, Framer

RADIO = "udpin:127.0.0.1:0"


def vehicle_heartbeat() -> Any:
    """An ArduCopter's."""
    return dialect.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3)


def unknown_frame() -> bytes:
    """Of an id that our dialect lacks, but another's may have."""
    return bytes((0xFD, 3, 0, 0, 7, 1, 1, 0x1F, 0x4E, 0, 1, 2, 3, 0x12, 0x34))


async def test_vehicles_go_out_as_they_came_and_nothing_comes_in(run_hub: Any, udp_peer: Any) -> None:
    other, vehicle = udp_peer(), udp_peer()
    forward = Forward(f"udpout:127.0.0.1:{other.address[1]}")
    async with run_hub([RADIO], forwards=[forward]) as running:
        address = await running.is_open()
        await running.until(lambda: forward.is_open, "forward open")
        encoder = Encoder(1, 1)
        raws = [encoder.pack(vehicle_heartbeat()), encoder.pack(encode.command_long(255, 190, 1))]
        vehicle.send(raws[0] + raws[1], address)
        assert await other.receive() == raws[0] + raws[1]
        vehicle.send(unknown_frame() + encoder.pack(vehicle_heartbeat()), address)
        assert b"\x1f\x4e" not in await other.receive()
        assert await other.receive() == unknown_frame()
        # The other station's heartbeat and command reach nobody.
        station = Encoder(254, 190)
        back = ("127.0.0.1", forward.local_address[1])
        other.send(station.pack(encode.heartbeat()) + station.pack(encode.command_long(1, 1, 400)), back)
        await running.until(lambda: forward.dropped == 2, "both dropped")
        assert vehicle.nothing_came()
        assert {frame.system_id for _name, frame, _where in running.heard} == {1}
        assert running.counter("forward_dropped_total") == 2
        assert running.counter("forward_admitted_total") == 0


async def test_with_commands_its_frames_go_to_the_guard_but_not_in_our_vehicles_names(
    run_hub: Any, udp_peer: Any
) -> None:
    other = udp_peer()
    admitted: list[tuple[str, Frame]] = []
    forward = Forward(
        f"udpout:127.0.0.1:{other.address[1]}",
        commands=True,
        on_frame=lambda name, frame: admitted.append((name, frame)),
        is_ours=lambda system_id: system_id == 1,
    )
    async with run_hub([RADIO], forwards=[forward]) as running:
        await running.until(lambda: forward.is_open, "forward open")
        command = Encoder(254, 190).pack(encode.command_long(1, 1, 400))
        lie = Encoder(1, 1).pack(vehicle_heartbeat())
        other.send(lie + command, ("127.0.0.1", forward.local_address[1]))
        await running.until(lambda: admitted, "the command")
        assert [(name, frame.raw) for name, frame in admitted] == [(forward.name, command)]
        assert forward.name == f"forward:udpout:127.0.0.1:{other.address[1]}"
        assert (forward.echoes, forward.admitted, forward.dropped) == (1, 1, 0)
        assert running.heard == []


async def test_a_station_that_comes_late_connects_by_tcp(run_hub: Any, udp_peer: Any) -> None:
    forward = Forward("tcpin:127.0.0.1:0")
    async with run_hub([RADIO], forwards=[forward]) as running:
        address = await running.is_open()
        await running.until(lambda: forward.is_open, "forward open")
        encoder, vehicle = Encoder(1, 1), udp_peer()
        vehicle.send(encoder.pack(vehicle_heartbeat()), address)
        await running.until(lambda: running.heard, "the first heartbeat")
        reader, writer = await asyncio.open_connection(*forward.local_address)
        await running.until(lambda: forward._link._supervisor.transport.audience(), "connected")
        raw = encoder.pack(vehicle_heartbeat())
        vehicle.send(raw, address)
        assert await asyncio.wait_for(reader.readexactly(len(raw)), 5) == raw
        writer.close()


def free_udp_port() -> int:
    """A port that nobody had a moment ago."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


async def fly(peer: Any, address: Any, system_ids: tuple[int, ...]) -> None:
    """Vehicles that beat and answer nothing, until cancelled."""
    encoders = [Encoder(system_id, 1) for system_id in system_ids]
    while True:
        for encoder in encoders:
            peer.send(encoder.pack(vehicle_heartbeat()), address)
        await asyncio.sleep(0.1)


@pytest.fixture
async def flying(run_hub: Any, udp_peer: Any) -> AsyncIterator[Any]:
    """Starts two vehicles on a hub that forwards to a port; returns the running hub."""
    tasks: list[asyncio.Task[None]] = []
    contexts = []

    async def start(port: int) -> Any:
        context = run_hub([RADIO], forwards=[Forward(f"udpout:127.0.0.1:{port}")])
        running = await context.__aenter__()
        contexts.append(context)
        address = await running.is_open()
        tasks.append(asyncio.create_task(fly(udp_peer(), address, (11, 12))))
        return running

    yield start
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    for context in contexts:
        await context.__aexit__(None, None, None)


@pytest.mark.peer
async def test_a_real_mavproxy_sees_the_vehicles_and_cannot_command_them(flying: Any, tmp_path: Path) -> None:
    port = free_udp_port()
    running = await flying(port)
    # It repeats what it receives on its own output: that is the proof that it took the frames in.
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as output:
        output.bind(("127.0.0.1", 0))
        output.setblocking(False)
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-W", "ignore", "-m", "MAVProxy.mavproxy"),
            *(f"--master=udpin:127.0.0.1:{port}", f"--out=udpout:127.0.0.1:{output.getsockname()[1]}"),
            *("--daemon", "--non-interactive", "--no-state", "--default-modules=link,output"),
            cwd=tmp_path,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        try:
            framer, seen = Framer(), set()
            async with asyncio.timeout(40):
                while not {11, 12} <= seen:
                    data = await asyncio.get_running_loop().sock_recv(output, 4096)
                    seen |= {frame.system_id for frame in framer.feed(data)}
            # Its own heartbeats and requests came back to us and stopped there.
            await running.until(lambda: running.counter("forward_dropped_total") > 0, "its heartbeat", 10.0)
            assert running.counter("forward_admitted_total") == 0
            assert {frame.system_id for _name, frame, _where in running.heard} == {11, 12}
        finally:
            process.kill()
            await process.communicate()


@pytest.mark.peer
async def test_a_real_mavsdk_sees_the_vehicles(flying: Any) -> None:
    from mavsdk.mavsdk import Configuration, Mavsdk

    port = free_udp_port()
    configuration = Configuration.create_manual(245, 190, True)
    peer = Mavsdk(configuration)
    try:
        peer.add_any_connection(f"udpin://127.0.0.1:{port}")
        running = await flying(port)
        await running.until(
            lambda: {system.get_system_id() for system in peer.get_systems()} == {11, 12},
            "MAVSDK found both vehicles",
            20.0,
        )
        await running.until(lambda: running.counter("forward_dropped_total") > 0, "its heartbeat", 10.0)
        assert {frame.system_id for _name, frame, _where in running.heard} == {11, 12}
    finally:
        peer.destroy()
        configuration.destroy()
