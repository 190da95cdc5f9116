"""Sessions: begun, stopped, killed, taken up again where they were."""

from __future__ import annotations

import contextlib
import os
import signal
import sqlite3
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

from groundstation.domain.errors import InputError, ResourceError
from groundstation.domain.events import Event, Severity
from groundstation.domain.inputs import Direction, FrameInput, SessionInput, TickInput
from groundstation.store.clock import StationClock
from groundstation.store.session import Session, find_resumable, open_new, open_to_read, resume

WALL_NS = 1_795_311_900 * 10**9
"""2026-11-22T01:45:00Z."""


def clock_at(wall_ns: int, not_before_ns: int = 0) -> StationClock:
    return StationClock(not_before_ns, lambda: wall_ns, time.monotonic_ns)


def begin(data_dir: Path, wall_ns: int = WALL_NS) -> Session:
    session, record = open_new(data_dir, "0.1", config={"a": 1}, clock=clock_at(wall_ns))
    assert record.seq == 0
    assert record.input == SessionInput("began", "0.1")
    return session


def test_a_clean_run(tmp_path: Path) -> None:
    session = begin(tmp_path)
    assert session.directory == tmp_path / "2026-11-22T014500Z"
    for direction in (Direction.IN, Direction.OUT):
        session.record(FrameInput("udp", direction, b"\xfd123"))
    session.record(TickInput())
    session.database.store(Event(1, "a", Severity.INFO, "t"))
    assert session.health() == {}
    assert session.events() == []
    ended = session.close("0.1")
    assert ended is not None
    assert ended.seq == 4
    assert session.close("0.1") is None
    meta, reader = open_to_read(session.directory)
    assert meta.ended_unix_us == ended.unix_us
    records = list(reader)
    assert [type(record.input).__name__ for record in records] == [
        "SessionInput",
        "FrameInput",
        "FrameInput",
        "TickInput",
        "SessionInput",
    ]
    times = [record.time_ns for record in records]
    assert times == sorted(times)
    assert (session.directory / "frames.tlog").stat().st_size == 24
    counters = {counter.name: counter.value for counter in session.counters()}
    assert counters["journal_records_total"] == 5
    assert counters["recording_frames_total"] == 2
    assert find_resumable(tmp_path) is None


def test_two_sessions_in_one_second_get_two_directories(tmp_path: Path) -> None:
    first, second = begin(tmp_path), begin(tmp_path)
    assert second.directory.name == first.directory.name + "-2"
    first.abandon()
    second.abandon()


def test_goes_on_where_it_was(tmp_path: Path) -> None:
    session = begin(tmp_path)
    for _ in range(5):
        session.record(TickInput())
    third = session.record(TickInput())
    session.save_snapshot(third.seq, third.time_ns, {"beliefs": np.arange(3.0), "count": 6})
    tail = [session.record(FrameInput("udp", Direction.IN, bytes([n]))) for n in range(4)]
    session.abandon()

    assert find_resumable(tmp_path) == session.directory
    again = resume(session.directory, "0.2", clock=clock_at(WALL_NS, tail[-1].time_ns))
    assert again.snapshot is not None
    assert (again.snapshot.seq, again.snapshot.state["count"]) == (third.seq, 6)
    assert list(again.tail) == tail
    assert again.resumed.seq == tail[-1].seq + 1
    assert again.resumed.input == SessionInput("resumed", "0.2")
    assert again.resumed.time_ns >= tail[-1].time_ns
    assert find_resumable(tmp_path) is None  # it is open
    again.session.record(TickInput())
    again.session.close("0.2")

    meta, reader = open_to_read(session.directory)
    assert [record.seq for record in reader] == list(range(14))
    assert reader.damage() == ""
    assert [run["version"] for run in meta.runs] == ["0.1", "0.2"]
    assert (session.directory / "frames.tlog").exists()


def test_without_a_snapshot_the_tail_is_everything(tmp_path: Path) -> None:
    session = begin(tmp_path)
    session.record(TickInput())
    session.abandon()
    again = resume(session.directory, "0.1")
    assert again.snapshot is None
    assert [record.seq for record in again.tail] == [0, 1]
    again.session.abandon()


def test_a_damaged_snapshot_is_passed_over_and_said(tmp_path: Path) -> None:
    session = begin(tmp_path)
    for _ in range(2):
        record = session.record(TickInput())
        path = session.save_snapshot(record.seq, record.time_ns, {"seq": record.seq})
    session.abandon()
    path.write_bytes(path.read_bytes()[:-2])
    again = resume(session.directory, "0.1", clock=clock_at(WALL_NS + 10**9, 0))
    assert again.snapshot is not None
    assert again.snapshot.seq == 1
    assert [record.seq for record in again.tail] == [2]
    assert [event.code for event in again.events] == ["snapshot.damaged"]
    again.session.abandon()


def test_a_clock_that_was_set_back_is_said(tmp_path: Path) -> None:
    session = begin(tmp_path)
    last = session.record(TickInput())
    session.abandon()
    again = resume(session.directory, "0.1", clock=clock_at(WALL_NS - 60 * 10**9, last.time_ns))
    assert again.resumed.time_ns >= last.time_ns
    assert again.resumed.unix_us < last.unix_us
    assert [event.code for event in again.events] == ["clock.behind"]
    again.session.abandon()


def test_two_stations_cannot_share_a_session(tmp_path: Path) -> None:
    session = begin(tmp_path)
    with pytest.raises(ResourceError, match="in use by another station"):
        resume(session.directory, "0.1")
    session.abandon()
    with pytest.raises(InputError, match="not a session"):
        resume(tmp_path, "0.1")


def test_which_session_is_taken_up(tmp_path: Path) -> None:
    assert find_resumable(tmp_path / "missing") is None
    old = begin(tmp_path)
    old.abandon()
    new = begin(tmp_path, WALL_NS + 10**9)
    new.abandon()
    (tmp_path / "z-something-else").mkdir()
    assert find_resumable(tmp_path) == new.directory
    now_us = time.time_ns() // 1000
    assert find_resumable(tmp_path, max_age_h=1.0, unix_us=now_us) == new.directory
    assert find_resumable(tmp_path, max_age_h=1.0, unix_us=now_us + int(2 * 3.6e9)) is None
    again = resume(new.directory, "0.1")
    assert find_resumable(tmp_path) == old.directory
    again.session.close("0.1")
    assert find_resumable(tmp_path) is None


def test_an_ended_session_can_be_taken_up_by_name(tmp_path: Path) -> None:
    session = begin(tmp_path)
    session.close("0.1")
    again = resume(session.directory, "0.1")
    assert find_resumable(tmp_path) is None
    again.session.abandon()
    assert find_resumable(tmp_path) == session.directory


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(ResourceError, match="cannot make a session"):
        open_new(file / "data", "0.1")


STATION = textwrap.dedent(
    """
    import sys, time
    from pathlib import Path
    from groundstation.domain.inputs import Direction, FrameInput
    from groundstation.store.session import open_new
    session, _ = open_new(Path(sys.argv[1]), "0.1")
    for n in range(10**6):
        record = session.record(FrameInput("udp", Direction.IN, n.to_bytes(4, "big") * 10))
        if n % 200 == 199:
            session.save_snapshot(record.seq, record.time_ns, {"count": n + 1})
        if n == 1000:
            print(session.directory, flush=True)
        time.sleep(0.0002)
    """
)


def test_killed_and_taken_up_again(tmp_path: Path) -> None:
    command = [sys.executable, "-c", STATION, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        directory = Path(process.stdout.readline().strip())
        time.sleep(0.1)
        with pytest.raises(ResourceError, match=f"process {process.pid}"):
            resume(directory, "0.1")
        os.kill(process.pid, signal.SIGKILL)
    assert find_resumable(tmp_path) == directory
    again = resume(directory, "0.1")
    assert again.snapshot is not None
    tail = list(again.tail)
    # Nothing between snapshot and tail is missing: count what both hold together.
    assert again.snapshot.state["count"] == again.snapshot.seq
    assert [record.seq for record in tail] == list(range(again.snapshot.seq + 1, again.resumed.seq))
    assert again.resumed.seq > 1000
    again.session.close("0.1")
    _, reader = open_to_read(directory)
    assert sum(1 for _ in reader) == again.resumed.seq + 2
    assert reader.missing_count == 0


@pytest.mark.parametrize(
    ("lost", "kept"), [("nothing but a snapshot's tail", [17]), ("the journal", [17, 18])]
)
def test_where_no_record_tells_the_journals_end_the_snapshot_does_or_nothing_is_forgotten(
    tmp_path: Path, target_state, lost: str, kept: list[int]
) -> None:
    session = begin(tmp_path)
    last = [session.record(TickInput()) for _ in range(3)][-1]
    session.database.store(target_state(7, 17, last.time_ns))
    session.database.store(target_state(7, 18, last.time_ns + 1))
    if lost != "the journal":
        session.save_snapshot(last.seq, last.time_ns, {"beliefs": 1})
    session.abandon()
    if lost == "the journal":
        for path in (session.directory / "journal").iterdir():
            path.unlink()
    resume(session.directory, "0.1", clock=clock_at(WALL_NS, last.time_ns)).session.abandon()
    with contextlib.closing(sqlite3.connect(session.directory / "session.sqlite")) as database:
        rows = database.execute("SELECT sequence FROM targets ORDER BY id").fetchall()
    assert [sequence for (sequence,) in rows] == kept


def test_estimates_beyond_the_journals_end_are_forgotten(tmp_path: Path, target_state) -> None:
    """A run that was killed told them to the database before its journal held what they came from."""
    session = begin(tmp_path)
    last = [session.record(TickInput()) for _ in range(3)][-1]
    session.database.store(target_state(7, 17, last.time_ns))
    session.database.store(target_state(7, 18, last.time_ns + 1))
    session.abandon()
    again = resume(session.directory, "0.1", clock=clock_at(WALL_NS, last.time_ns))
    again.session.database.store(target_state(7, 18, last.time_ns + 5))
    again.session.abandon()
    with contextlib.closing(sqlite3.connect(session.directory / "session.sqlite")) as database:
        kept = database.execute("SELECT sequence, time_ns FROM targets ORDER BY id").fetchall()
    assert kept == [(17, last.time_ns), (18, last.time_ns + 5)]
