"""The shell: sockets and pace. Vehicles speak from a port each, and hear what is sent there."""

from __future__ import annotations

import asyncio
import json
import socket
from pathlib import Path
from typing import Any

import pytest

from groundstation.domain.errors import ResourceError, UsageError
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.framing import Frame, Framer
from sim_sitl.endpoints import LinkUrl, UdpIn, parse_link
from sim_sitl.lossy_link import LinkQuality
from sim_sitl.swarm import Swarm, SwarmOptions


class Station:
    """A UDP listener that keeps what it hears, by sender."""

    def __init__(self) -> None:
        self.endpoint = UdpIn(self._heard)
        self.frames: dict[tuple[str, int], list[Frame]] = {}
        self._framers: dict[tuple[str, int], Framer] = {}

    def _heard(self, data: bytes, address: tuple[str, int]) -> None:
        framer = self._framers.setdefault(address, Framer())
        self.frames.setdefault(address, []).extend(framer.feed(data))


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


async def test_udp_each_vehicle_has_its_own_port_and_answers_there(
    field: Any, tmp_path: Path, eventually: Any
) -> None:
    station, port = Station(), free_port()
    await station.endpoint.open(LinkUrl("udpin", "127.0.0.1", port))
    truth = tmp_path / "truth.json"
    options = SwarmOptions(field, LinkUrl("udpout", "127.0.0.1", port), vehicles=3, speedup=5.0, truth=truth)
    lines: list[str] = []
    swarm = Swarm(options, lines.append)
    running = asyncio.create_task(swarm.run())
    try:
        await eventually(lambda: len(station.frames) == 3)
        assert json.loads(truth.read_text())["beacons"][0]["id"] == "7001"
        by_system = {frames[0].system_id: address for address, frames in station.frames.items()}
        assert sorted(by_system) == [1, 2, 3]
        assert all(len({f.system_id for f in frames}) == 1 for frames in station.frames.values())
        ask = dialect.MAVLink_command_long_message(2, 1, 511, 0, 33, 200_000, 0, 0, 0, 0, 0)
        station.endpoint.send(Encoder(255, 190).pack(ask), by_system[2])
        await eventually(lambda: 33 in {f.message_id for f in station.frames[by_system[2]]})
        assert 33 not in {f.message_id for f in station.frames[by_system[1]]}
        assert {20800, 20801, 20802} <= {f.message_id for f in station.frames[by_system[1]]}
    finally:
        swarm.stop()
        await running
        station.endpoint.close()


async def test_tcp_is_spoken_to_when_it_comes_and_tried_again(field: Any, eventually: Any) -> None:
    port = free_port()
    swarm = Swarm(SwarmOptions(field, LinkUrl("tcp", "127.0.0.1", port), vehicles=2, speedup=5.0))
    running = asyncio.create_task(swarm.run())
    await asyncio.sleep(0.2)
    heard: list[Frame] = []

    async def listen(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        framer = Framer()
        while data := await reader.read(4096):
            heard.extend(framer.feed(data))
        writer.close()

    server = await asyncio.start_server(listen, "127.0.0.1", port)
    try:
        await eventually(lambda: {f.system_id for f in heard} == {1, 2})
    finally:
        swarm.stop()
        await running
        await asyncio.sleep(0.05)
        server.close()
        await server.wait_closed()


async def test_a_run_ends_at_its_duration_and_a_lossy_link_loses(field: Any) -> None:
    options = SwarmOptions(
        field,
        LinkUrl("udpout", "127.0.0.1", free_port()),
        vehicles=1,
        speedup=20.0,
        duration_s=10.0,
        quality=LinkQuality(loss=0.5),
    )
    swarm = Swarm(options)
    async with asyncio.timeout(10):
        await swarm.run()
    assert swarm.simulation.time_s == pytest.approx(10.0, abs=1.1)
    assert swarm._down[1].lost > 10


async def test_an_occupied_port_is_one_clear_line() -> None:
    port = free_port()
    first, second = UdpIn(lambda *_: None), UdpIn(lambda *_: None)
    await first.open(LinkUrl("udpin", "127.0.0.1", port))
    try:
        with pytest.raises(
            ResourceError, match=rf"cannot listen on 127\.0\.0\.1:{port}.*needed: a free port"
        ):
            await second.open(LinkUrl("udpin", "127.0.0.1", port))
    finally:
        first.close()


def test_link_urls() -> None:
    assert parse_link("udpout:10.0.0.2:14550", ("udpout",)) == LinkUrl("udpout", "10.0.0.2", 14550)
    assert parse_link("udpout://:14550", ("udpout",)) == LinkUrl("udpout", "127.0.0.1", 14550)
    assert parse_link("tcp:[::1]:5760", ("udpout", "tcp")) == LinkUrl("tcp", "::1", 5760)
    for wrong in ("14550", "udpout:host", "serial:/dev/ttyUSB0:57600", "udpin:0.0.0.0:14550", "udpout:h:0"):
        with pytest.raises(UsageError, match="needed: udpout:HOST:PORT"):
            parse_link(wrong, ("udpout",))
