"""Last known places from the operator's file to the map: real service, simulated swarm, real browser."""

from __future__ import annotations

import json
import math
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from groundstation.domain.geometry import Geodetic, LocalFrame

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]

# Bounds, not expectations: two busy cores draw a software-rendered map beside two solvers.
START_S = 60
BELIEF_S = 120

FRAME = LocalFrame(Geodetic(-35.3625, 149.1654, 584.0))
"""Of the scenario ``open-field``."""
HUT_M, HUT_RADIUS_M = (50.0, -70.0), 60.0
FORD_M, FORD_RADIUS_M = (-40.0, 60.0), 35.0
BEACON = "7001"
"""Of the scenario: 34 m from the hut."""


def point(east_north_m: tuple[float, float], **properties: Any) -> dict[str, Any]:
    """A last known place for the file of ``--area``."""
    place = FRAME.to_geodetic((*east_north_m, 0.0))
    return {
        "type": "Feature",
        "properties": {"role": "last-known", **properties},
        "geometry": {"type": "Point", "coordinates": [place.longitude_deg, place.latitude_deg]},
    }


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    """A service that was told of two places, and four vehicles that hear the beacons."""
    program = [sys.executable, "-m"]
    area = tmp_path / "area.json"
    subprocess.run(
        [*program, "sim_sitl.cli", "scenario", "open-field", "--area", area], check=True, cwd=tmp_path
    )
    features = [
        json.loads(area.read_text()),
        point(HUT_M, radius_m=HUT_RADIUS_M, name="hut", beacon_id=BEACON),
        point(FORD_M, radius_m=FORD_RADIUS_M),
    ]
    area.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp,
        socket.socket(socket.AF_INET, socket.SOCK_STREAM) as http,
    ):
        for probe in (udp, http):
            probe.bind(("127.0.0.1", 0))
        udp_port, http_port = udp.getsockname()[1], http.getsockname()[1]
    log = tmp_path / "station.log"
    serve = ["serve", "--link", f"udpin:127.0.0.1:{udp_port}", "--http", f"127.0.0.1:{http_port}"]
    swarm = ["swarm", "--link", f"udpout:127.0.0.1:{udp_port}", "--vehicles", "4", "--scenario", "open-field"]
    with log.open("wb") as output:
        running = [
            subprocess.Popen([*program, *arguments], stdout=output, stderr=subprocess.STDOUT, cwd=tmp_path)
            for arguments in (
                ["groundstation.cli", *serve, "--area", str(area), "--data-dir", "sessions"],
                ["sim_sitl.cli", *swarm, "--seed", "5", "--quiet"],
            )
        ]
    try:
        deadline = time.monotonic() + START_S
        while True:
            try:
                socket.create_connection(("127.0.0.1", http_port), 1).close()
                break
            except OSError:
                assert running[0].poll() is None, log.read_text()
                assert time.monotonic() < deadline, f"no page within {START_S} s:\n{log.read_text()}"
                time.sleep(0.2)
        yield f"http://127.0.0.1:{http_port}/"
    finally:
        for process in reversed(running):
            process.send_signal(signal.SIGINT)
        for process in running:
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait(10)


def tip_at(page: Page, x: float, y: float) -> str:
    """What the map says of the thing under the pointer; empty when nothing is there."""
    page.mouse.move(x, y)
    page.wait_for_timeout(60)
    tip: str = page.evaluate("document.querySelector('.map-tip')?.innerText ?? ''")
    return tip


def ring_radii_m(page: Page, east_north_m: tuple[float, float], says: str) -> list[float]:
    """How far from a place, given relative to the middle of the map, its circle is found."""
    box = page.get_by_test_id("map").bounding_box()
    assert box is not None
    scale = page.locator(".maplibregl-ctrl-scale")
    px_m = scale.evaluate("node => node.offsetWidth") / float(scale.inner_text().split()[0])
    x = box["x"] + box["width"] / 2 + east_north_m[0] * px_m
    y = box["y"] + box["height"] / 2 - east_north_m[1] * px_m
    found_m = []
    for turn in range(16):
        angle = math.pi * turn / 8
        for reach_m in range(40, 82, 2):
            at = (x + reach_m * px_m * math.cos(angle), y - reach_m * px_m * math.sin(angle))
            if says in tip_at(page, *at):
                found_m.append(float(reach_m))
                break
    return found_m


def test_a_place_in_the_area_s_file_is_drawn_told_and_explained(
    url: str, browser: Browser, shots: Path, errors: list[str]
) -> None:
    context = browser.new_context(viewport={"width": 1366, "height": 768}, reduced_motion="reduce")
    page = context.new_page()
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(url)
    page.wait_for_selector('[data-testid="map"][data-ready="true"]', timeout=90_000)
    expect(page.get_by_test_id("legend-last-known")).to_be_visible()
    card = page.get_by_test_id(f"beacon-{BEACON}")
    expect(card).to_have_attribute("data-state", "located", timeout=BELIEF_S * 1000)

    # The beacon's details say what was known before, in metres: the hut of it, the ford of any of them.
    page.get_by_test_id(f"why-button-{BEACON}").click()
    told = page.get_by_test_id(f"last-known-{BEACON}").get_by_role("listitem")
    expect(told).to_have_count(2)
    expect(told.first).to_contain_text("Last known: hut, within 60 m · the estimate is ")
    expect(told.last).to_contain_text("Last known: within 35 m (any beacon) · ")
    page.get_by_test_id("why-button-7002").click()
    expect(page.get_by_test_id("last-known-7002").get_by_role("listitem")).to_have_count(1)

    # The map: the estimate is brought into its middle, and the circle lies where the file put it.
    card.get_by_role("button").first.click()
    row = page.request.get(f"{url}api/v1/targets/{BEACON}").json()["position"]
    estimate = FRAME.to_enu(Geodetic(row["latitude_deg"], row["longitude_deg"], 584.0))
    away = (HUT_M[0] - estimate[0], HUT_M[1] - estimate[1])
    page.wait_for_timeout(1000)
    radii_m = ring_radii_m(page, away, "hut\nwithin 60 m")
    # Links and vehicles lie above the circle, and its label, farther out, says the same: they may have
    # many of the sixteen directions, as the swarm flies.
    near = sum(abs(radius_m - HUT_RADIUS_M) <= 10.0 for radius_m in radii_m)
    assert near >= 4, radii_m
    assert near > len(radii_m) - near, radii_m
    page.get_by_test_id("search-map").click()
    for theme in ("light", "dark"):
        page.mouse.move(5, 5)
        page.wait_for_timeout(3000)
        page.screenshot(path=shots / f"last-known-{theme}.png")
        page.get_by_test_id("theme").click()
    assert errors == []
    context.close()
