"""Owns every radio, knows who was heard where, and sends each frame to the one address it is for.

What left and what could not leave is counted; nothing here reads a payload, and nothing leaves
that the caller (the guard) did not hand over.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence

from groundstation.connections.forward import Forward
from groundstation.connections.link import Link
from groundstation.connections.settings import ConnectionSettings
from groundstation.connections.supervisor import LinkState
from groundstation.connections.transport import Address
from groundstation.connections.urls import LinkUrl, parse_url
from groundstation.domain.errors import InputError
from groundstation.domain.events import Counter
from groundstation.mavlink.duplicates import DuplicateFilter
from groundstation.mavlink.framing import Frame
from groundstation.mavlink.routing import RoutingTable, Target, target_of

OnFrames = Callable[[str, list[Frame], Address], None]
OnState = Callable[[str, str, str], None]
Stamp = Callable[[Frame, str], bytes]


class Hub:
    """All connections of the station.

    ``on_frames(connection, frames, address)`` gets verified frames in the order they came, each
    once, whatever number of radios heard it; ``on_state(connection, state, detail)`` hears of
    each change (``open``, ``closed``, ``waiting``, ``failed``). Both are called in the event loop
    and must not wait.

    Raises InputError for a URL that cannot be used or is given twice.
    """

    def __init__(
        self,
        urls: Sequence[LinkUrl | str],
        on_frames: OnFrames,
        on_state: OnState,
        *,
        settings: ConnectionSettings | None = None,
        forwards: Sequence[Forward] = (),
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        settings = settings if settings is not None else ConnectionSettings()
        self.routing = RoutingTable()
        self._on_frames = on_frames
        self._on_state = on_state
        self._clock_ns = clock_ns
        self._forwards = tuple(forwards)
        duplicates = DuplicateFilter()
        self._links: dict[str, Link] = {}
        for given in urls:
            url = parse_url(given) if isinstance(given, str) else given
            if url.name in self._links:
                raise InputError(f"link {url.name} is given twice; each connection can be opened once")
            self._links[url.name] = Link(url, self, settings, duplicates)
        self.unroutable = 0
        """Targeted frames for somebody never heard."""

    @property
    def connections(self) -> tuple[str, ...]:
        """Names of all connections, in the order given."""
        return tuple(self._links)

    def is_open(self, connection: str) -> bool:
        """Whether a connection is open now."""
        return self._links[connection].is_open

    def local_address(self, connection: str) -> Address:
        """Where a connection listens, while open: (host, port)."""
        return self._links[connection].local_address

    def hears(self, system_id: int) -> bool:
        """Whether any component of that system was heard."""
        return any(system == system_id for system, _component in self.routing.heard())

    async def run(self) -> None:
        """Keeps all connections open until cancelled, then closes them."""
        async with asyncio.TaskGroup() as group:
            for name, link in self._links.items():
                group.create_task(link.run(), name=f"link {name}")
            for forward in self._forwards:
                group.create_task(forward.run(), name=forward.name)

    async def tried(self) -> None:
        """Returns when every connection has been tried once, well or not."""
        for link in self._links.values():
            await link.tried()
        for forward in self._forwards:
            await forward.tried()

    def send(self, frame: bytes) -> int:
        """Sends one frame where it is for; to how many peers it left (0: nobody, counted)."""
        target = target_of(frame)
        if target is None:
            return sum(link.send_all(frame) for link in self._links.values())
        route = self.routing.route(target)
        if route is None:
            self.unroutable += 1
            return 0
        return int(self._links[route.connection].send(frame, route.address))

    def send_stamped(
        self, frame: Frame, stamp: Stamp, system_id: int | None = None
    ) -> list[tuple[str, bytes]]:
        """As ``send``, but each peer gets the frame as ``stamp(frame, peer)`` makes it: a sequence
        number of its own, so that no peer sees gaps for what went to another. ``system_id`` is
        whom a message without target fields (TIMESYNC) is meant for. Returns (connection, bytes)
        of each frame that left.
        """
        target = target_of(frame.raw)
        if target is None and system_id is not None:
            target = Target(system_id, 0)
        if target is None:
            peers = [(link, address) for link in self._links.values() for address in link.audience()]
        else:
            route = self.routing.route(target)
            if route is None:
                self.unroutable += 1
                return []
            peers = [(self._links[route.connection], route.address)]
        left = []
        for link, address in peers:
            raw = stamp(frame, f"{link.name} {address}")
            if link.send(raw, address):
                left.append((link.name, raw))
        return left

    def counters(self) -> list[Counter]:
        """All totals of all connections."""
        counters = [
            Counter("routing_unroutable_total", (), self.unroutable),
            Counter("routing_evicted_total", (), self.routing.evicted),
        ]
        for link in self._links.values():
            counters += link.counters()
        for forward in self._forwards:
            counters += forward.counters()
        return counters

    def frames(self, link: Link, frames: list[Frame], address: Address) -> None:
        """Verified frames (called by a link)."""
        now_ns = self._clock_ns()
        for frame in frames:
            self.routing.learn(frame, link.name, address, now_ns)
        for forward in self._forwards:
            forward.pass_on([frame.raw for frame in frames])
        self._on_frames(link.name, frames, address)

    def unverified(self, _link: Link, raws: list[bytes]) -> None:
        """Frames of unknown ids (called by a link): other stations may know them."""
        for forward in self._forwards:
            forward.pass_on(raws)

    def state(self, link: Link, state: LinkState, detail: str) -> None:
        """A connection changed (called by a link)."""
        if state is LinkState.CLOSED:
            self.routing.forget(link.name)
        self._on_state(link.name, state.value, detail)
