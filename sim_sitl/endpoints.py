"""Sockets of the simulator: part of its shell.

Each simulated vehicle speaks from a socket of its own, as real autopilots do; an attached one
is listened to on one port. Keeps the rule that nothing above knows what a socket is: bytes in
by a callback, bytes out by ``send``.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable
from dataclasses import dataclass

from groundstation.domain.errors import ResourceError, UsageError

RETRY_S = 0.5
"""Between tries to reach a TCP station."""
_URL = re.compile(r"(?P<kind>[a-z]+):(?://)?(?P<host>\[[^\]]+\]|[^:/]*):(?P<port>\d+)")


@dataclass(frozen=True, slots=True)
class LinkUrl:
    """Where to speak to, or listen."""

    kind: str
    """``udpout``, ``udpin`` or ``tcp``."""
    host: str
    port: int


def parse_link(text: str, kinds: tuple[str, ...]) -> LinkUrl:
    """``udpout:HOST:PORT``, ``udpin:HOST:PORT`` or ``tcp:HOST:PORT`` (``://`` too); raises UsageError."""
    match = _URL.fullmatch(text)
    needed = " or ".join(f"{kind}:HOST:PORT" for kind in kinds)
    if match is None:
        raise UsageError(f"link {text!r} is not understood; needed: {needed}")
    kind = {"tcpout": "tcp", "udp": "udpout"}.get(match["kind"], match["kind"])
    port = int(match["port"])
    if kind not in kinds or not 1 <= port <= 65535:
        raise UsageError(f"link {text!r} cannot be used here; needed: {needed}, port 1 to 65535")
    return LinkUrl(kind, match["host"].strip("[]") or "127.0.0.1", port)


class UdpOut(asyncio.DatagramProtocol):
    """One socket that speaks to one address and hears what is sent back to it."""

    def __init__(self, on_bytes: Callable[[bytes], None]) -> None:
        self._on_bytes = on_bytes
        self._transport: asyncio.DatagramTransport | None = None
        self.refused = 0
        """Times the other side said nobody is there (it may come later)."""

    async def open(self, url: LinkUrl) -> None:
        """Open it; raises ResourceError."""
        loop = asyncio.get_running_loop()
        try:
            self._transport, _ = await loop.create_datagram_endpoint(
                lambda: self, remote_addr=(url.host, url.port)
            )
        except OSError as error:
            raise ResourceError(f"cannot send to {url.host}:{url.port}: {error.strerror or error}") from error

    def datagram_received(self, data: bytes, addr: object) -> None:
        """asyncio's callback."""
        self._on_bytes(data)

    def error_received(self, exc: Exception) -> None:
        """asyncio's callback: ICMP says nobody listens there (yet)."""
        self.refused += 1

    def send(self, data: bytes) -> None:
        """One datagram."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.sendto(data)

    def close(self) -> None:
        """Close the socket."""
        if self._transport is not None:
            self._transport.close()


class UdpIn(asyncio.DatagramProtocol):
    """One listening socket; datagrams come with the address to answer at."""

    def __init__(self, on_datagram: Callable[[bytes, tuple[str, int]], None]) -> None:
        self._on_datagram = on_datagram
        self._transport: asyncio.DatagramTransport | None = None

    async def open(self, url: LinkUrl) -> None:
        """Bind it; raises ResourceError."""
        loop = asyncio.get_running_loop()
        try:
            self._transport, _ = await loop.create_datagram_endpoint(
                lambda: self, local_addr=(url.host, url.port)
            )
        except OSError as error:
            raise ResourceError(
                f"cannot listen on {url.host}:{url.port}: {error.strerror or error}; "
                "needed: a free port of this machine"
            ) from error

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """asyncio's callback."""
        self._on_datagram(data, addr)

    def error_received(self, exc: Exception) -> None:
        """asyncio's callback: an answer found nobody; its sender will be heard again or not."""

    def send(self, data: bytes, address: tuple[str, int]) -> None:
        """One datagram to ``address``."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.sendto(data, address)

    def close(self) -> None:
        """Close the socket."""
        if self._transport is not None:
            self._transport.close()


class TcpOut:
    """A TCP client that keeps trying; what is said while nobody listens is lost, counted."""

    MAX_BUFFERED = 1 << 20
    """Bytes waiting for a station that does not read; more are lost."""

    def __init__(self, on_bytes: Callable[[bytes], None]) -> None:
        self._on_bytes = on_bytes
        self._writer: asyncio.StreamWriter | None = None
        self._task: asyncio.Task[None] | None = None
        self.lost = 0

    async def open(self, url: LinkUrl) -> None:
        """Start connecting, and return."""
        self._task = asyncio.create_task(self._run(url))

    async def _run(self, url: LinkUrl) -> None:
        while True:
            try:
                reader, self._writer = await asyncio.open_connection(url.host, url.port)
                while data := await reader.read(65536):
                    self._on_bytes(data)
            except OSError:
                pass
            finally:
                if self._writer is not None:
                    self._writer.close()
                    self._writer = None
            await asyncio.sleep(RETRY_S)

    def send(self, data: bytes) -> None:
        """Bytes to the station."""
        writer = self._writer
        if writer is None or writer.transport.get_write_buffer_size() > self.MAX_BUFFERED:
            self.lost += 1
            return
        writer.write(data)

    def close(self) -> None:
        """Stop."""
        if self._task is not None:
            self._task.cancel()


Endpoint = UdpOut | TcpOut


async def open_endpoint(url: LinkUrl, on_bytes: Callable[[bytes], None]) -> Endpoint:
    """A socket towards the station."""
    endpoint: Endpoint = UdpOut(on_bytes) if url.kind == "udpout" else TcpOut(on_bytes)
    await endpoint.open(url)
    return endpoint
