"""TCP: client and server, losses and comebacks."""

from __future__ import annotations

import asyncio
from typing import Any

from groundstation.connections.settings import ConnectionSettings
from groundstation.mavlink import encode
from groundstation.mavlink.encode import Encoder


async def test_client_reads_sends_and_comes_back(run_hub: Any) -> None:
    streams: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []

    async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        streams.append((reader, writer))

    server = await asyncio.start_server(accept, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    url = f"tcp:127.0.0.1:{port}"
    vehicle = Encoder(1, 1)
    async with run_hub([url]) as running:
        await running.until(lambda: len(streams) == 1, "connected")
        reader, writer = streams[0]
        raw = vehicle.pack(encode.heartbeat())
        writer.write(raw[:5])
        await writer.drain()
        await asyncio.sleep(0.02)
        writer.write(raw[5:])
        await running.until(lambda: running.heard, "the heartbeat")
        command = Encoder().pack(encode.command_long(1, 1, 400))
        assert running.hub.send(command) == 1
        assert await asyncio.wait_for(reader.readexactly(len(command)), 5) == command
        writer.close()
        await running.until(lambda: len(streams) == 2, "connected again")
        # Heard before the loss does not lead anywhere after it.
        await running.is_open()
        assert running.hub.send(command) == 0
        streams[1][1].write(vehicle.pack(encode.heartbeat()))
        await running.until(lambda: len(running.heard) == 2, "the second heartbeat")
        assert running.hub.send(command) == 1
        assert [state for _name, state, _detail in running.states] == ["open", "closed", "waiting", "open"]
        assert running.counter("connection_opened_total") == 2
        for _reader, other in streams:
            other.close()
    server.close()
    await server.wait_closed()


async def test_nobody_listens(run_hub: Any) -> None:
    server = await asyncio.start_server(lambda _reader, _writer: None, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    server.close()
    await server.wait_closed()
    async with run_hub([f"tcp:127.0.0.1:{port}"]) as running:
        await running.until(lambda: len(running.states) >= 3, "three tries")
        assert {state for _name, state, _detail in running.states} == {"waiting"}
        assert "nobody listens there (connection refused); next try in 0.02 s" in running.states[0][2]
        assert "next try in 0.04 s" in running.states[1][2]


async def test_server_tells_its_clients_apart(run_hub: Any) -> None:
    url = "tcpin:127.0.0.1:0"
    settings = ConnectionSettings(max_clients=2)
    async with run_hub([url], settings=settings) as running:
        host, port = await running.is_open()
        clients = [await asyncio.open_connection(host, port) for _ in range(2)]
        for system_id, (_reader, writer) in enumerate(clients, start=1):
            writer.write(Encoder(system_id, 1).pack(encode.heartbeat()))
        await running.until(lambda: len(running.heard) == 2, "both heartbeats")
        for system_id, (reader, _writer) in enumerate(clients, start=1):
            command = Encoder().pack(encode.command_long(system_id, 1, 400))
            assert running.hub.send(command) == 1
            assert await asyncio.wait_for(reader.readexactly(len(command)), 5) == command
        beyond, its_writer = await asyncio.open_connection(host, port)
        assert await asyncio.wait_for(beyond.read(), 5) == b""
        its_writer.close()
        clients[0][1].close()
        beat = Encoder().pack(encode.heartbeat())
        await running.until(lambda: running.hub.send(beat) == 1, "the first client gone")
        assert running.hub.is_open(url)
        clients[1][1].close()


async def test_a_client_that_stops_reading_fills_its_queue_and_nothing_else(run_hub: Any) -> None:
    url = "tcpin:127.0.0.1:0"
    settings = ConnectionSettings(write_queue_bytes=4096)
    async with run_hub([url], settings=settings) as running:
        host, port = await running.is_open()
        _reader, writer = await asyncio.open_connection(host, port, limit=64)
        writer.write(Encoder(1, 1).pack(encode.heartbeat()))
        await running.until(lambda: running.heard, "the heartbeat")
        frame = Encoder().pack_payload(20802, bytes([7]) * 252)
        sent = 0
        # The kernel's buffers on both sides come first: some megabytes.
        while running.hub.send(frame) and sent < 200_000:
            sent += 1
        assert sent < 200_000
        assert running.counter("connection_refused_frames_total") == 1
        assert running.hub.is_open(url)
        writer.close()
