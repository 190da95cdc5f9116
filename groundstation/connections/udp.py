"""UDP: many vehicles behind one socket, each answered at the address it speaks from.

An autopilot accepts replies only from the port that it sends to, so answers leave by the
listening socket. A stranger becomes part of the audience with its first verified frame: what
merely sends bytes is never sent to.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
from collections import OrderedDict
from typing import Any

from groundstation.connections.settings import ConnectionSettings
from groundstation.connections.transport import Address, Sink
from groundstation.connections.urls import LinkKind, LinkUrl
from groundstation.domain.errors import GroundstationError, InputError, ResourceError


class UdpTransport(asyncio.DatagramProtocol):
    """One socket. ``remote`` is whom a ``udpout`` speaks to before anybody has answered."""

    def __init__(self, sink: Sink, settings: ConnectionSettings, remote: Address = None) -> None:
        self._sink = sink
        self._settings = settings
        self._remote = remote
        self._peers: OrderedDict[Address, None] = OrderedDict()
        """Those who sent a verified frame, the one heard longest ago first."""
        # asyncio's own class is no DatagramTransport before Python 3.12, only acts as one.
        self._transport: Any = None
        self._closed: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._send_errors = 0

    @property
    def local_address(self) -> Address:
        """(host, port) of the socket."""
        if self._transport is None:
            return None
        name: Address = self._transport.get_extra_info("sockname")
        return name

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by asyncio."""
        self._transport = transport

    def datagram_received(self, data: bytes, address: tuple[str, int]) -> None:
        """Called by asyncio."""
        self._sink.received(data, address)

    def error_received(self, error: Exception) -> None:
        """Called by asyncio: an earlier datagram could not be delivered."""
        self._send_errors += 1

    def connection_lost(self, error: Exception | None) -> None:
        """Called by asyncio."""
        self._transport = None
        if not self._closed.done():
            self._closed.set_result(str(error) if error else "closed")

    def send(self, data: bytes, address: Address) -> bool:
        """See Transport."""
        transport = self._transport
        if transport is None or transport.is_closing():
            return False
        if transport.get_write_buffer_size() + len(data) > self._settings.write_queue_bytes:
            return False
        transport.sendto(data, address)
        return True

    def confirm(self, address: Address) -> None:
        """See Transport."""
        peers = self._peers
        if address in peers:
            peers.move_to_end(address)
            return
        if len(peers) >= self._settings.max_peers:
            peers.popitem(last=False)
        peers[address] = None

    def audience(self) -> list[Address]:
        """The verified peers, and the configured remote."""
        everyone = list(self._peers)
        if self._remote is not None and self._remote not in self._peers:
            everyone.append(self._remote)
        return everyone

    def send_errors(self) -> int:
        """See Transport."""
        return self._send_errors

    async def wait_closed(self) -> str:
        """See Transport."""
        return await asyncio.shield(self._closed)

    async def close(self) -> None:
        """See Transport."""
        if self._transport is not None:
            self._transport.abort()
        await self.wait_closed()


async def open_udp(url: LinkUrl, sink: Sink, settings: ConnectionSettings) -> UdpTransport:
    """Opens a ``udpin`` or ``udpout``. Raises ResourceError or InputError, one line each."""
    loop = asyncio.get_running_loop()
    listens = url.kind is LinkKind.UDP_IN
    try:
        found = await loop.getaddrinfo(url.host, url.port, type=socket.SOCK_DGRAM)
    except socket.gaierror as error:
        raise InputError(f"{url.name}: cannot find host {url.host!r}: {error.strerror}") from error
    family, _kind, _protocol, _name, address = found[0]
    raw_socket = socket.socket(family, socket.SOCK_DGRAM)
    try:
        raw_socket.setblocking(False)
        raw_socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        with contextlib.suppress(OSError):
            raw_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, settings.receive_buffer_bytes)
        if listens:
            raw_socket.bind(address)
        else:
            raw_socket.bind(("::" if family == socket.AF_INET6 else "0.0.0.0", 0))
        _, transport = await loop.create_datagram_endpoint(
            lambda: UdpTransport(sink, settings, None if listens else address), sock=raw_socket
        )
    except BaseException as error:
        raw_socket.close()
        if isinstance(error, OSError):
            raise bind_error(url, error) from error
        raise
    return transport


def bind_error(url: LinkUrl, error: OSError) -> GroundstationError:
    """One line for a socket that could not be opened."""
    if error.errno == errno.EADDRINUSE:
        return ResourceError(
            f"{url.name}: port {url.port} is in use by another program; close it or choose another port"
        )
    if error.errno == errno.EADDRNOTAVAIL:
        return InputError(
            f"{url.name}: this machine has no address {url.host}; use 0.0.0.0 for all of its own"
        )
    if error.errno in (errno.EACCES, errno.EPERM):
        return ResourceError(f"{url.name}: not allowed to open port {url.port}; ports below 1024 need rights")
    return ResourceError(f"{url.name}: cannot open: {error.strerror or error}")
