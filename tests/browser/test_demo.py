"""The whole thing: ``groundstation demo`` as a user starts it, and an operator at its page."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Error, Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(400)]

# Bounds, not expectations: two busy cores draw a software-rendered map beside two solvers.
START_S = 60
BELIEF_S = 120
STEP_S = 45
END_S = 40


@dataclass
class Demo:
    """A running demo."""

    process: subprocess.Popen[bytes]
    url: str
    log: Path

    def output(self) -> str:
        """What it has printed so far, both streams."""
        return self.log.read_text(errors="replace")

    def end(self) -> int:
        """Ctrl-C as a terminal sends it, to the whole group; its exit code."""
        os.killpg(self.process.pid, signal.SIGINT)
        return self.process.wait(END_S)


@pytest.fixture
def demo(tmp_path: Path) -> Iterator[Demo]:
    """``groundstation demo --scenario rubble --seed 1`` on a free port, answering."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    log = tmp_path / "demo.log"
    command = [sys.executable, "-m", "groundstation.cli", "demo", "--scenario", "rubble", "--seed", "1"]
    with log.open("wb") as output:
        process = subprocess.Popen(
            [*command, "--http", f"127.0.0.1:{port}"],
            stdout=output,
            stderr=subprocess.STDOUT,
            cwd=tmp_path,
            start_new_session=True,
        )
    running = Demo(process, f"http://127.0.0.1:{port}/", log)
    try:
        deadline = time.monotonic() + START_S
        while f"map page: {running.url}" not in running.output():
            assert process.poll() is None, f"the demo ended by itself:\n{running.output()}"
            assert time.monotonic() < deadline, f"no map page within {START_S} s:\n{running.output()}"
            time.sleep(0.2)
        yield running
    finally:
        if process.poll() is None:
            # A group of its own: the simulated swarm and the estimator go with it.
            os.killpg(process.pid, signal.SIGKILL)
            process.wait(END_S)


@pytest.fixture
def page(browser: Browser, demo: Demo, errors: list[str]) -> Iterator[Page]:
    """The demo's page, with its console and its requests watched."""
    context = browser.new_context(viewport={"width": 1366, "height": 768})
    opened = context.new_page()

    def said(message: Any) -> None:
        # A proposal that was replaced, or whose vehicle's pose is too old now, is refused: the browser
        # calls that an error, the operator reads it in a notice.
        refused = "/api/v1/proposals/" in message.location["url"] and re.search("40[49]", message.text)
        if message.type == "error" and not refused:
            errors.append(message.text)

    opened.on("console", said)
    opened.on("pageerror", lambda error: errors.append(str(error)))

    def foreign(request: Any) -> None:
        if not request.url.startswith((demo.url, "data:", "blob:")):
            errors.append(f"foreign request: {request.url}")

    opened.on("request", foreign)
    opened.set_default_timeout(STEP_S * 1000)
    opened.goto(demo.url)
    opened.wait_for_selector('[data-testid="map"][data-ready="true"]')
    yield opened
    context.close()


def send_one(page: Page) -> str:
    """Confirm and send the first proposal that lets itself be sent; returns its vehicle.

    Between the two clicks a proposal may be replaced: its card goes, and the next one is taken,
    as an operator would.
    """
    deadline = time.monotonic() + STEP_S
    while time.monotonic() < deadline:
        confirm = page.locator('[data-testid^="proposal-confirm-"]:enabled').first
        try:
            proposal_id = (confirm.get_attribute("data-testid", timeout=3000) or "").removeprefix(
                "proposal-confirm-"
            )
            card = page.get_by_test_id(f"proposal-{proposal_id}")
            heading = card.get_by_role("button").first.inner_text(timeout=3000)
        except Error:  # replaced while it was read
            continue
        vehicle = re.match(r"Vehicle (\d+) → \d+ m [NESW]{1,2}", heading)
        assert vehicle, heading
        try:
            page.get_by_test_id(f"proposal-confirm-{proposal_id}").click(timeout=3000)
            send = page.get_by_test_id(f"proposal-send-{proposal_id}")
            expect(send).to_contain_text(f"Send vehicle {vehicle[1]}: ", timeout=3000)
            send.click(timeout=3000)
        except (Error, AssertionError):  # the card was replaced under the pointer
            continue
        notice = page.get_by_test_id("notice").last
        expect(notice).to_be_visible()
        if "NOT DONE" not in notice.inner_text():
            return vehicle[1]
    pytest.fail(f"no proposal could be sent within {STEP_S} s")


def test_an_operator_finds_sends_and_holds(demo: Demo, page: Page, errors: list[str], shots: Path) -> None:
    expect(page.get_by_test_id("connection-state")).to_have_text("live")
    expect(page.get_by_test_id("source")).to_have_text("SIMULATION")
    vehicles = page.locator('[data-testid^="vehicle-"]')
    expect(vehicles).to_have_count(5, timeout=BELIEF_S * 1000)

    # Beacons are found, with how sure, and the regions reach the page.
    located = page.locator('[data-testid^="beacon-"][data-state="located"]').first
    expect(located).to_contain_text(re.compile(r"90 % within \d+ m"), timeout=BELIEF_S * 1000)
    beacon_id = (located.get_attribute("data-testid") or "").removeprefix("beacon-")
    regions = page.request.get(f"{demo.url}api/v1/targets/{beacon_id}/regions").json()
    assert [region["share"] for region in regions["regions"]] == [0.5, 0.9, 0.95]
    assert all(region["polygons_deg"] for region in regions["regions"])

    # Links are classified, and drawn with their probability.
    page.get_by_test_id("tab-links").click()
    expect(page.locator('[data-testid^="link-"]').filter(has_text="classifier").first).to_contain_text(
        re.compile(r"\d+ % classifier"), timeout=BELIEF_S * 1000
    )
    page.get_by_test_id("tab-vehicles").click()

    # A proposal comes, is confirmed by two clicks, and the vehicle flies.
    confirm = page.locator('[data-testid^="proposal-confirm-"]:enabled').first
    expect(confirm).to_be_visible(timeout=BELIEF_S * 1000)
    page.screenshot(path=shots / "demo.png")
    vehicle = send_one(page)
    command = page.get_by_test_id(f"command-vehicle-{vehicle}")
    expect(command).to_have_attribute("data-phase", re.compile("^(flying|arrived)$"), timeout=STEP_S * 1000)

    # One click holds all.
    page.get_by_test_id("hold-all").click()
    for row in range(5):
        expect(vehicles.nth(row)).to_contain_text(re.compile("BRAKE|LOITER"), timeout=STEP_S * 1000)
    for vehicle_id in range(1, 6):
        expect(page.get_by_test_id(f"command-vehicle-{vehicle_id}")).to_have_attribute(
            "data-phase", "holding", timeout=STEP_S * 1000
        )
    page.screenshot(path=shots / "demo-held.png")
    assert errors == []

    assert demo.end() == 0, demo.output()
    assert "Traceback" not in demo.output()
    expect(page.get_by_test_id("banner")).to_contain_text("Connection lost")
