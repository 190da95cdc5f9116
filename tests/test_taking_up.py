"""A session that goes on: what is handled again, what is not, and what nobody is told twice."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import pytest

from groundstation.command.desk import CommandDesk
from groundstation.display import Display
from groundstation.domain.events import Event, Severity
from groundstation.domain.geometry import Geodetic
from groundstation.domain.inputs import DropInput, MissionInput, Record, TickInput
from groundstation.domain.mission import Mission
from groundstation.domain.radio import CloseReason, LinkWindow
from groundstation.engine.ingest import Ingest
from groundstation.pipeline import Pipeline, Step, Work
from groundstation.server.hub import Hub
from groundstation.server.picture import Picture
from groundstation.store.session import open_new, resume
from groundstation.taking_up import take_up


class Lane:
    """Takes down what the estimator would be given."""

    def __init__(self) -> None:
        self.state: Any = "not started"
        self.submitted: list[Work] = []

    def start(self, state: dict[str, Any] | None) -> None:
        self.state = state

    def submit(self, work: tuple[Work, ...]) -> None:
        self.submitted += work

    def drain(self, _timeout_s: float) -> bool:
        return True


class Hearing(Pipeline):
    """One that finds a window and has something to say in every tick."""

    def __init__(self, *rooms: Any) -> None:
        super().__init__(*rooms)
        self.handled: list[int] = []

    def handle(self, record: Record) -> Step:
        self.handled.append(record.seq)
        step = super().handle(record)
        if not isinstance(record.input, TickInput):
            return step
        window = LinkWindow(
            vehicle_id=1, beacon_id=7, start_ns=record.seq - 1, end_ns=record.seq,
            position=Geodetic(47.0, 8.0, 500.0), attitude=(1.0, 0.0, 0.0, 0.0), path_length_m=4.0,
            rss_dbm=-80.0, rss_std_error_db=1.0, rss_count=16, noise_dbm=-110.0, frequency_hz=868_000_000,
            missed_count=0, azimuth_rad=None, azimuth_std_error_rad=None, elevation_rad=None,
            elevation_std_error_rad=None, aoa_count=0, captures=(), sensor_los_probability=None,
            close_reason=CloseReason.FULL,
        )  # fmt: skip
        told = Event(record.time_ns, "test.tick", Severity.INFO, f"tick {record.seq}")
        return Step((told,), (), (Work(record.seq, record.time_ns, window),), ())


async def test_the_journal_s_tail_is_handled_again_and_shown_but_is_no_news(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    session, _ = open_new(tmp_path, "0.1")
    pipeline = Hearing(Ingest(), CommandDesk())
    for record in [session.record(MissionInput(Mission(revision=3), "ann")), session.record(TickInput())]:
        pipeline.handle(record)
    session.save_snapshot(2, record.time_ns, {"pipeline": pipeline.state(), "estimator": {"beliefs": 5}})
    kept = session.record(TickInput())
    lost = session.record(TickInput())
    session.record(DropInput("estimator", ((1, 7, lost.seq),)))
    session.abandon()

    resumed = resume(session.directory, "0.2")
    pipeline, lane = Hearing(Ingest(), CommandDesk()), Lane()
    display = Display(Hub(Picture("epoch", None), lambda: 0), resumed.session, "live", "")
    with caplog.at_level(logging.INFO):
        await take_up(resumed, pipeline, lane, display)
    resumed.session.abandon()

    assert lane.state == {"beliefs": 5}
    assert [work.seq for work in lane.submitted] == [kept.seq]
    assert pipeline.mission == Mission(revision=3)
    rows = display.hub.picture.snapshot(0)
    assert rows.rows.mission is not None
    assert rows.rows.mission.revision == 3
    assert [row.text for row in rows.events] == [f"tick {kept.seq}", f"tick {lost.seq}"]
    assert caplog.messages == []
    assert not display.taking_up


async def test_without_a_snapshot_all_begins_with_the_journal(tmp_path: Path) -> None:
    session, began = open_new(tmp_path, "0.1")
    ticks = [session.record(TickInput()) for _ in range(3)]
    session.abandon()
    resumed = resume(session.directory, "0.2")
    pipeline, lane = Hearing(Ingest(), CommandDesk()), Lane()
    await take_up(resumed, pipeline, lane, Display(Hub(Picture("epoch", None)), resumed.session, "live", ""))
    resumed.session.abandon()
    assert lane.state is None
    assert [work.seq for work in lane.submitted] == [began.seq, *(tick.seq for tick in ticks)]


async def test_what_the_journal_got_since_the_restart_is_left_to_the_caller(tmp_path: Path) -> None:
    """``resumed`` stands in the journal that is read, and who started the station handles it: once."""
    session, began = open_new(tmp_path, "0.1")
    tick = session.record(TickInput())
    session.abandon()
    resumed = resume(session.directory, "0.2")
    resumed.session.record(TickInput())
    resumed.session.journal.sync()
    pipeline = Hearing(Ingest(), CommandDesk())
    display = Display(Hub(Picture("epoch", None)), resumed.session, "live", "")
    await take_up(resumed, pipeline, Lane(), display)
    resumed.session.abandon()
    assert pipeline.handled == [began.seq, tick.seq]
