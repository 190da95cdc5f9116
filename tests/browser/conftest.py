"""The real application, fed domain values at the seam of the picture, on a real port."""

from __future__ import annotations

import asyncio
import base64
import math
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

from groundstation.domain.command import CommandKind, CommandPhase, CommandStatus, Proposal, ProposalGone
from groundstation.domain.events import Counter, Event, Severity
from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.inputs import ConnectionInput
from groundstation.domain.mission import Area, Mission
from groundstation.domain.radio import LinkActivity
from groundstation.domain.target import (
    Contribution,
    Environment,
    LinkVerdict,
    LosSource,
    TargetExplanation,
    TargetState,
    TargetWaiting,
)
from groundstation.domain.vehicle import Autopilot, PlaceAccuracy, VehicleState
from groundstation.engine.estimator_output import regions_geodetic, search_map
from groundstation.export import search_map_archive
from groundstation.localization import SearchArea
from groundstation.localization.containment import region_rings, smooth_raster
from groundstation.localization.mesh import Mesh, MeshSettings, masses, refine
from groundstation.server.actions import ActionResult, Sources
from groundstation.server.app import create_app
from groundstation.server.hub import Hub
from groundstation.server.page_files import page_directory
from groundstation.server.picture import Picture
from groundstation.server.rows import StationStatus
from groundstation.server.serve import listen, serve
from groundstation.server.settings import ServerSettings

# A bound, not an expectation: two busy cores draw a software-rendered map.
expect.set_options(timeout=15_000)

FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
    "--disable-dev-shm-usage",
]
ORIGIN = Geodetic(-35.3625, 149.1654, 584.0)
FRAME = LocalFrame(ORIGIN)


def place(east_m: float, north_m: float, up_m: float = 0.0) -> Geodetic:
    """A place near the origin."""
    return FRAME.to_geodetic((east_m, north_m, up_m))


def ring(
    half_east_m: float, half_north_m: float, east_m: float = 0.0, north_m: float = 0.0
) -> tuple[tuple[float, float], ...]:
    """A closed rectangle round a place near the origin."""
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
    places = [place(east_m + x * half_east_m, north_m + y * half_north_m) for x, y in corners]
    return tuple((p.latitude_deg, p.longitude_deg) for p in places)


class RecordingActions:
    """Takes an operator's actions down and answers as a desk would."""

    def __init__(self) -> None:
        self.taken: list[tuple[Any, ...]] = []
        self.then: Callable[[str, int], None] = lambda _proposal, _vehicle: None

    async def confirm(self, proposal_id: str, vehicle_id: int, who: str) -> ActionResult:
        self.taken.append(("confirm", proposal_id, vehicle_id))
        self.then(proposal_id, vehicle_id)
        return ActionResult(True, f"vehicle {vehicle_id} is being sent")

    async def dismiss(self, proposal_id: str, who: str) -> ActionResult:
        self.taken.append(("dismiss", proposal_id))
        return ActionResult(True, "dismissed")

    async def hold(self, vehicle_id: int, who: str) -> ActionResult:
        self.taken.append(("hold", vehicle_id))
        return ActionResult(True, f"vehicle {vehicle_id} is being held")

    async def hold_all(self, who: str) -> ActionResult:
        self.taken.append(("hold_all",))
        return ActionResult(True, "hold sent to 4 vehicles")

    async def join(self, beacon_id: int, into_beacon_id: int, who: str) -> ActionResult:
        self.taken.append(("join", beacon_id, into_beacon_id))
        return ActionResult(True, "joined")

    async def separate(self, beacon_id: int, who: str) -> ActionResult:
        self.taken.append(("separate", beacon_id))
        return ActionResult(True, "separated")


class Station:
    """A server in a thread of its own; values go in through ``feed``."""

    def __init__(self, settings: ServerSettings | None = None) -> None:
        self.settings = settings or ServerSettings(port=0)
        self.actions = RecordingActions()
        self.epochs = 0
        self.port = 0
        # The station's clock is 7 s behind the browser's: ages must not show it.
        self.clock: Callable[[], int] = lambda: time.time_ns() - 7_000_000_000
        self.start()

    def start(self) -> None:
        self.epochs += 1
        settings = ServerSettings(port=self.port)
        listener = listen(settings)
        self.port = listener.getsockname()[1]
        started = threading.Event()

        async def main() -> None:
            self.loop = asyncio.get_running_loop()
            self.stopping = asyncio.Event()
            self.hub = Hub(Picture(f"test-{self.epochs}", settings), self.clock)
            ready = asyncio.Event()
            app = create_app(self.hub, self.actions, Sources(search_map_file=search_map_archive))
            async with asyncio.TaskGroup() as group:
                group.create_task(serve(app, listener, self.stopping, ready))
                await ready.wait()
                started.set()

        self.thread = threading.Thread(target=lambda: asyncio.run(main()), daemon=True)
        self.thread.start()
        assert started.wait(10)

    def stop(self) -> None:
        self.loop.call_soon_threadsafe(self.stopping.set)
        self.thread.join(15)
        assert not self.thread.is_alive()

    def feed(self, *outputs: Any) -> None:
        """Apply in the event loop, as the station does."""
        for output in outputs:
            self.loop.call_soon_threadsafe(self.hub.apply, output)

    def draw(self, beacon_id: int) -> None:
        """Regions of a beacon: a large one with a hole, and what lies within."""
        now = self.clock()
        regions = (
            (0.5, (ring(12, 12, 24, -38),)),
            (0.9, (ring(40, 30, 24, -38), ring(6, 6, 46, -38))),
            (0.95, (ring(52, 36, 24, -38),)),
        )
        state = target(beacon_id, now, place(24, -38), 9.0, Environment.MIXED)
        self.feed(replace(state, regions=regions))

    def believe(self, beacon_id: int, east_m: float = 0.0) -> None:
        """A whole belief: two likely places in rubble, its regions, its map, and what it rests on."""
        now = self.clock()
        area = SearchArea(np.array([24.0 + east_m, -38.0]), 90.0, 0.0, 10.0)

        def log_density(mesh: Mesh, _: Any) -> tuple[Any, float]:
            east, north = mesh.center_enu_m[:, 0] - 24.0 - east_m, mesh.center_enu_m[:, 1] + 38.0
            ring = np.exp(-0.5 * ((np.hypot(east, north) - 30.0) / 9.0) ** 2)
            likely = np.exp(-0.5 * ((east - 20.0) ** 2 + (north - 16.0) ** 2) / 80.0)
            return np.log(ring * (0.12 + likely) + 1e-6), 1.0

        found = refine(area, log_density, MeshSettings(base_cells=24))
        mass = masses(found.log_likelihood, found.mesh)
        picture = smooth_raster(found.mesh, mass)
        rings = regions_geodetic(region_rings(found.mesh, mass, picture=picture), FRAME)
        state = target(beacon_id, now, place(24 + east_m, -38), 34.0, Environment.MIXED)
        state = replace(state, regions=rings)
        self.feed(state, search_map(state, picture, FRAME))

    def explain(self, beacon_id: int, first_weight: float = 0.42) -> None:
        """Four vehicles: one that tells most, one that contradicts, one that adds nothing."""
        rows = (
            Contribution(1, first_weight, 2.6, 118, 12, 0, 6.4, 1.1, -4.2, -1.3, 1.1, 0.4, 0.91),
            Contribution(2, 0.31, 1.9, 96, 0, 3, -2.2, -0.6, None, None, None, None, 0.12),
            Contribution(3, 0.27, 0.6, 101, 4, 9, 14.8, 3.4, 11.0, 3.9, 2.0, 1.0, 0.72),
            Contribution(4, 0.003, 1.02, 12, 0, 0, 0.4, 0.1, None, None, None, None, None),
        )
        self.feed(TargetExplanation(beacon_id, self.clock(), 12, rows))

    def remember(self, beacon_id: int) -> None:
        """Ten minutes in which the radius came down."""
        for second in range(600, -1, -5):
            radius_m = 9.0 + 170.0 * math.exp(-(600 - second) / 130.0) + 3.0 * math.sin(second / 20.0)
            state = target(
                beacon_id, self.clock() - second * 10**9, place(24, -38), radius_m, Environment.NLOS
            )
            self.feed(state)

    def hear(self, beacon_id: int) -> None:
        """A new belief of a beacon, now."""
        self.feed(self.located(beacon_id))

    def located(self, beacon_id: int) -> TargetState:
        """A belief of a beacon, now."""
        return target(beacon_id, self.clock(), place(24, -38), 9.0, Environment.MIXED)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    def scene(self) -> None:
        """Four vehicles round a mound, three beacons (one waits), two proposals, a log."""
        now = self.clock()
        self.feed(
            StationStatus("0.1", "rubble, seed 3", "demo", True, ""),
            Mission(
                revision=3,
                origin=ORIGIN,
                search_area=Area(((ring(140, 110),),), "search area"),
                fence=Area(((ring(220, 180),),), "fence"),
                ground_amsl_m=584.0,
                height_reference="home",
            ),
            ConnectionInput("udpin:0.0.0.0:14550", "open", "4 vehicles"),
            Counter("cir_incomplete_total", (("vehicle", "2"),), 17),
        )
        for index in range(4):
            self.feed(vehicle(index + 1, now))
        beacons = (7_205_759_403_792_793_601, 7_205_759_403_792_793_777, 7_205_759_403_792_794_002)
        for number, beacon in enumerate(beacons):
            for vehicle_id in range(1, 5):
                if number == 2 and vehicle_id > 1:
                    continue
                los = (0.97, 0.62, 0.08, 0.31)[(vehicle_id + number) % 4]
                source = LosSource.PRIOR if vehicle_id == 4 else LosSource.CLASSIFIER
                reason = "no whole impulse response" if source is LosSource.PRIOR else ""
                self.feed(
                    LinkActivity(
                        vehicle_id, beacon, now - 400_000_000, -71.0 - 3 * vehicle_id, -101.0, 240, 31, 4
                    ),
                    LinkVerdict(
                        vehicle_id, beacon, now, los, source, reason, -72.0, 0.4, -0.5, 0 if reason else 5
                    ),
                )
        self.feed(
            target(beacons[0], now, place(24, -38), 9.0, Environment.MIXED),
            target(beacons[1], now, place(-70, 44), 21.0, Environment.NLOS),
            TargetWaiting(
                beacons[2], now - 3_000_000_000, now - 60_000_000_000, 1, "2 more vehicles must hear it"
            ),
            Proposal(
                "p-1", 3, beacons[1], place(-20, 96, 50), 50.0,
                "Crosses the blind side of the second beacon.", now, now + 180_000_000_000, 3, 12,
            ),
            Proposal(
                "p-2", 1, beacons[0], place(82, -70, 45), 45.0,
                "A line of sight is likely from there.", now, now + 120_000_000_000, 3, 9,
            ),
            CommandStatus(
                "c-1", 2, CommandKind.REPOSITION, CommandPhase.FLYING, now - 9_000_000_000, "",
                place(-90, -60, 50), "p-0", 1,
            ),
            CommandStatus(
                "c-2", 4, CommandKind.REPOSITION, CommandPhase.REFUSED, now - 30_000_000_000,
                "leaves the fence by 12 m", place(-90, 190, 50), "p-00", 0,
            ),
            Event(now - 60_000_000_000, "vehicle.heard", Severity.INFO, "vehicle 1 heard", 1),
            Event(now - 30_000_000_000, "command.refused", Severity.WARNING, "vehicle 4: out of fence", 4),
            Event(now - 8_000_000_000, "vehicle.lost", Severity.ERROR, "vehicle 4: no heartbeat for 5 s", 4),
        )  # fmt: skip


def vehicle(vehicle_id: int, now: int, **changes: Any) -> VehicleState:
    """One vehicle on its circle; the fourth is lost and low on battery."""
    angle = math.radians(90 * vehicle_id - 30)
    yaw = -angle
    values: dict[str, Any] = {
        "vehicle_id": vehicle_id,
        "time_ns": now,
        "connections": ("udpin:0.0.0.0:14550",),
        "autopilot": Autopilot.ARDUPILOT,
        "mode": "GUIDED",
        "armed": True,
        "ready": True,
        "lost": vehicle_id == 4,
        "last_heartbeat_ns": now - (8_000_000_000 if vehicle_id == 4 else 300_000_000),
        "position": place(105 * math.cos(angle), 105 * math.sin(angle), 50),
        "position_time_ns": now,
        "height_above_home_m": 50.2,
        "home": ORIGIN,
        "attitude": (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)),
        "velocity_ned_m_s": (3.0, 1.0, 0.0),
        "battery_percent": 22.0 if vehicle_id == 4 else 70.0 + vehicle_id,
        "battery_voltage_v": 15.1,
        "gps_fix_type": 3,
        "satellites": 14,
        "position_target": None,
        "sensor_heard_ns": now - 200_000_000,
        "packet_loss_percent": 2.5 if vehicle_id == 2 else 0.1,
        "place_accuracy": {2: PlaceAccuracy(0.02, 0.03, True), 3: PlaceAccuracy(6.2, 9.0, False)}.get(
            vehicle_id
        ),
        "clock_offset_known": True,
        "clock_uncertainty_ns": None if vehicle_id == 4 else vehicle_id * 3_000_000,
    }
    return VehicleState(**{**values, **changes})


def target(
    beacon_id: int, now: int, position: Geodetic, radius_m: float, environment: Environment
) -> TargetState:
    """A located beacon."""
    variance = (radius_m / 2.146) ** 2
    return TargetState(
        beacon_id, now, now - 90_000_000_000, now - 400_000_000, position,
        (variance * 1.5, variance * 0.4, 0.0, variance * 0.6, 0.0, 4.0), radius_m, environment,
        2, 4, 40, "adaptive", "home", 12, None,
    )  # fmt: skip


@pytest.fixture
def station() -> Iterator[Station]:
    """A running server with the scene fed in."""
    if page_directory() is None:
        _missing("the page is not built: cd web && npm ci && npm run build")
    running = Station()
    running.scene()
    yield running
    if running.thread.is_alive():
        running.stop()


def _missing(what: str) -> None:
    # In continuous integration a check that cannot run is a failure, not a silence.
    if os.environ.get("CI") == "true":
        pytest.fail(what)
    pytest.skip(what)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """The system's Chromium.

    Not kept for the session: while Playwright's synchronous driver is open an event loop counts
    as running in this thread, and no asynchronous test of another folder could start.
    """
    executable = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if executable is None:
        _missing("no Chromium on this machine: install your system's package 'chromium'")
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=executable, args=FLAGS)
        yield running
        running.close()


@pytest.fixture
def errors() -> list[str]:
    """Console errors and foreign requests that a test saw."""
    return []


@pytest.fixture
def open_page(browser: Browser, station: Station, errors: list[str]) -> Iterator[Callable[..., Page]]:
    """Opens the station's page and watches its console and its requests."""
    contexts = []

    def opened(width: int = 1366, height: int = 768, map_ready: bool = True) -> Page:
        context = browser.new_context(viewport={"width": width, "height": height})
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: errors.append(str(error)))

        def foreign(request: Any) -> None:
            if not request.url.startswith((station.url, "data:", "blob:")):
                errors.append(f"foreign request: {request.url}")

        page.on("request", foreign)
        page.goto(station.url)
        if map_ready:
            page.wait_for_selector('[data-testid="map"][data-ready="true"]', timeout=90_000)
        return page

    yield opened
    for context in contexts:
        context.close()


@pytest.fixture
def shots(tmp_path: Path) -> Path:
    """Where screenshots go: ``SCREENSHOT_DIR`` if set, so that a person can look at them."""
    directory = Path(os.environ.get("SCREENSHOT_DIR", tmp_path))
    directory.mkdir(parents=True, exist_ok=True)
    return directory


@pytest.fixture
def comes_true() -> Callable[[Page, Callable[[], bool]], None]:
    """Waits for what the map draws, which says nothing that one could wait for."""

    def waited(page: Page, check: Callable[[], bool]) -> None:
        for _ in range(60):
            if check():
                return
            page.wait_for_timeout(500)
        raise AssertionError("the map was not drawn so within half a minute")

    return waited


@pytest.fixture
def pixel() -> Callable[..., tuple[int, int, int]]:
    """Red, green, blue of the map so many metres east and north of its middle."""

    def look(page: Page, east_m: float, north_m: float) -> tuple[int, int, int]:
        box = page.get_by_test_id("map").bounding_box()
        assert box is not None
        scale = page.locator(".maplibregl-ctrl-scale")
        px_m = scale.evaluate("node => node.offsetWidth") / float(scale.inner_text().split()[0])
        at = {
            "x": box["x"] + box["width"] / 2 + east_m * px_m,
            "y": box["y"] + box["height"] / 2 - north_m * px_m,
        }
        image = base64.b64encode(page.screenshot(clip={**at, "width": 1, "height": 1})).decode()
        red, green, blue = page.evaluate(
            """async (image) => {
                const picture = new Image();
                picture.src = `data:image/png;base64,${image}`;
                await picture.decode();
                const pen = document.createElement('canvas').getContext('2d');
                pen.drawImage(picture, 0, 0);
                return [...pen.getImageData(0, 0, 1, 1).data.slice(0, 3)];
            }""",
            image,
        )
        return red, green, blue

    return look


@pytest.fixture
def gone() -> Callable[[str, int], ProposalGone]:
    """Makes the end of a proposal."""
    return lambda proposal_id, time_ns: ProposalGone(proposal_id, time_ns, "confirmed")
