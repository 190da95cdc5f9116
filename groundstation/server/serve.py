"""Runs the web application inside an event loop that belongs to the station.

Rule: the port is taken before anything else begins, so that an occupied one is one clear
line; signals stay the station's; a client that does not read cannot hold up the stop.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
from collections.abc import Iterator

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from groundstation.domain.errors import InputError, ResourceError
from groundstation.server.settings import ServerSettings

_LINGER_S = 2.0


def parse_http(text: str) -> tuple[str, int]:
    """``HOST:PORT`` of ``--http``; ``[::1]:8000`` for IPv6. Raises InputError."""
    host, colon, port = text.strip().rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not colon or not host or not port.isascii() or not port.isdecimal() or int(port) > 65535:
        raise InputError(f"--http {text!r}: needed is HOST:PORT with a port from 0 to 65535")
    return host, int(port)


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches a server on ``host``."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def listen(settings: ServerSettings) -> socket.socket:
    """A listening socket. Raises ResourceError in one line when the port cannot be had."""
    host, port = settings.host, settings.port
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError as error:
        raise InputError(f"--http {host}:{port}: {host!r} is no address of this machine ({error})") from error
    family, kind, protocol, _name, address = found[0]
    listener = socket.socket(family, kind, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(128)
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        raise ResourceError(
            f"cannot serve the page on {host}:{port}: {error.strerror or error}; "
            "stop what uses it or choose another with --http HOST:PORT"
        ) from error
    return listener


def url_of(listener: socket.socket) -> str:
    """What to type into a browser on this machine."""
    host, port = listener.getsockname()[:2]
    address = ipaddress.ip_address(host)
    if address.is_unspecified:
        host = "127.0.0.1" if address.version == 4 else "::1"
    return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"


class _Websocket(WebSocketsSansIOProtocol):
    """After the stream gave a client up, its socket goes too, even if it never reads again."""

    async def run_asgi(self) -> None:
        await super().run_asgi()
        self.loop.call_later(_LINGER_S, self.transport.abort)


class _Server(uvicorn.Server):
    """A server that leaves the signals to the station and says when it answers."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.ready = asyncio.Event()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self.ready.set()


async def serve(
    app: FastAPI,
    listener: socket.socket,
    stop: asyncio.Event,
    started: asyncio.Event | None = None,
) -> None:
    """Serve ``app`` and run its hub until ``stop`` is set; then end gracefully.

    ``started`` is set once requests are answered. Made to be a task of the station's TaskGroup.
    """
    hub = app.state.hub
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        lifespan="off",
        ws=_Websocket,
        server_header=False,
        timeout_graceful_shutdown=max(1, round(hub.settings.graceful_stop_s)),
    )
    server = _Server(config)
    publishing = asyncio.create_task(hub.run(), name="hub")
    serving = asyncio.create_task(server.serve(sockets=[listener]), name="http")
    stopping = asyncio.create_task(stop.wait(), name="http-stop")
    try:
        ready = asyncio.create_task(server.ready.wait(), name="http-ready")
        await asyncio.wait((ready, serving, stopping), return_when=asyncio.FIRST_COMPLETED)
        if ready.done() and started is not None:
            started.set()
        ready.cancel()
        await asyncio.wait((serving, stopping, publishing), return_when=asyncio.FIRST_COMPLETED)
    finally:
        server.should_exit = True
        stopping.cancel()
        publishing.cancel()
        results = await asyncio.gather(serving, publishing, return_exceptions=True)
        for connection in list(server.server_state.connections):
            # Who still does not read is not waited for: the loop may close right after.
            if connection.transport is not None:
                connection.transport.abort()
        await asyncio.sleep(0)
        listener.close()
    for result in results:
        if isinstance(result, Exception):
            raise result
