"""The hub's own task: it ends when it is told to, whatever happens at that moment."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from groundstation.server.hub import Hub
from groundstation.server.picture import Picture
from groundstation.server.settings import ServerSettings


@pytest.mark.parametrize("steps", range(6))
async def test_a_stop_that_comes_with_a_change_is_not_lost(make: Any, steps: int) -> None:
    # A demo that was ended while a vehicle's state came in went on for ever.
    hub = Hub(Picture("e", ServerSettings(heartbeat_interval_s=0.2)), lambda: 5)
    running = asyncio.create_task(hub.run())
    for _ in range(3):
        await asyncio.sleep(0)
    hub.apply(make.vehicle())
    for _ in range(steps):
        await asyncio.sleep(0)
    running.cancel()
    _done, pending = await asyncio.wait([running], timeout=1.0)
    running.cancel()
    assert not pending
    assert running.cancelled()
