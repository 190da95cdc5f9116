"""TCP: a client of one server, or a server of many clients."""

from __future__ import annotations

import asyncio
import contextlib
import socket

from groundstation.connections.settings import ConnectionSettings
from groundstation.connections.transport import Address, Sink, StreamPeer
from groundstation.connections.udp import bind_error
from groundstation.connections.urls import LinkUrl
from groundstation.domain.errors import InputError, PeerError


async def open_tcp_client(url: LinkUrl, sink: Sink, settings: ConnectionSettings) -> StreamPeer:
    """Connects. Raises PeerError where nobody listens, InputError where there is no such host."""
    loop = asyncio.get_running_loop()
    try:
        _, peer = await loop.create_connection(
            lambda: StreamPeer(sink, settings.write_queue_bytes), url.host, url.port
        )
    except socket.gaierror as error:
        raise InputError(f"{url.name}: cannot find host {url.host!r}: {error.strerror}") from error
    except ConnectionRefusedError as error:
        raise PeerError(f"{url.name}: nobody listens there (connection refused)") from error
    except OSError as error:
        raise PeerError(f"{url.name}: cannot connect: {error.strerror or error}") from error
    return peer


class _Client(StreamPeer):
    """One client; its address is known when it has connected."""

    def __init__(self, server: TcpServer, sink: Sink, queue_bytes: int) -> None:
        super().__init__(sink, queue_bytes)
        self._server = server
        self.accepted = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.address = transport.get_extra_info("peername")
        self.accepted = self._server.accept(self)

    def data_received(self, data: bytes) -> None:
        if self.accepted:
            super().data_received(data)

    def connection_lost(self, error: Exception | None) -> None:
        self._server.lost(self)
        super().connection_lost(error)


class TcpServer:
    """A listening socket and its clients; losing a client does not close it."""

    def __init__(self, settings: ConnectionSettings) -> None:
        self._settings = settings
        self._clients: dict[Address, _Client] = {}
        self._server: asyncio.Server | None = None
        self._closed: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self.turned_away = 0
        """Clients beyond ``max_clients``."""

    @classmethod
    async def open(cls, url: LinkUrl, sink: Sink, settings: ConnectionSettings) -> TcpServer:
        """Listens. Raises ResourceError or InputError, one line each."""
        self = cls(settings)
        try:
            self._server = await asyncio.get_running_loop().create_server(
                lambda: _Client(self, sink, settings.write_queue_bytes), url.host, url.port
            )
        except socket.gaierror as error:
            raise InputError(f"{url.name}: cannot find host {url.host!r}: {error.strerror}") from error
        except OSError as error:
            raise bind_error(url, error) from error
        return self

    @property
    def local_address(self) -> Address:
        """(host, port) of the listening socket."""
        if self._server is None or not self._server.sockets:
            return None
        name: Address = self._server.sockets[0].getsockname()
        return name

    def accept(self, client: _Client) -> bool:
        """Takes a client in, or turns it away."""
        if len(self._clients) >= self._settings.max_clients or self._closed.done():
            self.turned_away += 1
            client.abort()
            return False
        self._clients[client.address] = client
        return True

    def lost(self, client: _Client) -> None:
        """A client left."""
        if self._clients.get(client.address) is client:
            del self._clients[client.address]

    def send(self, data: bytes, address: Address) -> bool:
        """See Transport."""
        client = self._clients.get(address)
        return client is not None and client.send(data, address)

    def confirm(self, address: Address) -> None:
        """Nothing to confirm: a client is there because it connected."""

    def audience(self) -> list[Address]:
        """All clients."""
        return list(self._clients)

    def send_errors(self) -> int:
        """Clients turned away."""
        return self.turned_away

    async def wait_closed(self) -> str:
        """See Transport."""
        return await asyncio.shield(self._closed)

    async def close(self) -> None:
        """See Transport."""
        if not self._closed.done():
            self._closed.set_result("closed")
        if self._server is not None:
            self._server.close()
        for client in list(self._clients.values()):
            await client.close()
        if self._server is not None:
            with contextlib.suppress(OSError):
                await self._server.wait_closed()
