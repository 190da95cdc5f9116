"""One way out for every output: page, database, log; and what stands beside the journal at the end."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from groundstation.command.outputs import SendFrame
from groundstation.display import Display
from groundstation.domain.events import Event, Severity
from groundstation.domain.geometry import Geodetic
from groundstation.domain.inputs import MissionInput, Record, TickInput
from groundstation.domain.mission import Mission
from groundstation.domain.radio import LinkActivity, Listening
from groundstation.domain.target import Environment, TargetJoined, TargetState, TargetWaiting
from groundstation.mission_files import disc_area
from groundstation.pipeline import Step
from groundstation.server.hub import Hub
from groundstation.server.picture import Picture

PLACE = Geodetic(-35.3625, 149.1654, 584.0)
WAITING = TargetWaiting(7, 10, 5, 2, "more links")
EVENT = Event(4, "vehicle.lost", Severity.ERROR, "vehicle 3 is lost")
LOCATED = TargetState(
    beacon_id=7, time_ns=20, first_heard_ns=5, last_heard_ns=19, position=PLACE,
    covariance_enu_m2=(9.0, 0.0, 0.0, 4.0, 0.0, 1.0), radius_90_m=8.0, environment=Environment.LOS,
    los_links=4, links=4, windows=30, method="posterior", height_reference="home", sequence=1, snapshot=None,
)  # fmt: skip


@pytest.fixture
def stored() -> list[Any]:
    return []


@pytest.fixture
def display(tmp_path: Path, stored: list[Any]) -> Display:
    session = SimpleNamespace(directory=tmp_path, database=SimpleNamespace(store=stored.append))
    return Display(Hub(Picture("epoch", None), lambda: 50), session, "live", "")


def step(*ingest: Any) -> Step:
    return Step(ingest, (), (), ())


def test_what_is_for_the_engines_or_a_radio_alone_is_not_shown(display: Display, stored: list[Any]) -> None:
    activity = LinkActivity(1, 7, 30, -70.0, -100.0, 12, 3, 1)
    display.step(Record(0, 30, 0, TickInput()), step(Listening(10, 30, ()), SendFrame(b"", 1), activity))
    assert stored == [activity]
    assert [row.rss_dbm for row in display.hub.picture.link_rows()] == [-70.0]


def test_a_beacon_is_located_or_waits_or_is_another_one(display: Display, stored: list[Any]) -> None:
    display.estimate(WAITING)
    assert (display.targets, display.waiting) == ({}, {7: WAITING})
    display.estimate(LOCATED)
    assert (display.targets, display.waiting) == ({7: LOCATED}, {})
    joined = TargetJoined(7, 30, 5, 29, 8)
    display.estimate(joined)
    assert (display.targets, display.waiting) == ({}, {})
    assert stored == [WAITING, LOCATED, joined]
    assert [row.joined_into for row in display.hub.picture.target_rows()] == ["8"]


def test_events_of_before_a_stop_are_kept_and_shown_but_not_logged_again(
    display: Display, stored: list[Any], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO):
        display.taking_up = True
        display.estimate(EVENT)
        assert caplog.messages == []
        display.taking_up = False
        display.step(Record(0, 30, 0, TickInput()), step(EVENT))
    assert caplog.messages == [EVENT.text]
    assert stored == [EVENT, EVENT]
    assert [row.text for row in display.hub.picture.events] == [EVENT.text, EVENT.text]


def test_without_a_fence_the_page_says_why_nothing_can_be_commanded(display: Display, tmp_path: Path) -> None:
    def shown(mission: Mission) -> Any:
        display.step(Record(0, 30, 0, MissionInput(mission, "test")), step())
        return display.hub.picture.snapshot(0).rows

    rows = shown(Mission(revision=1))
    assert (rows.station.title, rows.station.commands_enabled) == (tmp_path.name, False)
    assert "--fence" in rows.station.commands_reason
    rows = shown(Mission(revision=2, fence=disc_area(PLACE, 100.0)))
    assert (rows.mission.revision, rows.station.commands_enabled, rows.station.commands_reason) == (
        2,
        True,
        "",
    )


def test_the_last_beliefs_are_left_beside_the_journal(display: Display, tmp_path: Path) -> None:
    for beacon_id in (9, 7):
        display.estimate(replace(LOCATED, beacon_id=beacon_id))
    display.leave_targets()
    text = (tmp_path / "targets.geojson").read_text()
    assert json.loads(text)["type"] == "FeatureCollection"
    assert 0 < text.index('"7"') < text.index('"9"')


def test_a_full_disk_at_the_end_is_a_line_in_the_log(
    display: Display, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "targets.geojson").mkdir()
    with caplog.at_level(logging.WARNING):
        display.leave_targets()
    assert "targets.geojson" in caplog.text
