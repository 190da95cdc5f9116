"""Keeps one connection open: tries, waits longer after each failure, reports each change.

A connection that cannot be opened never raises and never stops another one.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from enum import StrEnum

from groundstation.connections.settings import ConnectionSettings
from groundstation.connections.transport import Transport
from groundstation.domain.errors import GroundstationError


class LinkState(StrEnum):
    """Where a connection stands; the words of ConnectionInput."""

    OPEN = "open"
    CLOSED = "closed"
    """Lost, or closed by us: the detail says."""
    WAITING = "waiting"
    """For the next try."""
    FAILED = "failed"
    """A fault of ours: it is not tried again."""


class Supervisor:
    """Runs one connection until cancelled."""

    def __init__(
        self,
        open_transport: Callable[[], Awaitable[Transport]],
        on_state: Callable[[LinkState, str], None],
        settings: ConnectionSettings,
    ) -> None:
        self._open_transport = open_transport
        self._on_state = on_state
        self._settings = settings
        self._tried = asyncio.Event()
        self.transport: Transport | None = None
        """While open."""
        self.opened = 0
        """How often it came open."""
        self.failures = 0
        """Tries that failed."""

    async def tried(self) -> None:
        """Returns when the first try has ended, well or not."""
        await self._tried.wait()

    async def run(self) -> None:
        """Opens, and opens again after each loss. Ends only by cancellation or our own fault."""
        settings = self._settings
        delay_s = settings.backoff_initial_s
        try:
            while True:
                reason, lasted_s = await self._once()
                if reason is None:
                    return
                if lasted_s >= settings.stable_after_s:
                    delay_s = settings.backoff_initial_s
                self._on_state(LinkState.WAITING, f"{reason}; next try in {delay_s:g} s")
                await asyncio.sleep(delay_s)
                delay_s = min(delay_s * settings.backoff_factor, settings.backoff_max_s)
        finally:
            self._tried.set()

    async def _once(self) -> tuple[str | None, float]:
        """One try: why it ended (None: it must not be tried again) and how long it was open, seconds."""
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(self._settings.connect_timeout_s):
                transport = await self._open_transport()
        except GroundstationError as error:
            self.failures += 1
            return str(error), 0.0
        except TimeoutError:
            self.failures += 1
            return f"no answer within {self._settings.connect_timeout_s:g} s", 0.0
        except Exception as error:
            self.failures += 1
            loop.call_exception_handler(
                {"message": "opening a connection failed in a way nobody expected", "exception": error}
            )
            self._on_state(LinkState.FAILED, f"internal fault: {type(error).__name__}: {error}")
            return None, 0.0
        finally:
            self._tried.set()
        self.transport = transport
        self.opened += 1
        opened_s = loop.time()
        reason = "closed by the station"
        try:
            self._on_state(LinkState.OPEN, "")
            reason = await transport.wait_closed()
        finally:
            self.transport = None
            await transport.close()
            self._on_state(LinkState.CLOSED, reason)
        return reason, loop.time() - opened_s
