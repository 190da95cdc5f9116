"""MAVSDK behind our own connections: it never opens a radio.

Verified frames go in; what it wants to send comes out on a thread of the library's and is
only handed to the event loop there. The caller passes every such frame through the guard:
MAVSDK goes on retrying a command whose caller has given up, sends a heartbeat of its own
and asks for things nobody wanted.

It is an alternative to the desk's own protocol for single commands, and the way to
missions, geofences and parameters. Shell: imports asyncio and threads of the library.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from mavsdk import mavsdk as mavsdk_library
from mavsdk.asyncio.plugins.action import ActionAsync, ActionError
from mavsdk.asyncio.system import System
from mavsdk.logging import LogLevel, log_subscribe

from groundstation.command.settings import CommandSettings
from groundstation.domain.errors import PeerError
from groundstation.domain.events import Counter
from groundstation.domain.geometry import Geodetic
from groundstation.mavlink.framing import Frame, Framer

MAX_QUEUED = 1000
"""Frames from the library that may wait for the event loop; more are dropped, counted."""

_LOGGER = logging.getLogger(__name__)
_LEVELS = {
    LogLevel.DEBUG: logging.DEBUG,
    LogLevel.INFO: logging.DEBUG,
    LogLevel.WARN: logging.INFO,
    LogLevel.ERROR: logging.WARNING,
}


def _log(level: LogLevel, message: str, _file: str | None, _line: int) -> bool:
    """Keeps the library from writing to our standard output."""
    _LOGGER.log(_LEVELS[level], "MAVSDK: %s", message)
    return True


class MavsdkAdapter:
    """One MAVSDK instance on ``raw://``; use it as an asynchronous context manager."""

    def __init__(self, send: Callable[[Frame], None], settings: CommandSettings | None = None) -> None:
        """``send`` is called in the event loop with each frame that MAVSDK wants to send."""
        self._send = send
        self._settings = settings or CommandSettings()
        self._framer = Framer()
        self._library: Any = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._systems: dict[int, Any] = {}
        self._actions: dict[int, Any] = {}
        self._queued = 0
        self.dropped_total = 0
        self.emitted_total = 0

    async def __aenter__(self) -> MavsdkAdapter:
        self._loop = asyncio.get_running_loop()
        log_subscribe(_log)
        configuration = mavsdk_library.Configuration.create_manual(
            self._settings.system_id, self._settings.component_id, False
        )
        self._library = mavsdk_library.Mavsdk(configuration)
        self._library.add_any_connection_with_handle("raw://")
        self._library.subscribe_raw_bytes_to_be_sent(self._on_library_thread)
        return self

    async def __aexit__(self, *_: object) -> None:
        library, self._library = self._library, None
        self._systems.clear()
        self._actions.clear()
        # Waits for callbacks that are running on its threads.
        await asyncio.get_running_loop().run_in_executor(None, library.destroy)

    def feed(self, frame: bytes) -> None:
        """A verified frame from a vehicle."""
        if self._library is not None:
            self._library.pass_received_raw_bytes(frame)

    async def goto_location(self, vehicle_id: int, target: Geodetic) -> None:
        """Sends a vehicle to a place, heading as it is; returns when it has acknowledged.

        Needs a live grant, or the guard lets none of it out. Cancelling this does not stop
        the library from retrying; only the guard does. Raises PeerError where MAVSDK knows no
        such vehicle or the vehicle refuses.
        """
        action = self._action(vehicle_id)
        try:
            await action.goto_location(
                target.latitude_deg, target.longitude_deg, target.altitude_amsl_m, float("nan")
            )
        except ActionError as error:
            raise PeerError(f"vehicle {vehicle_id} did not take the place: {error}") from error

    async def hold(self, vehicle_id: int) -> None:
        """Makes a vehicle hold where it is. The desk's own hold does not depend on this."""
        action = self._action(vehicle_id)
        try:
            await action.hold()
        except ActionError as error:
            raise PeerError(f"vehicle {vehicle_id} does not hold: {error}") from error

    def known_vehicles(self) -> list[int]:
        """System ids that MAVSDK has discovered an autopilot of."""
        for raw in self._library.get_systems():
            system_id = int(raw.get_system_id())
            if system_id not in self._systems and raw.has_autopilot():
                self._systems[system_id] = raw
        return sorted(self._systems)

    def counters(self) -> list[Counter]:
        """What came out of the library and what had to be dropped."""
        return [
            Counter("mavsdk_frames_total", (("outcome", "emitted"),), self.emitted_total),
            Counter("mavsdk_frames_total", (("outcome", "dropped"),), self.dropped_total),
        ]

    def _action(self, vehicle_id: int) -> Any:
        if vehicle_id not in self._actions:
            if vehicle_id not in self.known_vehicles():
                raise PeerError(f"MAVSDK has not heard vehicle {vehicle_id} yet; it needs its heartbeats")
            self._actions[vehicle_id] = ActionAsync(System(self._systems[vehicle_id]))
        return self._actions[vehicle_id]

    def _on_library_thread(self, data: bytes) -> None:
        loop = self._loop
        if self._queued >= MAX_QUEUED:
            self.dropped_total += 1
            return
        self._queued += 1
        try:
            assert loop is not None
            loop.call_soon_threadsafe(self._in_loop, data)
        except RuntimeError:
            # The loop was closed while the library was still sending.
            self.dropped_total += 1

    def _in_loop(self, data: bytes) -> None:
        self._queued -= 1
        for frame in self._framer.feed(data):
            self.emitted_total += 1
            self._send(frame)
