"""What stands behind an estimate, in a real browser: search map, reasons, history, joined ids."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from groundstation.domain.target import TargetJoined

pytestmark = [pytest.mark.browser, pytest.mark.timeout(240)]

BEACON = "7205759403792793601"
OTHER = "7205759403792793777"
FRESH = "7205759403792799904"


LIKELY, RING, OUTSIDE = (20, 24), (-30, 0), (-75, 0)
"""Metres east and north of the believed beacon, clear of links and labels: where it likely is, might be, is
not."""


def explained(station: Any) -> None:
    """A beacon with a past, a belief, a map and reasons."""
    station.remember(int(FRESH))
    station.believe(int(FRESH))
    station.explain(int(FRESH))


def open_why(page: Page) -> None:
    page.get_by_test_id(f"beacon-{FRESH}").get_by_role("button").first.click()
    page.get_by_test_id(f"why-button-{FRESH}").click()
    expect(page.get_by_test_id(f"curve-{FRESH}")).to_be_visible()


@pytest.mark.parametrize(("name", "width", "height"), [("wide", 1280, 800), ("phone", 390, 844)])
def test_it_can_be_read_in_both_themes(
    open_page: Callable[..., Page], station: Any, errors: list[str], shots: Path,
    name: str, width: int, height: int,
) -> None:  # fmt: skip
    explained(station)
    page = open_page(width, height)
    page.get_by_test_id("search-map").click()
    open_why(page)
    if width < 1000:
        page.get_by_test_id("legend").locator("summary").click()
    expect(page.get_by_test_id("search-map-age")).to_have_text(re.compile(r" s old$"))
    for theme in ("light", "dark"):
        page.wait_for_timeout(4000)
        page.screenshot(path=shots / f"outputs-{name}-{theme}.png")
        page.get_by_test_id(f"reasons-{FRESH}").scroll_into_view_if_needed()
        page.screenshot(path=shots / f"outputs-{name}-{theme}-why.png")
        # Whatever the screen: the one button that matters is on it, and nothing sticks out sideways.
        hold = page.get_by_test_id("hold-all").bounding_box()
        assert hold is not None
        assert hold["x"] >= 0
        assert hold["x"] + hold["width"] <= width
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        page.get_by_test_id("theme").click()
    assert errors == []


def test_the_search_map_is_drawn_where_it_belongs_and_hidden_again(
    open_page: Callable[..., Page],
    station: Any,
    errors: list[str],
    pixel: Callable[..., tuple[int, int, int]],
    comes_true: Callable[..., None],
) -> None:
    station.believe(int(FRESH))
    page = open_page()
    page.emulate_media(reduced_motion="reduce")
    page.get_by_test_id(f"beacon-{FRESH}").get_by_role("button").first.click()
    page.get_by_test_id("search-map").click()
    expect(page.get_by_test_id("search-map-age")).to_have_text(re.compile(r" s old$"))

    # A click on a beacon brings it into the middle: the likeliest places are north-east of it.
    def ranked() -> bool:
        likely, ring, outside = (sum(pixel(page, *at)) for at in (LIKELY, RING, OUTSIDE))
        return likely < ring - 100 and ring < outside - 80

    comes_true(page, ranked)
    # A new belief, moved west: the map follows without anybody's doing.
    station.believe(int(FRESH), east_m=-48.0)
    there = (LIKELY[0] - 48, LIKELY[1])
    comes_true(page, lambda: sum(pixel(page, *there)) < 330)
    page.get_by_test_id("search-map").click()
    expect(page.get_by_test_id("search-map")).to_have_attribute("aria-pressed", "false")
    comes_true(page, lambda: sum(pixel(page, *there)) > 400)
    assert errors == []


def test_the_search_map_is_remembered_and_survives_a_lost_station(
    open_page: Callable[..., Page], station: Any, shots: Path,
    pixel: Callable[..., tuple[int, int, int]], comes_true: Callable[..., None],
) -> None:  # fmt: skip
    station.believe(int(FRESH))
    page = open_page()
    page.get_by_test_id("search-map").click()
    page.reload()
    page.wait_for_selector('[data-testid="map"][data-ready="true"]', timeout=90_000)
    expect(page.get_by_test_id("search-map")).to_have_attribute("aria-pressed", "true")
    page.emulate_media(reduced_motion="reduce")
    page.get_by_test_id(f"beacon-{FRESH}").get_by_role("button").first.click()
    expect(page.get_by_test_id("search-map-age")).to_have_text(re.compile(r" s old$"))
    comes_true(page, lambda: sum(pixel(page, *LIKELY)) < 330)
    station.stop()
    expect(page.get_by_test_id("banner")).to_contain_text("Connection lost")
    before = page.get_by_test_id("search-map-age").inner_text()
    expect(page.get_by_test_id("search-map-age")).not_to_have_text(before)
    # Greyed like all that is old, but there: dark where it was likely.
    comes_true(page, lambda: sum(pixel(page, *LIKELY)) < sum(pixel(page, *OUTSIDE)) - 150)
    page.screenshot(path=shots / "outputs-lost.png")


def test_reasons_say_who_brought_what_and_who_does_not_fit(
    open_page: Callable[..., Page], station: Any, errors: list[str]
) -> None:
    explained(station)
    page = open_page(map_ready=False)
    open_why(page)
    reasons = page.get_by_test_id(f"reasons-{FRESH}").get_by_role("listitem")
    expect(reasons).to_have_count(4)
    first = reasons.first
    expect(first).to_contain_text("Vehicle 1")
    expect(first).to_contain_text("42 %")
    expect(first).to_contain_text("hears it 6 dB stronger than the estimate explains")
    expect(first).to_contain_text("118 windows, 12 more from the same places")
    wrong = page.get_by_test_id(f"reason-{FRESH}-3")
    expect(wrong).to_contain_text("contradicts the others: without it the area would be 0.6 × as large")
    expect(wrong.locator(".odd").nth(1)).to_contain_text(
        "15 dB stronger than the estimate explains – does not fit"
    )
    expect(wrong).to_contain_text(
        "its bearing points 11° to the right of and 2.0° above the estimate – does not fit"
    )
    expect(page.get_by_test_id(f"reason-{FRESH}-4")).to_contain_text("adds little to what the others say")
    expect(page.get_by_test_id(f"curve-{FRESH}")).to_contain_text(
        re.compile(r"17\d m → 34 m in 10 min 0\d s")
    )
    # The stream brings new reasons without a reload.
    station.explain(int(FRESH), first_weight=0.9)
    expect(first).to_contain_text("90 %")
    assert errors == []


def test_the_map_can_be_taken_along_for_a_gis(open_page: Callable[..., Page], station: Any) -> None:
    explained(station)
    page = open_page(map_ready=False)
    open_why(page)
    with page.expect_download() as waiting:
        page.get_by_test_id(f"download-{FRESH}").click()
    download = waiting.value
    assert download.suggested_filename.startswith(f"search-map-{FRESH}-")
    with zipfile.ZipFile(io.BytesIO(Path(download.path()).read_bytes())) as archive:
        assert f"beacon-{FRESH}-probability.asc" in archive.namelist()


def test_two_ids_are_joined_in_two_clicks_and_separated_again(
    open_page: Callable[..., Page],
    station: Any,
    errors: list[str],
    shots: Path,
) -> None:
    page = open_page(map_ready=False)
    page.get_by_test_id(f"why-button-{OTHER}").click()
    expect(page.get_by_test_id(f"join-{OTHER}")).to_have_count(0)
    page.get_by_test_id(f"join-into-{OTHER}").select_option(BEACON)
    page.get_by_test_id(f"join-{OTHER}").click()
    assert station.actions.taken == []
    confirm = page.get_by_test_id(f"join-confirm-{OTHER}")
    expect(confirm).to_have_text("Join …793777 into …793601")
    page.screenshot(path=shots / "join.png")
    confirm.click()
    expect(page.get_by_test_id("notice")).to_contain_text("joined")
    assert station.actions.taken == [("join", int(OTHER), int(BEACON))]
    now = station.clock()
    station.feed(
        TargetJoined(int(OTHER), now, now - 60_000_000_000, now - 40_000_000_000, int(BEACON)),
        replace(station.located(int(BEACON)), joined_beacon_ids=(int(OTHER),)),
    )
    card = page.get_by_test_id(f"beacon-{OTHER}")
    expect(card).to_contain_text("joined into …793601")
    # Both are aged: what was heard of this id, and of the one that counts for it.
    expect(card.get_by_test_id("heard")).to_contain_text(re.compile(r"heard \d+ s ago|heard now"))
    expect(page.get_by_test_id(f"beacon-{BEACON}").get_by_test_id("joined-ids")).to_have_text(
        re.compile("^with …793777")
    )
    page.screenshot(path=shots / "joined.png")
    page.get_by_test_id(f"separate-{OTHER}").click()
    expect(page.get_by_test_id("notice").last).to_contain_text("separated")
    assert station.actions.taken[-1] == ("separate", int(OTHER))
    assert errors == []


def test_a_person_who_may_walk_is_told(open_page: Callable[..., Page], station: Any) -> None:
    page = open_page(map_ready=False)
    beacon = page.get_by_test_id(f"beacon-{BEACON}")
    station.feed(replace(station.located(int(BEACON)), walking_probability=0.62))
    expect(beacon.get_by_test_id("walking")).to_have_text(re.compile(r"^may be walking \(62 %\)"))
    station.feed(replace(station.located(int(BEACON)), walking_probability=0.05))
    expect(beacon.get_by_test_id("walking")).to_have_count(0)


def test_a_beacon_that_nobody_hears_ages_in_sight(open_page: Callable[..., Page], station: Any) -> None:
    page = open_page(map_ready=False)
    now = station.clock()
    station.feed(
        replace(station.located(int(FRESH)), time_ns=now - 40_000_000_000, last_heard_ns=now - 40_000_000_000)
    )
    beacon = page.get_by_test_id(f"beacon-{FRESH}")
    expect(beacon.get_by_test_id("heard")).to_have_text(re.compile(r"^heard (4\d|5\d) s ago$"))
    expect(beacon).to_contain_text(re.compile(r"position \d+ s old"))
