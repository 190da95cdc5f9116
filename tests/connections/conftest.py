"""Hubs that run for the length of a test, and peers on sockets of their own."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from groundstation.connections.forward import Forward
from groundstation.connections.hub import Hub
from groundstation.connections.settings import ConnectionSettings
from groundstation.mavlink.framing import Frame

# A loaded machine is slow, not wrong.
settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")

QUICK = ConnectionSettings(
    backoff_initial_s=0.02, backoff_factor=2.0, backoff_max_s=0.1, stable_after_s=5.0, connect_timeout_s=2.0
)


@dataclass
class Running:
    """A hub under way and everything that it said."""

    hub: Hub
    heard: list[tuple[str, Frame, Any]] = field(default_factory=list)
    states: list[tuple[str, str, str]] = field(default_factory=list)

    async def until(self, condition: Callable[[], Any], what: str, timeout_s: float = 8.0) -> None:
        """Waits for ``condition``, at most ``timeout_s``."""
        try:
            async with asyncio.timeout(timeout_s):
                while not condition():  # noqa: ASYNC110 - conditions of all sorts, no event to wait for
                    await asyncio.sleep(0.005)
        except TimeoutError:
            pytest.fail(f"never happened: {what}; states {self.states[-5:]}, heard {len(self.heard)}")

    async def is_open(self, connection: str | None = None) -> Any:
        """Waits until a connection is open; where it listens."""
        name = connection or self.hub.connections[0]
        await self.until(lambda: self.hub.is_open(name), f"{name} open")
        return self.hub.local_address(name)

    def counter(self, name: str, **labels: str) -> int:
        """Sum of the counters of that name with these labels."""
        return sum(
            counter.value
            for counter in self.hub.counters()
            if counter.name == name and set(labels.items()) <= set(counter.labels)
        )


RunHub = Callable[..., AbstractAsyncContextManager[Running]]


@pytest.fixture
def run_hub() -> RunHub:
    """``async with run_hub([urls], settings=…, forwards=…) as running``."""

    @contextlib.asynccontextmanager
    async def run(
        urls: Sequence[str],
        settings: ConnectionSettings = QUICK,
        forwards: Sequence[Forward] = (),
        heard: list[tuple[str, Frame, Any]] | None = None,
    ) -> AsyncIterator[Running]:
        heard = [] if heard is None else heard
        states: list[tuple[str, str, str]] = []
        hub = Hub(
            urls,
            lambda name, frames, address: heard.extend((name, frame, address) for frame in frames),
            lambda name, state, detail: states.append((name, state, detail)),
            settings=settings,
            forwards=forwards,
        )
        task = asyncio.create_task(hub.run())
        try:
            async with asyncio.timeout(8.0):
                await hub.tried()
            yield Running(hub, heard, states)
        finally:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.wait_for(task, 5.0)

    return run


@dataclass
class UdpPeer:
    """A vehicle's socket: non-blocking, on a port of its own."""

    socket: socket.socket

    @property
    def address(self) -> Any:
        """(host, port)."""
        return self.socket.getsockname()

    def send(self, data: bytes, address: Any) -> None:
        """Sends one datagram."""
        self.socket.sendto(data, address)

    async def receive(self, timeout_s: float = 5.0) -> bytes:
        """The next datagram."""
        return await asyncio.wait_for(asyncio.get_running_loop().sock_recv(self.socket, 2048), timeout_s)

    def nothing_came(self) -> bool:
        """Whether no datagram waits."""
        try:
            self.socket.recv(2048)
        except BlockingIOError:
            return True
        return False


@pytest.fixture
def udp_peer() -> Any:
    """Makes UDP peers; all are closed afterwards."""
    made: list[socket.socket] = []

    def make() -> UdpPeer:
        raw_socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        raw_socket.setblocking(False)
        raw_socket.bind(("127.0.0.1", 0))
        made.append(raw_socket)
        return UdpPeer(raw_socket)

    yield make
    for raw_socket in made:
        raw_socket.close()
