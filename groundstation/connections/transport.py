"""What every open socket or port looks like to the rest: bytes in with an address, bytes out.

Sending never blocks and never waits: what does not fit into the bounded queue is refused, and
the caller counts it.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Hashable
from typing import Protocol

Address = Hashable
"""Of a peer: (host, port), or None where a connection has one peer only."""


class Sink(Protocol):
    """Who takes what a transport hears."""

    def received(self, data: bytes, address: Address) -> None:
        """Bytes came from ``address``."""

    def peer_gone(self, address: Address) -> None:
        """A peer of this transport left; what it sent half is not to be continued."""


class Transport(Protocol):
    """One open socket or port."""

    @property
    def local_address(self) -> Address:
        """Where it listens, once open; None where that means nothing."""

    def send(self, data: bytes, address: Address) -> bool:
        """Queues ``data`` for ``address``; False: no such peer, or its queue is full."""

    def confirm(self, address: Address) -> None:
        """A verified frame came from ``address``: it may be sent to."""

    def audience(self) -> list[Address]:
        """Everyone a broadcast goes to."""

    def send_errors(self) -> int:
        """Sends that the system refused afterwards."""

    async def wait_closed(self) -> str:
        """Returns why it broke, when it has broken."""

    async def close(self) -> None:
        """Closes it; wait_closed returns."""


class StreamPeer(asyncio.Protocol):
    """One TCP or serial stream: a Transport of its own, or one client of a server."""

    def __init__(self, sink: Sink, queue_bytes: int, address: Address = None) -> None:
        self.address = address
        self._sink = sink
        self._queue_bytes = queue_bytes
        self._transport: asyncio.WriteTransport | None = None
        self._closed: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    @property
    def local_address(self) -> Address:
        """None: a stream has one peer."""
        return None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by asyncio."""
        # serialx has its own transports, which are write transports in all but name.
        self._transport = transport  # type: ignore[assignment]
        raw_socket = transport.get_extra_info("socket")
        if raw_socket is not None:
            keep_alive(raw_socket)

    def data_received(self, data: bytes) -> None:
        """Called by asyncio."""
        self._sink.received(bytes(data), self.address)

    def connection_lost(self, error: Exception | None) -> None:
        """Called by asyncio."""
        self._transport = None
        self._sink.peer_gone(self.address)
        if not self._closed.done():
            self._closed.set_result(str(error) if error else "closed by the other end")

    def send(self, data: bytes, address: Address) -> bool:
        """See Transport."""
        transport = self._transport
        if transport is None or transport.is_closing():
            return False
        if transport.get_write_buffer_size() + len(data) > self._queue_bytes:
            return False
        # An unplugged serial port may say so here already; its loss is reported separately.
        with contextlib.suppress(OSError):
            transport.write(data)
            return True
        return False

    def confirm(self, address: Address) -> None:
        """Nothing to confirm: a stream was set up with its one peer."""

    def audience(self) -> list[Address]:
        """The one peer."""
        return [self.address]

    def send_errors(self) -> int:
        """A stream that refuses breaks."""
        return 0

    async def wait_closed(self) -> str:
        """See Transport."""
        return await asyncio.shield(self._closed)

    def abort(self) -> None:
        """Closes at once, whatever waits to leave."""
        if self._transport is not None:
            self._transport.abort()

    async def close(self) -> None:
        """See Transport."""
        self.abort()
        await self.wait_closed()


def keep_alive(raw_socket: socket.socket) -> None:
    """Makes the system notice a peer that is gone without a word: after about 20 s."""
    with contextlib.suppress(OSError, AttributeError):
        raw_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        raw_socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        raw_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 5)
        raw_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 5)
        raw_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
