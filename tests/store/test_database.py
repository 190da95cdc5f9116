"""The database: what goes in can be asked for; a disk or queue that is full costs rows, counted."""

from __future__ import annotations

import resource
import sqlite3
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from groundstation.domain.command import CommandKind, CommandPhase, CommandStatus
from groundstation.domain.errors import InputError, ResourceError
from groundstation.domain.events import Event, Severity
from groundstation.domain.geometry import Geodetic
from groundstation.domain.inputs import Decision, OperatorInput, Record, TickInput
from groundstation.domain.target import LinkVerdict, LosSource, TargetState
from groundstation.store.database import Database

MINUTE_NS = 60_000_000_000
BEACON = 2**64 - 1


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    database = Database(tmp_path / "session.sqlite")
    yield database
    database.close()


def verdict(time_ns: int, probability: float) -> LinkVerdict:
    return LinkVerdict(3, BEACON, time_ns, probability, LosSource.CLASSIFIER, "", -71.5, 0.1, 0.2, 4)


def rows(database: Database, sql: str) -> list[sqlite3.Row]:
    """As any other program reads the file."""
    connection = sqlite3.connect(f"{database._path.absolute().as_uri()}?mode=ro", uri=True)
    connection.row_factory = sqlite3.Row
    try:
        return connection.execute(sql).fetchall()
    finally:
        connection.close()


def count(database: Database, table: str) -> int:
    return int(rows(database, f"SELECT count(*) FROM {table}")[0][0])


def test_events_before_a_time_oldest_first(database: Database) -> None:
    events = [Event(i, "vehicle.lost", Severity.WARNING, f"lost {i}", 4, BEACON) for i in range(10)]
    for event in events:
        database.store(event)
    database.flush()
    assert database.reader.events_before(10, 3) == events[7:]
    assert database.reader.events_before(7) == events[:7]


def test_a_belief_is_one_row(database: Database, target_state: Callable[..., TargetState]) -> None:
    state = target_state(BEACON, 2, 2000)
    database.store(state)
    database.flush()
    (row,) = rows(database, "SELECT * FROM targets")
    assert (int(row["beacon_id"]), row["sequence"], row["time_ns"]) == (BEACON, 2, 2000)
    names = [f"covariance_{axes}_m2" for axes in ("ee", "en", "eu", "nn", "nu", "uu")]
    assert tuple(row[name] for name in names) == state.covariance_enu_m2
    assert (row["latitude_deg"], row["radius_90_m"]) == (state.position.latitude_deg, state.radius_90_m)
    assert (row["environment"], row["los_links"], row["links"]) == ("MIXED", 2, 4)


def test_everything_may_come_twice(database: Database, target_state: Callable[..., TargetState]) -> None:
    place = Geodetic(1.0, 2.0, 3.0)
    outputs: list[object] = [
        Event(1, "a", Severity.INFO, "text"),
        target_state(),
        CommandStatus("c1", 2, CommandKind.HOLD, CommandPhase.SENT, 9, "", None, None, 1),
        CommandStatus("c1", 2, CommandKind.REPOSITION, CommandPhase.FLYING, 10, "", place, "p1", 1),
        verdict(MINUTE_NS + 1, 0.25),
        verdict(MINUTE_NS + 2, 0.75),
        object(),
    ]
    actions = [Record(4, 5, 6, OperatorInput("ann", Decision.CONFIRM, "p1", 2)), Record(5, 5, 6, TickInput())]
    for _ in range(2):
        for output in outputs:
            database.store(output)
        for record in actions:
            database.store_record(record)
    database.flush()
    assert (count(database, "events"), count(database, "targets")) == (1, 1)
    commands = rows(database, "SELECT * FROM commands ORDER BY id DESC")
    assert [row["phase"] for row in commands] == ["flying", "sent"]
    assert commands[0]["latitude_deg"] == 1.0
    operators = rows(database, "SELECT * FROM operator_actions")
    assert [(row["seq"], row["who"], row["decision"]) for row in operators] == [(4, "ann", "confirm")]
    (minute,) = rows(database, "SELECT * FROM link_minutes")
    assert (minute["vehicle_id"], int(minute["beacon_id"]), minute["minute_ns"]) == (3, BEACON, MINUTE_NS)
    assert (minute["windows"], minute["captures"], minute["los_probability_sum"]) == (2, 8, 1.0)
    assert (minute["los_probability_last"], minute["los_probability_min"]) == (0.75, 0.25)
    assert minute["los_probability_max"] == 0.75


def test_numbers_that_are_not_finite_become_null(
    database: Database, target_state: Callable[..., TargetState]
) -> None:
    state = target_state()
    object.__setattr__(state, "radius_90_m", float("inf"))
    database.store(state)
    database.flush()
    assert [point.radius_90_m for point in database.reader.target_curve(BEACON)] == [None]


def test_one_bad_row_does_not_cost_its_neighbours(
    database: Database, target_state: Callable[..., TargetState]
) -> None:
    nowhere = target_state(7)
    object.__setattr__(nowhere, "position", Geodetic(float("nan"), 1.0, 2.0))
    database.store(Event(1, "good", Severity.INFO, "before"))
    database.store(Event(2**70, "bad", Severity.INFO, "a time that SQLite cannot hold"))
    database.store(Event(2, "bad", Severity.INFO, "lone \ud800"))
    database.store(nowhere)
    database.store(verdict(3, float("nan")))
    database.store(Event(3, "good", Severity.INFO, "behind"))
    database.flush()
    assert [event.text for event in database.reader.events_before(2**62)] == ["before", "behind"]
    assert database.reader.target_curve(7) == []
    counters = {counter.labels: counter.value for counter in database.counters()}
    assert counters[(("reason", "bad_row"),)] == 4
    assert database.failure is None


def test_answers_are_bounded(database: Database) -> None:
    for i in range(3):
        database.store(Event(i, "a", Severity.INFO, "t"))
    database.flush()
    assert len(database.reader.events_before(10, limit=10**12)) == 3
    assert database.reader.events_before(10, limit=-5) == []


def test_a_full_queue_drops_the_bulk_first_and_counts(
    tmp_path: Path, target_state: Callable[..., TargetState], monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = threading.Event()
    write = Database._write

    def held(self: Database, batch: list[tuple[str, tuple[object, ...]]]) -> None:
        gate.wait(10)
        write(self, batch)

    monkeypatch.setattr(Database, "_write", held)
    database = Database(tmp_path / "x.sqlite", queue_size=10)
    database.store(Event(0, "first", Severity.INFO, "t"))
    while not database._queue.empty():
        gate.wait(0.01)
    gate.wait(0.5)  # the writer has its batch and is held
    for n in range(12):
        database.store(target_state(1, n, n + 1))
    assert database.dropped_full == 4
    for n in range(4):
        database.store(Event(n, "more", Severity.INFO, "t"))
    assert database.dropped_full == 6
    assert [event.code for event in database.events(1)] == ["database.overload"]
    assert database.events(2) == []
    gate.set()
    database.flush()
    assert (count(database, "targets"), count(database, "events")) == (8, 3)
    database.close()
    assert database.counters()[1].value == 6


FULL = textwrap.dedent(
    """
    import resource, sys, time
    from pathlib import Path
    from groundstation.domain.errors import ResourceError
    from groundstation.domain.events import Event, Severity
    from groundstation.store.database import Database

    database = Database(Path(sys.argv[1]))
    database.store(Event(0, "first", Severity.INFO, "t"))
    database.flush()
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    for n in range(500):
        database.store(Event(n, "big", Severity.INFO, f"{n}" + "x" * 1000))
    try:
        database.flush()
        raise AssertionError("flush must say that it failed")
    except ResourceError as error:
        print(error)
    assert [event.code for event in database.events(1)] == ["database.failed"]
    assert database.dropped_disk == 500
    resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    database.store(Event(1, "after", Severity.INFO, "t"))
    while database.failure is not None or database.written_count < 2:
        time.sleep(0.01)
    database.flush()
    assert [event.code for event in database.events(1)] == ["database.recovered"]
    assert [event.code for event in database.reader.events_before(9)] == ["first", "after"]
    database.close()
    """
)


def test_a_full_disk_costs_rows_and_nothing_else(tmp_path: Path) -> None:
    assert resource.getrlimit(resource.RLIMIT_FSIZE)
    command = [sys.executable, "-c", FULL, str(tmp_path / "x.sqlite")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stderr
    assert "cannot write" in result.stdout


def test_a_damaged_file_is_put_aside(tmp_path: Path) -> None:
    path = tmp_path / "x.sqlite"
    path.write_bytes(b"this is no database, but long enough to look at" * 100)
    database = Database(path)
    (event,) = database.events(7)
    assert (event.code, event.time_ns) == ("database.damaged", 7)
    assert (tmp_path / "x.sqlite.damaged-1").exists()
    database.store(Event(0, "a", Severity.INFO, "t"))
    database.flush()
    assert len(database.reader.events_before(1)) == 1
    database.close()


def test_cannot_be_opened(tmp_path: Path) -> None:
    with pytest.raises(ResourceError, match="cannot open"):
        Database(tmp_path / "missing" / "x.sqlite")
    with sqlite3.connect(tmp_path / "newer.sqlite") as connection:
        connection.execute("PRAGMA user_version = 99")
    connection.close()
    with pytest.raises(InputError, match="schema 99"):
        Database(tmp_path / "newer.sqlite")


def test_readers_do_not_wait_for_the_writer(database: Database) -> None:
    database.store(Event(0, "a", Severity.INFO, "t"))
    database.flush()
    lock = sqlite3.connect(database._path, isolation_level=None)
    lock.execute("BEGIN IMMEDIATE")
    try:
        assert len(database.reader.events_before(1)) == 1
    finally:
        lock.close()


def test_a_curve_is_even_in_time_and_ends_with_the_newest(
    database: Database, target_state: Callable[..., TargetState]
) -> None:
    for tenth in range(1, 1001):
        database.store(target_state(7, tenth, tenth * 100_000_000))
    database.store(target_state(8, 1, 5))
    database.flush()
    curve = database.reader.target_curve(7, limit=20)
    assert 10 < len(curve) <= 20
    times = [point.time_ns for point in curve]
    assert times[-1] == 100_000_000_000
    gaps = [b - a for a, b in pairwise(times)]
    assert max(gaps) - min(gaps) <= 100_000_000
    late = database.reader.target_curve(7, 90_000_000_000, 1000)
    assert [point.time_ns for point in late] == [tenth * 100_000_000 for tenth in range(901, 1001)]
    assert database.reader.target_curve(9) == []
