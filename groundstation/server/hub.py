"""Between the picture and its clients: publishes deltas, at most ten a second.

Rule: one bounded backlog a client. What waits for a slow client is merged (state
coalesced, events complete); when its events pass the bound the client is closed, never
the station slowed. One event loop, no locks.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass

from groundstation.domain.errors import ResourceError
from groundstation.server import wire
from groundstation.server.merge import merge
from groundstation.server.picture import Picture, PictureInput


@dataclass(frozen=True, slots=True)
class Encoded:
    """A message and its JSON, encoded once for all clients that are up to date."""

    message: wire.Snapshot | wire.Delta | wire.Heartbeat
    json: str


def encode(message: wire.Snapshot | wire.Delta | wire.Heartbeat) -> Encoded:
    """The message with its JSON."""
    return Encoded(message, message.model_dump_json())


class Client:
    """One websocket's backlog: at most one head (snapshot or resume), one delta, one heartbeat."""

    def __init__(self, events_max: int) -> None:
        self._events_max = events_max
        self._head: Encoded | None = None
        self._delta: Encoded | None = None
        self._heartbeat: Encoded | None = None
        self._wake = asyncio.Event()
        self.overflowed = False
        self.merged_total = 0

    def offer(self, item: Encoded) -> None:
        """Queue a message; never blocks."""
        message = item.message
        if isinstance(message, wire.Heartbeat):
            self._heartbeat = item
        elif isinstance(message, wire.Snapshot):
            self._head = item
        elif self._delta is None:
            self._delta = item
        else:
            assert isinstance(self._delta.message, wire.Delta)
            # Encoded again only when it is taken: a client far behind costs no JSON.
            self._delta = Encoded(merge(self._delta.message, message), "")
            self.merged_total += 1
        if self._delta is not None and isinstance(self._delta.message, wire.Delta):
            self.overflowed = len(self._delta.message.events) > self._events_max
        self._wake.set()

    async def take(self) -> Encoded:
        """The next message in order; waits for one."""
        while True:
            for name in ("_head", "_delta", "_heartbeat"):
                item: Encoded | None = getattr(self, name)
                if item is not None:
                    setattr(self, name, None)
                    return item if item.json else encode(item.message)
            self._wake.clear()
            await self._wake.wait()


class Hub:
    """Takes outputs in, tells every client."""

    def __init__(self, picture: Picture, clock: Callable[[], int] = time.time_ns) -> None:
        """``clock`` gives station time, ns: ages on the page are counted against it."""
        self.picture = picture
        self.clock = clock
        self.settings = picture.settings
        self.clients: dict[Client, None] = {}
        self.clients_refused_total = 0
        self.clients_stalled_total = 0
        self.published_total = 0
        self._changed = asyncio.Event()

    def apply(self, output: PictureInput, time_ns: int | None = None) -> None:
        """Picture.apply, then the next publication."""
        self.picture.apply(output, time_ns)
        self._changed.set()

    def notify(self) -> None:
        """The picture was changed elsewhere."""
        self._changed.set()

    def publish(self) -> None:
        """Tell every client what changed, now."""
        delta = self.picture.take_delta(self.clock())
        if delta is None:
            return
        item = encode(delta)
        self.published_total += 1
        for client in self.clients:
            client.offer(item)

    def attach(self, since: tuple[str, int] | None = None) -> Client:
        """A new client, with its first message waiting: what it missed, or the whole picture.

        Raises ResourceError when there are too many.
        """
        if len(self.clients) >= self.settings.max_clients:
            self.clients_refused_total += 1
            raise ResourceError(
                f"{len(self.clients)} pages are connected, which is the limit; close one and try again"
            )
        self.publish()
        client = Client(self.settings.client_events_max)
        missed = self.picture.since(*since) if since is not None else None
        if missed is None:
            client.offer(encode(self.picture.snapshot(self.clock())))
        else:
            for delta in missed:
                client.offer(encode(delta))
            client.offer(encode(self.picture.heartbeat(self.clock())))
        self.clients[client] = None
        return client

    def detach(self, client: Client) -> None:
        """The client is gone."""
        self.clients.pop(client, None)

    async def run(self) -> None:
        """Publish when something changed, at most at the set rate; heartbeat otherwise. Until cancelled."""
        while True:
            try:
                # Not wait_for: before Python 3.12 it loses a cancellation that comes with the change.
                async with asyncio.timeout(self.settings.heartbeat_interval_s):
                    await self._changed.wait()
            except TimeoutError:
                beat = encode(self.picture.heartbeat(self.clock()))
                for client in self.clients:
                    client.offer(beat)
                continue
            self._changed.clear()
            self.publish()
            await asyncio.sleep(self.settings.publish_interval_s)
