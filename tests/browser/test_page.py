"""The page in a real browser against the real application: what an operator sees and does."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from groundstation.domain.command import CommandKind, CommandPhase, CommandStatus
from groundstation.domain.events import Event, Severity
from groundstation.server.rows import ForwardStatus, StationStatus

pytestmark = [pytest.mark.browser, pytest.mark.timeout(240)]

BEACON = "7205759403792793601"
WAITING = "7205759403792794002"


def test_everything_is_shown_and_nothing_is_fetched_from_elsewhere(
    open_page: Callable[..., Page], station: Any, errors: list[str], shots: Path,
    comes_true: Callable[..., None],
) -> None:  # fmt: skip
    page = open_page()
    expect(page.get_by_test_id("connection-state")).to_have_text("live")
    expect(page.get_by_test_id("source")).to_have_text("SIMULATION")
    for vehicle_id in range(1, 5):
        expect(page.get_by_test_id(f"vehicle-{vehicle_id}")).to_be_visible()
    expect(page.get_by_test_id("vehicle-4")).to_contain_text("LOST")
    expect(page.get_by_test_id("vehicle-3")).to_contain_text("place only to ± 6 m")
    expect(page.get_by_test_id("vehicle-2")).not_to_contain_text("place only")
    beacon = page.get_by_test_id(f"beacon-{BEACON}")
    expect(beacon.get_by_test_id("coordinates")).to_have_text(re.compile(r"^-35\.3\d{5}, 149\.16\d{4}$"))
    expect(beacon).to_contain_text("90 % within 9 m")

    # The station's clock is seven seconds behind this browser's: the age is the station's.
    def heard_now() -> bool:
        station.hear(int(BEACON))
        return beacon.get_by_test_id("heard").inner_text() == "heard now"

    comes_true(page, heard_now)
    expect(page.get_by_test_id(f"beacon-{WAITING}")).to_contain_text("2 more vehicles must hear it")
    expect(page.get_by_test_id("no-base-map")).to_contain_text(re.compile(r"No base map · grid \d+ m"))
    page.get_by_test_id("tab-links").click()
    expect(page.get_by_test_id(f"link-1:{BEACON}")).to_contain_text("62 %")
    expect(page.get_by_test_id(f"link-4:{BEACON}")).to_contain_text("unclassified: no whole impulse response")
    expect(page.get_by_test_id("alarms")).to_have_text("1")
    page.get_by_test_id("tab-events").click()
    expect(page.get_by_test_id("events")).to_contain_text("vehicle 4: no heartbeat for 5 s")
    expect(page.get_by_test_id("alarms")).to_have_count(0)
    page.get_by_test_id("tab-status").click()
    expect(page.get_by_test_id("status")).to_contain_text("cir_incomplete_total")
    expect(page.get_by_test_id("status-vehicle-2")).to_contain_text("± 6 ms")
    expect(page.get_by_test_id("status-vehicle-2")).to_contain_text("± 0.02 m")
    expect(page.get_by_test_id("status-vehicle-3")).to_contain_text("± 6.2 m")
    expect(page.get_by_test_id("status-vehicle-4")).not_to_contain_text("±")
    expect(page.get_by_title("How far this autopilot's times may be off").first).to_have_text("Clock")
    page.screenshot(path=shots / "page.png")
    assert errors == []


def test_the_map_is_drawn_in_its_colours(
    open_page: Callable[..., Page], errors: list[str], comes_true: Callable[..., None]
) -> None:
    page = open_page()

    def colours() -> dict[str, int]:
        image = base64.b64encode(page.get_by_test_id("map").screenshot()).decode()
        seen: dict[str, int] = page.evaluate(
            """async (image) => {
                const picture = new Image();
                picture.src = `data:image/png;base64,${image}`;
                await picture.decode();
                const canvas = document.createElement('canvas');
                [canvas.width, canvas.height] = [picture.width, picture.height];
                const pen = canvas.getContext('2d');
                pen.drawImage(picture, 0, 0);
                const data = pen.getImageData(0, 0, canvas.width, canvas.height).data;
                const seen = {};
                for (let i = 0; i < data.length; i += 4) {
                    const hex = (k) => data[i + k].toString(16).padStart(2, '0');
                    const key = '#' + [0, 1, 2].map(hex).join('');
                    seen[key] = (seen[key] || 0) + 1;
                }
                return seen;
            }""",
            image,
        )
        return seen

    drawn = {"fence": "#b00020", "beacon": "#a1005f", "vehicle": "#14324f", "proposal": "#00695c"}

    def all_there() -> bool:
        seen = colours()
        # P(LOS) 0.97: nearly the blue end of the scale, mixed by the map itself.
        bluish = any(int(colour[5:7], 16) > 140 and int(colour[1:3], 16) < 40 for colour in seen)
        return bluish and all(seen.get(colour, 0) > 20 for colour in drawn.values())

    comes_true(page, all_there)
    assert errors == []


def test_regions_are_drawn_darker_inwards_with_their_holes(
    open_page: Callable[..., Page], station: Any, errors: list[str], shots: Path,
    pixel: Callable[..., tuple[int, int, int]], comes_true: Callable[..., None],
) -> None:  # fmt: skip
    page = open_page()
    # A click on a beacon brings it into the middle of the map.
    page.emulate_media(reduced_motion="reduce")
    page.get_by_test_id(f"beacon-{BEACON}").get_by_role("button").first.click()
    station.draw(int(BEACON))

    def redness(east_m: float, north_m: float) -> int:
        red, green, _ = pixel(page, east_m, north_m)
        return red - green

    def nested() -> bool:
        places = ((-9, 9), (-33, 24), (-46, 33), (22, 3), (-58, 42))
        inner, middle, outer, hole, outside = (redness(*at) for at in places)
        return inner > middle + 15 > outer + 25 > outside + 30 and hole < middle - 10

    comes_true(page, nested)
    page.screenshot(path=shots / "regions.png")
    assert errors == []


def test_a_tip_lets_the_pointer_through_and_goes_with_what_it_tells(
    open_page: Callable[..., Page], station: Any, errors: list[str], comes_true: Callable[..., None]
) -> None:
    page = open_page()
    # A click on a beacon brings it into the middle of the map.
    page.emulate_media(reduced_motion="reduce")
    page.get_by_test_id(f"beacon-{BEACON}").get_by_role("button").first.click()
    box = page.get_by_test_id("map").bounding_box()
    assert box is not None
    tip = page.locator(".map-tip", has_text=f"Beacon {BEACON}")

    def told() -> bool:
        page.mouse.move(0, 0)
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        return tip.count() == 1

    comes_true(page, told)
    # Caught by the tip the pointer would leave the map, which would go on to tell what was.
    assert (
        tip.evaluate(
            """(tip) => {
            const box = tip.getBoundingClientRect();
            return document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2).tagName;
        }"""
        )
        == "CANVAS"
    )
    # The beacon is elsewhere now; the pointer rests.
    state = station.located(int(BEACON))
    place = state.position
    station.feed(replace(state, position=replace(place, latitude_deg=place.latitude_deg + 5e-4)))
    expect(tip).to_have_count(0)
    assert errors == []


def test_the_planner_says_why_there_is_no_proposal(open_page: Callable[..., Page], station: Any) -> None:
    page = open_page(map_ready=False)
    expect(page.get_by_test_id("plan-notes")).to_have_count(0)
    for silent_s in (30, 35, 40):
        text = f"beacon {WAITING}: not heard for {silent_s} s, no vehicle is sent"
        station.feed(Event(station.clock(), "plan.note", Severity.INFO, text))
    station.feed(
        Event(station.clock(), "plan.note", Severity.INFO, "vehicle 4 gets no proposal: it is lost", 4)
    )
    notes = page.get_by_test_id("plan-notes").get_by_role("listitem")
    expect(notes).to_have_count(2)
    expect(notes.first).to_contain_text(re.compile(r"^Vehicle 4 gets no proposal: it is lost \d+ s ago$"))
    expect(notes.last).to_contain_text("Beacon …794002: not heard for 40 s")
    page.get_by_test_id("tab-events").click()
    expect(page.get_by_test_id("events")).to_contain_text("not heard for 40 s, no vehicle is sent (3 times)")


def test_a_replay_says_so_and_acts_on_nobody(open_page: Callable[..., Page], station: Any) -> None:
    page = open_page(map_ready=False)
    expect(page.get_by_test_id("hold-all")).to_be_enabled()
    station.feed(
        StationStatus("0.1", "replay: a.tlog", "replay", False, "this is a replay: it sends nothing")
    )
    expect(page.get_by_test_id("source")).to_have_text("REPLAY")
    expect(page.get_by_test_id("commands-disabled")).to_contain_text("nothing is sent to any vehicle")
    for name in ("hold-all", "hold-1", "proposal-confirm-p-1", "proposal-dismiss-p-1"):
        expect(page.get_by_test_id(name)).to_be_disabled()


def test_a_confirmation_takes_two_clicks_and_names_the_vehicle(
    open_page: Callable[..., Page], station: Any, gone: Callable[..., Any], errors: list[str], shots: Path
) -> None:
    page = open_page()

    def status(phase: CommandPhase, detail: str = "") -> CommandStatus:
        return CommandStatus("c-9", 3, CommandKind.REPOSITION, phase, station.clock(), detail, None, "p-1", 1)

    station.actions.then = lambda proposal_id, _vehicle_id: station.feed(
        gone(proposal_id, station.clock()), status(CommandPhase.SENT)
    )
    page.get_by_test_id("proposal-confirm-p-1").click()
    assert station.actions.taken == []
    send = page.get_by_test_id("proposal-send-p-1")
    expect(send).to_have_text(re.compile(r"Send vehicle 3: \d+ m N, at 50 m above home"))
    page.screenshot(path=shots / "armed.png")
    send.click()
    expect(page.get_by_test_id("notice")).to_contain_text("vehicle 3 is being sent")
    assert station.actions.taken == [("confirm", "p-1", 3)]
    expect(page.get_by_test_id("proposal-p-1")).to_have_count(0)
    command = page.get_by_test_id("command-vehicle-3")
    expect(command).to_have_attribute("data-phase", "sent")
    for phase in (CommandPhase.ACCEPTED, CommandPhase.FLYING, CommandPhase.ARRIVED):
        station.feed(status(phase))
        expect(command).to_have_attribute("data-phase", phase.value)
    station.feed(status(CommandPhase.REFUSED, "the vehicle is not in GUIDED"))
    expect(command).to_contain_text("refused: the vehicle is not in GUIDED")
    assert errors == []


def test_an_armed_button_can_be_taken_back_and_a_proposal_dismissed(
    open_page: Callable[..., Page], station: Any
) -> None:
    page = open_page(map_ready=False)
    page.get_by_test_id("proposal-confirm-p-2").click()
    page.get_by_test_id("proposal-cancel-p-2").click()
    expect(page.get_by_test_id("proposal-confirm-p-2")).to_be_visible()
    page.get_by_test_id("proposal-dismiss-p-2").click()
    expect(page.get_by_test_id("notice")).to_contain_text("dismissed")
    assert station.actions.taken == [("dismiss", "p-2")]


def test_holds_by_mouse_and_by_keyboard(open_page: Callable[..., Page], station: Any) -> None:
    page = open_page(map_ready=False)
    page.get_by_test_id("hold-2").click()
    expect(page.get_by_test_id("notice")).to_contain_text("vehicle 2 is being held")
    page.get_by_test_id("hold-all").focus()
    page.keyboard.press("Enter")
    expect(page.get_by_test_id("notice").nth(1)).to_contain_text("hold sent to 4 vehicles")
    assert station.actions.taken == [("hold", 2), ("hold_all",)]


def test_a_lost_station_is_said_and_a_restarted_one_is_found(
    open_page: Callable[..., Page], station: Any, shots: Path
) -> None:
    page = open_page()
    expect(page.get_by_test_id("connection-state")).to_have_text("live")
    station.stop()
    expect(page.get_by_test_id("banner")).to_contain_text(
        re.compile(r"Connection lost – what you see is \d+ s old")
    )
    expect(page.get_by_test_id("proposal-confirm-p-1")).to_be_disabled()
    page.screenshot(path=shots / "lost.png")
    page.get_by_test_id("hold-all").click()
    expect(page.get_by_test_id("notice")).to_contain_text("NOT DONE: the station did not answer")
    station.start()
    station.feed(Event(station.clock(), "session.resumed", Severity.INFO, "session resumed"))
    expect(page.get_by_test_id("connection-state")).to_have_text("live", timeout=15_000)
    expect(page.get_by_test_id("banner")).to_have_count(0)
    # A new run of the server knows nothing of the old one's vehicles, and so does the page.
    expect(page.get_by_test_id("vehicle-1")).to_have_count(0)
    page.get_by_test_id("tab-events").click()
    expect(page.get_by_test_id("events")).to_contain_text("session resumed")


def test_another_ground_station_that_may_command_is_shown(
    open_page: Callable[..., Page], station: Any
) -> None:
    page = open_page(map_ready=False)
    expect(page.get_by_test_id("forward-commanding")).to_have_count(0)
    station.feed(
        ForwardStatus("udpout:10.0.0.2:14550", True, True),
        StationStatus("0.1", "field", "live", False, "no fence"),
    )
    expect(page.get_by_test_id("forward-commanding")).to_be_visible()
    expect(page.get_by_test_id("commands-disabled")).to_contain_text("no fence")
    expect(page.get_by_test_id("proposal-confirm-p-1")).to_be_disabled()


@pytest.mark.parametrize(("width", "height"), [(1366, 768), (1920, 1080), (1024, 768)])
def test_nothing_overlaps_or_is_cut_off(
    open_page: Callable[..., Page], width: int, height: int, shots: Path
) -> None:
    page = open_page(width, height)
    page.wait_for_timeout(600)
    page.screenshot(path=shots / f"page-{width}.png")
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    assert page.evaluate("document.documentElement.scrollHeight <= window.innerHeight")
    boxes = [
        page.get_by_test_id(name).bounding_box()
        for name in ("centre", "legend", "no-base-map", "hold-all", "proposals", "beacons")
    ]
    for index, first in enumerate(boxes):
        assert first is not None
        assert first["x"] >= 0
        assert first["x"] + first["width"] <= width
        assert first["y"] + first["height"] <= height
        for second in boxes[index + 1 :]:
            assert second is not None
            apart = (
                first["x"] + first["width"] <= second["x"]
                or second["x"] + second["width"] <= first["x"]
                or first["y"] + first["height"] <= second["y"]
                or second["y"] + second["height"] <= first["y"]
            )
            assert apart, (first, second)
    targets = page.locator("aside .buttons button, .hold-all, td.act button").all()
    assert targets
    assert all((box := button.bounding_box()) is None or box["height"] >= 44 for button in targets)


def test_the_dark_theme_is_kept(open_page: Callable[..., Page], shots: Path) -> None:
    page = open_page()
    page.get_by_test_id("theme").click()
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    page.reload()
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    page.wait_for_selector('[data-testid="map"][data-ready="true"]')
    page.wait_for_timeout(900)
    page.screenshot(path=shots / "dark.png")
