"""Values, an app and a real server for the tests of the server room."""

from __future__ import annotations

import asyncio
import contextlib
import math
import struct
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from groundstation.domain.command import Proposal
from groundstation.domain.events import Event, Severity
from groundstation.domain.geometry import Geodetic
from groundstation.domain.mission import Ring
from groundstation.domain.radio import LinkActivity
from groundstation.domain.target import (
    Contribution,
    Environment,
    SearchMap,
    TargetExplanation,
    TargetState,
)
from groundstation.domain.vehicle import Autopilot, VehicleState
from groundstation.server.actions import ActionResult, Sources
from groundstation.server.app import create_app
from groundstation.server.hub import Hub
from groundstation.server.picture import Picture
from groundstation.server.serve import listen, serve
from groundstation.server.settings import ServerSettings

PLACE = Geodetic(-35.3625, 149.1654, 634.0)


class Make:
    """Builders of domain values."""

    place = PLACE

    @staticmethod
    def vehicle(vehicle_id: int = 1, **changes: Any) -> VehicleState:
        values: dict[str, Any] = {
            "vehicle_id": vehicle_id,
            "time_ns": 1_000,
            "connections": ("udpin:0.0.0.0:14550",),
            "autopilot": Autopilot.ARDUPILOT,
            "mode": "GUIDED",
            "armed": True,
            "ready": True,
            "lost": False,
            "last_heartbeat_ns": 900,
            "position": PLACE,
            "position_time_ns": 950,
            "height_above_home_m": 50.0,
            "home": PLACE,
            "attitude": (1.0, 0.0, 0.0, 0.0),
            "velocity_ned_m_s": (3.0, 4.0, -1.0),
            "battery_percent": 80.0,
            "battery_voltage_v": 15.0,
            "gps_fix_type": 3,
            "satellites": 12,
            "position_target": None,
            "sensor_heard_ns": None,
            "packet_loss_percent": 0.0,
            "clock_offset_known": True,
        }
        return VehicleState(**{**values, **changes})

    @staticmethod
    def target(beacon_id: int = 7, **changes: Any) -> TargetState:
        values: dict[str, Any] = {
            "beacon_id": beacon_id,
            "time_ns": 2_000,
            "first_heard_ns": 1_000,
            "last_heard_ns": 1_900,
            "position": PLACE,
            "covariance_enu_m2": (9.0, 0.0, 0.0, 4.0, 0.0, 1.0),
            "radius_90_m": 8.0,
            "environment": Environment.MIXED,
            "los_links": 2,
            "links": 4,
            "windows": 30,
            "method": "adaptive",
            "height_reference": "home",
            "sequence": 3,
            "snapshot": None,
        }
        return TargetState(**{**values, **changes})

    @staticmethod
    def regions(corners: int = 4, north_deg: float = 0.0) -> tuple[tuple[float, tuple[Ring, ...]], ...]:
        """Three nested rings of so many corners round PLACE."""
        shares = []
        for share in (0.5, 0.9, 0.95):
            turns = [2.0 * math.pi * (corner % corners) / corners for corner in range(corners + 1)]
            ring = tuple(
                (
                    PLACE.latitude_deg + north_deg + share * 3e-4 * math.sin(turn),
                    PLACE.longitude_deg + share * 3e-4 * math.cos(turn),
                )
                for turn in turns
            )
            shares.append((share, (ring,)))
        return tuple(shares)

    @staticmethod
    def search_map(beacon_id: int = 7, **changes: Any) -> SearchMap:
        values: dict[str, Any] = {
            "beacon_id": beacon_id,
            "time_ns": 2_000,
            "sequence": 3,
            "origin": PLACE,
            "west_m": -10.0,
            "north_m": 4.0,
            "cell_m": 2.5,
            "rows": 1,
            "columns": 2,
            "corners": ((1.0, 2.0), (1.0, 3.0), (0.5, 3.0), (0.5, 2.0)),
            "share": struct.pack("<2f", 0.25, 0.75),
            "containment": struct.pack("<2H", 10_000, 7_500),
        }
        return SearchMap(**{**values, **changes})

    @staticmethod
    def explanation(beacon_id: int = 7, weight: float = 0.4) -> TargetExplanation:
        own = Contribution(1, weight, 2.5, 30, 2, 1, 6.1, 1.2, None, None, None, None, None)
        return TargetExplanation(beacon_id, 2_000, 3, (own,))

    @staticmethod
    def activity(vehicle_id: int = 1, beacon_id: int = 7, time_ns: int = 1_500) -> LinkActivity:
        return LinkActivity(vehicle_id, beacon_id, time_ns, -70.0, -100.0, 12, 3, 1)

    @staticmethod
    def proposal(proposal_id: str = "p-1", vehicle_id: int = 3) -> Proposal:
        return Proposal(proposal_id, vehicle_id, 7, PLACE, 50.0, "why", 1_000, 9_000, 1, 3)

    @staticmethod
    def event(text: str = "something", time_ns: int = 3_000) -> Event:
        return Event(time_ns, "test.event", Severity.INFO, text)


class RecordingActions:
    """Takes down what it is asked, answers what it is told to."""

    def __init__(self) -> None:
        self.taken: list[tuple[Any, ...]] = []
        self.result = ActionResult(True, "done", ("c-1",))

    async def confirm(self, proposal_id: str, vehicle_id: int, who: str) -> ActionResult:
        self.taken.append(("confirm", proposal_id, vehicle_id, who))
        return self.result

    async def dismiss(self, proposal_id: str, who: str) -> ActionResult:
        self.taken.append(("dismiss", proposal_id, who))
        return self.result

    async def hold(self, vehicle_id: int, who: str) -> ActionResult:
        self.taken.append(("hold", vehicle_id, who))
        return self.result

    async def hold_all(self, who: str) -> ActionResult:
        self.taken.append(("hold_all", who))
        return self.result

    async def join(self, beacon_id: int, into_beacon_id: int, who: str) -> ActionResult:
        self.taken.append(("join", beacon_id, into_beacon_id, who))
        return self.result

    async def separate(self, beacon_id: int, who: str) -> ActionResult:
        self.taken.append(("separate", beacon_id, who))
        return self.result


@pytest.fixture
def make() -> type[Make]:
    """Builders of domain values."""
    return Make


@pytest.fixture
def settings() -> ServerSettings:
    """A free port, and little patience with clients that do not read."""
    return ServerSettings(
        port=0, publish_interval_s=0.01, heartbeat_interval_s=0.2, send_timeout_s=1.5, graceful_stop_s=1.0
    )


@pytest.fixture
def hub(settings: ServerSettings) -> Hub:
    """A hub whose clock stands still."""
    return Hub(Picture("epoch-1", settings), lambda: 5_000)


@pytest.fixture
def actions() -> RecordingActions:
    """What the operator did."""
    return RecordingActions()


@pytest.fixture
def app(hub: Hub, actions: RecordingActions) -> FastAPI:
    """The application without a page."""
    return create_app(hub, actions, Sources(version="1.2"), page_directory=None)


@pytest.fixture
async def client(app: FastAPI) -> AsyncIterator[httpx.AsyncClient]:
    """HTTP straight into the application."""
    transport = httpx.ASGITransport(app, client=("127.0.0.1", 5), raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost:8000") as running:
        yield running


@dataclass
class Live:
    """A server that listens on a real port."""

    port: int
    hub: Hub
    stop: asyncio.Event
    done: asyncio.Task[None]

    @property
    def stream(self) -> str:
        return f"ws://127.0.0.1:{self.port}/api/v1/stream"

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"


@pytest.fixture
def serve_live() -> Callable[..., contextlib.AbstractAsyncContextManager[Live]]:
    """Serves an app until the block ends."""

    @contextlib.asynccontextmanager
    async def serving(app: FastAPI) -> AsyncIterator[Live]:
        hub: Hub = app.state.hub
        listener = listen(hub.settings)
        port = listener.getsockname()[1]
        stop, started = asyncio.Event(), asyncio.Event()
        done = asyncio.create_task(serve(app, listener, stop, started))
        await asyncio.wait_for(started.wait(), 5)
        try:
            yield Live(port, hub, stop, done)
        finally:
            stop.set()
            await asyncio.wait_for(done, 10)

    return serving
