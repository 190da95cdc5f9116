"""Repositions through MAVSDK, where the settings ask for it: one flight a grant.

The desk still gates, grants, verifies and, with its own protocol, holds. MAVSDK only takes
the place of the one frame that the desk would have sent; it retries by itself, and whatever
it emits is matched by the guard against the grant.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import TracebackType

from groundstation.command.mavsdk_adapter import MavsdkAdapter
from groundstation.command.settings import CommandSettings
from groundstation.domain.errors import PeerError
from groundstation.domain.events import Counter, Event, Severity
from groundstation.mavlink.framing import Frame
from groundstation.safety.grants import Grant


class MavsdkLane:
    """An asynchronous context manager round one ``MavsdkAdapter``."""

    def __init__(
        self,
        send: Callable[[Frame], None],
        tell: Callable[[Event], None],
        settings: CommandSettings,
        clock_ns: Callable[[], int],
    ) -> None:
        """``send`` gets what MAVSDK emits, to be judged by the guard; ``tell`` gets events of station
        time ``clock_ns()``.
        """
        self._clock_ns = clock_ns
        self._adapter = MavsdkAdapter(send, settings)
        self._tell = tell
        self._flights: dict[int, tuple[str, asyncio.Task[None]]] = {}

    async def __aenter__(self) -> MavsdkLane:
        await self._adapter.__aenter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for _, task in self._flights.values():
            task.cancel()
        await self._adapter.__aexit__(kind, error, trace)

    def feed(self, raw: bytes) -> None:
        """A verified frame from a vehicle."""
        self._adapter.feed(raw)

    def counters(self) -> list[Counter]:
        """The adapter's."""
        return self._adapter.counters()

    def fly(self, grant: Grant | None) -> None:
        """Begin the flight of a live grant; a second call for the same grant is MAVSDK's own retry."""
        if grant is None:
            return
        running = self._flights.get(grant.vehicle_id)
        if running is not None and running[0] == grant.grant_id:
            return
        if running is not None:
            running[1].cancel()
        task = asyncio.get_running_loop().create_task(self._fly(grant), name=f"mavsdk {grant.grant_id}")
        self._flights[grant.vehicle_id] = (grant.grant_id, task)

    async def _fly(self, grant: Grant) -> None:
        try:
            await self._adapter.goto_location(grant.vehicle_id, grant.target)
        except PeerError as error:
            text = f"MAVSDK: {error}"
            self._tell(Event(self._clock_ns(), "mavsdk.refused", Severity.WARNING, text, grant.vehicle_id))
