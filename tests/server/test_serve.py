"""The server in an event loop that is not its own: ports, stopping, the page."""

from __future__ import annotations

import asyncio
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from websockets.asyncio.client import connect

from groundstation.domain.errors import InputError, ResourceError
from groundstation.server import page_files
from groundstation.server.app import create_app
from groundstation.server.hub import Hub
from groundstation.server.serve import is_loopback, listen, parse_http, url_of
from groundstation.server.settings import ServerSettings


def test_an_occupied_port_is_one_clear_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ResourceError) as refused:
            listen(ServerSettings(port=port))
    assert str(port) in str(refused.value)
    assert "--http" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_name_that_is_none_of_ours_is_one_clear_line() -> None:
    with pytest.raises((InputError, ResourceError), match=r"no-such-host\.invalid"):
        listen(ServerSettings(host="no-such-host.invalid", port=0))


@pytest.mark.parametrize(
    ("text", "wanted"),
    [("127.0.0.1:8000", ("127.0.0.1", 8000)), ("[::1]:0", ("::1", 0)), (" localhost:80 ", ("localhost", 80))],
)
def test_http_addresses(text: str, wanted: tuple[str, int]) -> None:
    assert parse_http(text) == wanted


@pytest.mark.parametrize("text", ["", "8000", "host:", ":80", "host:x", "host:65536", "host:-1", "host:٣"])
def test_what_is_no_http_address_is_said(text: str) -> None:
    with pytest.raises(InputError, match="needed is HOST:PORT"):
        parse_http(text)


def test_loopback_is_known() -> None:
    assert [is_loopback(host) for host in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "example.org")] == [
        True, True, True, False, False,
    ]  # fmt: skip


def test_the_url_can_be_opened() -> None:
    with listen(ServerSettings(host="0.0.0.0", port=0)) as listener:
        assert url_of(listener) == f"http://127.0.0.1:{listener.getsockname()[1]}/"


async def test_it_stops_at_once_with_a_page_open_and_leaves_signals_alone(
    app: FastAPI, serve_live: Callable[..., Any]
) -> None:
    before = signal.getsignal(signal.SIGINT)
    async with serve_live(app) as live:
        assert signal.getsignal(signal.SIGINT) is before
        async with httpx.AsyncClient() as client:
            assert (await client.get(f"{live.url}/api/v1/health")).status_code == 200
        websocket = await connect(live.stream)
        await websocket.recv()
        started = time.monotonic()
        live.stop.set()
        await asyncio.wait_for(live.done, 5)
        assert time.monotonic() - started < 3
        await websocket.wait_closed()
    with socket.socket() as again:
        assert again.connect_ex(("127.0.0.1", live.port)) != 0


async def test_a_built_page_is_served_with_its_policy(hub: Hub, actions: Any, tmp_path: Path) -> None:
    (tmp_path / "assets").mkdir()
    (tmp_path / "index.html").write_text("<title>page</title>")
    (tmp_path / "assets" / "a-1.js").write_text("1")
    transport = httpx.ASGITransport(create_app(hub, actions, page_directory=tmp_path))
    async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
        index = await client.get("/")
        assert index.text == "<title>page</title>"
        assert index.headers["cache-control"] == "no-cache"
        assert index.headers["content-security-policy"].startswith("default-src 'self'")
        assert "immutable" in (await client.get("/assets/a-1.js")).headers["cache-control"]
        missing = await client.get("/nothing.html")
        assert missing.status_code == 404
        assert missing.headers["content-type"] == "application/problem+json"


async def test_without_a_page_it_says_how_to_build_one(client: httpx.AsyncClient) -> None:
    answer = await client.get("/")
    assert answer.status_code == 503
    assert "npm run build" in answer.text


def test_the_page_is_looked_for_in_the_wheel_and_in_the_checkout() -> None:
    found = page_files.page_directory()
    assert found is None or (found / "index.html").is_file()
