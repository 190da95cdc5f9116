"""One supervised connection with its framers: bytes of each peer in, verified frames out.

Each peer address has a framer of its own, so garbage from one cannot harm another.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from typing import Protocol

from groundstation.connections.serial import open_serial
from groundstation.connections.settings import ConnectionSettings
from groundstation.connections.supervisor import LinkState, Supervisor
from groundstation.connections.tcp import TcpServer, open_tcp_client
from groundstation.connections.transport import Address, Sink, Transport
from groundstation.connections.udp import open_udp
from groundstation.connections.urls import LinkKind, LinkUrl
from groundstation.domain.events import Counter
from groundstation.mavlink.duplicates import DuplicateFilter
from groundstation.mavlink.framing import Frame, Framer
from groundstation.mavlink.statistics import LinkStatistics


class LinkOwner(Protocol):
    """Who takes what a link hears."""

    def frames(self, link: Link, frames: list[Frame], address: Address) -> None:
        """Verified frames from one peer, in order."""

    def unverified(self, link: Link, raws: list[bytes]) -> None:
        """Whole frames of unknown ids: to be passed on, not to be believed."""

    def state(self, link: Link, state: LinkState, detail: str) -> None:
        """The connection changed."""


class Link:
    """One connection by URL."""

    def __init__(
        self,
        url: LinkUrl,
        owner: LinkOwner,
        settings: ConnectionSettings,
        duplicates: DuplicateFilter | None = None,
        name: str = "",
    ) -> None:
        self.url = url
        self.name = name or url.name
        self._owner = owner
        self._settings = settings
        self._duplicates = duplicates
        self._framers: OrderedDict[Address, Framer] = OrderedDict()
        """By peer, the one heard longest ago first."""
        self._retired = LinkStatistics()
        """Totals of peers that are gone."""
        self._supervisor = Supervisor(self._open, self._on_state, settings)
        self.peers_evicted = 0
        self.sent_frames = 0
        self.sent_bytes = 0
        self.refused_frames = 0
        """Not sent: the queue was full or the peer gone."""
        self.unsent_closed = 0
        """Not sent: the connection was not open."""

    async def run(self) -> None:
        """Keeps the connection open until cancelled."""
        await self._supervisor.run()

    async def tried(self) -> None:
        """Returns when the first try to open has ended, well or not."""
        await self._supervisor.tried()

    @property
    def is_open(self) -> bool:
        """Whether it is open now."""
        return self._supervisor.transport is not None

    @property
    def local_address(self) -> Address:
        """Where it listens, while open."""
        transport = self._supervisor.transport
        return transport.local_address if transport is not None else None

    def send(self, data: bytes, address: Address, frames: int = 1) -> bool:
        """Queues ``data`` (``frames`` whole frames) for one peer; False and counted where it cannot leave."""
        transport = self._supervisor.transport
        if transport is None:
            self.unsent_closed += frames
            return False
        if not transport.send(data, address):
            self.refused_frames += frames
            return False
        self.sent_frames += frames
        self.sent_bytes += len(data)
        return True

    def audience(self) -> tuple[Address, ...]:
        """Every peer that a broadcast goes to; nobody while closed."""
        transport = self._supervisor.transport
        return tuple(transport.audience()) if transport is not None else ()

    def send_all(self, data: bytes, frames: int = 1) -> int:
        """Queues ``data`` for every peer; how many took it."""
        transport = self._supervisor.transport
        if transport is None:
            self.unsent_closed += frames
            return 0
        return sum(self.send(data, address, frames) for address in transport.audience())

    def statistics(self) -> LinkStatistics:
        """Totals over all peers, also those that are gone."""
        total = LinkStatistics()
        total.merge(self._retired)
        for framer in self._framers.values():
            total.merge(framer.statistics)
        return total

    def counters(self) -> list[Counter]:
        """All totals of this connection."""
        label = (("connection", self.name),)
        supervisor = self._supervisor
        transport = supervisor.transport
        own = {
            "connection_opened_total": supervisor.opened,
            "connection_open_failures_total": supervisor.failures,
            "connection_peers_evicted_total": self.peers_evicted,
            "connection_sent_frames_total": self.sent_frames,
            "connection_sent_bytes_total": self.sent_bytes,
            "connection_refused_frames_total": self.refused_frames,
            "connection_unsent_closed_total": self.unsent_closed,
            "connection_send_errors_total": transport.send_errors() if transport is not None else 0,
        }
        return [
            *(Counter(name, label, value) for name, value in own.items()),
            *self.statistics().counters(self.name),
        ]

    def received(self, data: bytes, address: Address) -> None:
        """Bytes from a peer (called by the transport)."""
        framer = self._framers.get(address)
        if framer is None:
            if len(self._framers) >= self._settings.max_peers:
                _, evicted = self._framers.popitem(last=False)
                self._retire(evicted)
                self.peers_evicted += 1
            framer = self._framers[address] = Framer(self._duplicates)
        else:
            self._framers.move_to_end(address)
        heard = framer.statistics.verified_frames
        frames = framer.feed(data)
        transport = self._supervisor.transport
        # Also a duplicate shows that somebody is there.
        if framer.statistics.verified_frames > heard and transport is not None:
            transport.confirm(address)
        # A fault in whoever takes the frames must not close the radio they came by.
        try:
            if frames:
                self._owner.frames(self, frames, address)
            if raws := framer.take_unverified():
                self._owner.unverified(self, raws)
        except Exception as error:
            asyncio.get_running_loop().call_exception_handler(
                {"message": f"frames from {self.name} could not be handled", "exception": error}
            )

    def peer_gone(self, address: Address) -> None:
        """A peer left (called by the transport)."""
        framer = self._framers.pop(address, None)
        if framer is not None:
            self._retire(framer)

    def _retire(self, framer: Framer) -> None:
        # What is left of a frame that never ended is garbage now.
        framer.statistics.garbage_bytes += framer.pending_bytes
        self._retired.merge(framer.statistics)

    def _on_state(self, state: LinkState, detail: str) -> None:
        if state is LinkState.CLOSED:
            for address in list(self._framers):
                self.peer_gone(address)
        self._owner.state(self, state, detail)

    async def _open(self) -> Transport:
        return await _OPENERS[self.url.kind](self.url, self, self._settings)


_OPENERS: dict[LinkKind, Callable[[LinkUrl, Sink, ConnectionSettings], Awaitable[Transport]]] = {
    LinkKind.UDP_IN: open_udp,
    LinkKind.UDP_OUT: open_udp,
    LinkKind.TCP_CLIENT: open_tcp_client,
    LinkKind.TCP_SERVER: TcpServer.open,
    LinkKind.SERIAL: open_serial,
}
