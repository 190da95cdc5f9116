"""The stream over a real port with real websocket clients, good ones and bad ones."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from collections.abc import Callable
from typing import Any

import pytest
from fastapi import FastAPI
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from groundstation.server.app import create_app
from groundstation.server.hub import Hub
from groundstation.server.picture import Picture
from groundstation.server.settings import ServerSettings
from groundstation.server.stream import parse_since

Serve = Callable[[FastAPI], Any]


async def _next(websocket: Any, kind: str | None = None) -> dict[str, Any]:
    while True:
        message: dict[str, Any] = json.loads(await asyncio.wait_for(websocket.recv(), 5))
        if kind is None or message["type"] == kind:
            return message


async def test_snapshot_then_deltas_then_heartbeats(app: FastAPI, serve_live: Serve, make: Any) -> None:
    async with serve_live(app) as live:
        live.hub.apply(make.vehicle(1))
        async with connect(live.stream) as websocket:
            assert "permessage-deflate" in websocket.response.headers["Sec-WebSocket-Extensions"]
            snapshot = await _next(websocket)
            assert snapshot["type"] == "snapshot"
            assert snapshot["schema_version"] == 1
            assert [row["vehicle_id"] for row in snapshot["rows"]["vehicles"]] == [1]
            live.hub.apply(make.vehicle(2))
            delta = await _next(websocket, "delta")
            assert delta["previous_seq"] == snapshot["seq"]
            assert [row["vehicle_id"] for row in delta["rows"]["vehicles"]] == [2]
            beat = await _next(websocket, "heartbeat")
            assert (beat["seq"], beat["server_time_ns"]) == (delta["seq"], "5000")


async def test_a_client_that_comes_back_gets_what_it_missed(
    app: FastAPI, serve_live: Serve, make: Any
) -> None:
    async with serve_live(app) as live:
        async with connect(live.stream) as websocket:
            snapshot = await _next(websocket)
        for number in range(3):
            live.hub.apply(make.event(str(number)))
            live.hub.publish()
        where = f"{snapshot['epoch']}:{snapshot['seq']}"
        async with connect(f"{live.stream}?since={where}") as websocket:
            delta = await _next(websocket)
            assert delta["type"] == "delta"
            assert [event["text"] for event in delta["events"]] == ["0", "1", "2"]
        async with connect(f"{live.stream}?since=other:0") as websocket:
            assert (await _next(websocket))["type"] == "snapshot"


async def test_twenty_clients_get_every_event(app: FastAPI, serve_live: Serve, make: Any) -> None:
    async with serve_live(app) as live:
        sockets = [await connect(live.stream) for _ in range(20)]
        for websocket in sockets:
            await _next(websocket, "snapshot")
        assert len(live.hub.clients) == 20

        async def read(websocket: Any) -> list[str]:
            texts: list[str] = []
            while len(texts) < 300:
                texts += [event["text"] for event in (await _next(websocket, "delta"))["events"]]
            return texts

        readers = [asyncio.create_task(read(websocket)) for websocket in sockets]
        for number in range(300):
            live.hub.apply(make.event(str(number)))
            if number % 10 == 0:
                await asyncio.sleep(0.005)
        wanted = [str(number) for number in range(300)]
        assert all(texts == wanted for texts in await asyncio.gather(*readers))
        for websocket in sockets:
            await websocket.close()
        async with asyncio.timeout(5):
            while live.hub.clients:  # noqa: ASYNC110
                await asyncio.sleep(0.01)


async def _handshake(port: int) -> socket.socket:
    """A websocket client that will never read what is sent to it."""
    raw = socket.socket()
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    raw.setblocking(False)
    loop = asyncio.get_running_loop()
    await loop.sock_connect(raw, ("127.0.0.1", port))
    request = (
        "GET /api/v1/stream HTTP/1.1\r\n"
        f"Host: 127.0.0.1:{port}\r\n"
        "Upgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )
    await loop.sock_sendall(raw, request.encode())
    assert (await loop.sock_recv(raw, 12)) == b"HTTP/1.1 101"
    return raw


async def test_a_client_that_stops_reading_is_closed_and_holds_up_nobody(
    app: FastAPI, serve_live: Serve, make: Any
) -> None:
    async with serve_live(app) as live, contextlib.AsyncExitStack() as stack:
        stuck = await _handshake(live.port)
        stack.callback(stuck.close)
        async with connect(live.stream) as reader:
            await _next(reader, "snapshot")
            assert len(live.hub.clients) == 2
            text = "x" * 20_000
            seen = sent = 0
            async with asyncio.timeout(20):
                while live.hub.clients_stalled_total == 0:
                    for _ in range(20):
                        live.hub.apply(make.event(text))
                        sent += 1
                    seen += len((await _next(reader, "delta"))["events"])
                while len(live.hub.clients) > 1:  # noqa: ASYNC110
                    await asyncio.sleep(0.01)
            while seen < sent:
                seen += len((await _next(reader, "delta"))["events"])
            assert seen == sent
            # Its socket is gone too, although it never read what was left in it.
            loop = asyncio.get_running_loop()
            async with asyncio.timeout(10):
                try:
                    while await loop.sock_recv(stuck, 1 << 20):
                        pass
                except ConnectionResetError:
                    pass


async def test_a_client_too_many_events_behind_is_closed(make: Any) -> None:
    hub = Hub(Picture("e", ServerSettings(client_events_max=10)), lambda: 1)
    client = hub.attach()
    for number in range(11):
        assert not client.overflowed
        hub.apply(make.event(str(number)))
        hub.publish()
    assert client.overflowed
    assert client.merged_total == 10


async def test_one_page_too_many_is_told_so(serve_live: Serve, actions: Any) -> None:
    hub = Hub(Picture("e", ServerSettings(port=0, max_clients=1)), lambda: 1)
    async with serve_live(create_app(hub, actions, page_directory=None)) as live:
        async with connect(live.stream), connect(live.stream) as second:
            with pytest.raises(ConnectionClosed) as closed:
                await second.recv()
            assert closed.value.rcvd is not None
            assert closed.value.rcvd.code == 1013
            assert "1 pages are connected" in closed.value.rcvd.reason
        assert hub.clients_refused_total == 1


async def test_a_foreign_page_cannot_open_the_stream(app: FastAPI, serve_live: Serve) -> None:
    async with serve_live(app) as live:
        with pytest.raises(InvalidStatus) as refused:
            await connect(live.stream, origin="https://evil.example")  # type: ignore[arg-type]
        assert refused.value.response.status_code == 403
        own = f"http://127.0.0.1:{live.port}"
        async with connect(live.stream, origin=own) as websocket:  # type: ignore[arg-type]
            assert (await _next(websocket))["type"] == "snapshot"


@pytest.mark.parametrize(
    "text", [None, "", "e", "e:", ":1", "e:x", "e:1:2", "e:-1", "a b:1", "e:" + "9" * 16]
)
def test_a_since_that_is_none_is_no_since(text: str | None) -> None:
    assert parse_since(text) is None


def test_a_since_is_epoch_and_number() -> None:
    assert parse_since("run-1.2_x:42") == ("run-1.2_x", 42)
