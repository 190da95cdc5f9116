"""SQLite behind one writer thread: what people ask for afterwards, and what pages scroll back to.

Rule: one connection writes, on one thread, in batches; readers never wait for it (WAL). It
holds outputs only: all of it can be made again from the journal, so a full disk or a full
queue costs rows, counted, and nothing else. Events, commands and operators' actions may use
the whole queue, target history and link verdicts only most of it: when something must
give, it is the bulk.
"""

from __future__ import annotations

import queue
import sqlite3
import threading
import time
from pathlib import Path
from typing import Any

from groundstation.domain.command import CommandStatus
from groundstation.domain.errors import ResourceError
from groundstation.domain.events import Counter, Event, Severity
from groundstation.domain.inputs import OperatorInput, Record
from groundstation.domain.target import LinkVerdict, TargetState
from groundstation.store import rows
from groundstation.store.queries import Queries
from groundstation.store.schema import migrate

_BULK_SHARE = 0.8
_BATCH = 2_000
_BATCH_WAIT_S = 0.25

_BAD_ROW = (
    OverflowError,
    UnicodeEncodeError,
    sqlite3.DataError,
    sqlite3.IntegrityError,
    sqlite3.InterfaceError,
    sqlite3.ProgrammingError,
)
Row = tuple[str, tuple[Any, ...]]
"""SQL statement and its values."""


class Database:
    """Rows in from any thread without waiting; queries by ``reader``."""

    def __init__(self, path: Path, queue_size: int = 10_000) -> None:
        """Opens or makes ``path``; a damaged one is put aside and begun anew (see ``events``).

        Raises:
            ResourceError: it cannot be opened.
            InputError: of a newer version, or another program's.
        """
        self._path = path
        self._queue: queue.Queue[Row | threading.Event | None] = queue.Queue(queue_size)
        self._bulk_limit = int(queue_size * _BULK_SHARE)
        self._start_events: list[tuple[str, str]] = []
        self._connection = self._open()
        self.failure: str | None = None
        """Why rows are not being written at the moment; None when all is well."""
        self._reported_failure = False
        self._reported_lost = 0
        self.written_count = 0
        self.dropped_full = 0
        """Rows that found the queue full."""
        self.dropped_disk = 0
        """Rows that the disk refused."""
        self.dropped_bad = 0
        """Rows with a value that SQLite cannot hold, or none where one must be."""
        self._closed = False
        self.reader = Queries(path)
        self._thread = threading.Thread(target=self._run, name="database-writer", daemon=True)
        self._thread.start()

    def store_record(self, record: Record) -> None:
        """Keep an operator's action; other inputs are the journal's alone."""
        if isinstance(record.input, OperatorInput):
            self._put(rows.operator_row(record.seq, record.time_ns, record.input))

    def store(self, output: object) -> None:
        """Keep an event, a target's state, a command's status or a link's verdict; ignore all else."""
        match output:
            case Event():
                self._put(rows.event_row(output))
            case CommandStatus():
                self._put(rows.command_row(output))
            case TargetState():
                self._put(rows.target_row(output), bulk=True)
            case LinkVerdict():
                self._put(rows.verdict_row(output), bulk=True)

    def forget_targets_after(self, time_ns: int) -> None:
        """Drop estimates newer than ``time_ns``, the journal's end, before a session goes on from there.

        A run that was killed may have told them here before its journal held what they came from: they
        cannot be replayed, and the beacon's next estimate gets the same number.
        """
        self._put((rows.FORGET_TARGETS, (time_ns,)))

    def flush(self, timeout_s: float = 10.0) -> None:
        """Wait until what was stored so far can be queried. Blocks. Raises ResourceError."""
        reached = threading.Event()
        try:
            self._queue.put(reached, timeout=timeout_s)
        except queue.Full as error:
            raise ResourceError(f"{self._path}: the database's queue stays full") from error
        if not reached.wait(timeout_s) or self.failure is not None:
            raise ResourceError(self.failure or f"{self._path}: the database did not answer in {timeout_s} s")

    def close(self) -> None:
        """Write what waits, then close. A second call does nothing."""
        if self._closed:
            return
        self._closed = True
        self._queue.put(None)
        self._thread.join()
        self.reader.close()
        self._connection.close()

    def events(self, time_ns: int) -> list[Event]:
        """What the operator must know since the last call."""
        found = [Event(time_ns, code, Severity.WARNING, text) for code, text in self._start_events]
        self._start_events.clear()
        if self.failure is not None and not self._reported_failure:
            self._reported_failure = True
            text = f"The database is not being written: {self.failure}. The station goes on without it"
            found.append(Event(time_ns, "database.failed", Severity.ERROR, text))
        elif self.failure is None and self._reported_failure:
            self._reported_failure = False
            text = f"The database is being written again; {self.dropped_disk} rows are lost in all"
            found.append(Event(time_ns, "database.recovered", Severity.WARNING, text))
        elif self.dropped_full > self._reported_lost:
            text = f"The database cannot keep up: {self.dropped_full} rows are lost in all"
            found.append(Event(time_ns, "database.overload", Severity.WARNING, text))
        self._reported_lost = self.dropped_full
        return found

    def counters(self) -> list[Counter]:
        """Running totals of this run."""
        return [
            Counter("database_rows_total", (), self.written_count),
            Counter("database_dropped_total", (("reason", "queue_full"),), self.dropped_full),
            Counter("database_dropped_total", (("reason", "disk"),), self.dropped_disk),
            Counter("database_dropped_total", (("reason", "bad_row"),), self.dropped_bad),
        ]

    def _put(self, row: Row, bulk: bool = False) -> None:
        if self._closed or (bulk and self._queue.qsize() >= self._bulk_limit):
            self.dropped_full += 1
            return
        try:
            self._queue.put_nowait(row)
        except queue.Full:
            self.dropped_full += 1

    def _open(self) -> sqlite3.Connection:
        try:
            return _connect(self._path)
        except sqlite3.DatabaseError as error:
            if error.sqlite_errorcode & 0xFF not in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
                raise ResourceError(f"cannot open {self._path}: {error}") from error
            aside = _put_aside(self._path)
            text = f"The database was damaged ({error}); it lies in {aside.name}, a new one was begun"
            self._start_events.append(("database.damaged", text))
        try:
            return _connect(self._path)
        except sqlite3.Error as error:
            raise ResourceError(f"cannot open {self._path}: {error}") from error

    def _run(self) -> None:
        closing = False
        while not closing:
            batch, waiters, closing = self._take()
            if batch:
                self._write(batch)
            for waiter in waiters:
                waiter.set()

    def _take(self) -> tuple[list[Row], list[threading.Event], bool]:
        batch: list[Row] = []
        waiters: list[threading.Event] = []
        item = self._queue.get()
        deadline = time.monotonic() + _BATCH_WAIT_S
        while True:
            if item is None:
                return batch, waiters, True
            if isinstance(item, threading.Event):
                waiters.append(item)
                return batch, waiters, False
            batch.append(item)
            if len(batch) >= _BATCH:
                return batch, waiters, False
            try:
                item = self._queue.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                return batch, waiters, False

    def _write(self, batch: list[Row]) -> None:
        try:
            self._transact(batch)
        except _BAD_ROW:
            # One value that SQLite cannot hold must not cost its neighbours.
            for row in batch:
                try:
                    self._transact([row])
                except _BAD_ROW:
                    self.dropped_bad += 1

    def _transact(self, batch: list[Row]) -> None:
        try:
            with self._connection:
                self._connection.execute("BEGIN")
                for statement, values in batch:
                    self._connection.execute(statement, values)
        except _BAD_ROW:
            raise
        except sqlite3.Error as error:
            self.dropped_disk += len(batch)
            self.failure = f"cannot write {self._path}: {error}"
            return
        self.written_count += len(batch)
        self.failure = None


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=10.0)
    try:
        connection.execute("PRAGMA journal_mode = WAL")
        # NORMAL under WAL: a power cut may cost the last transactions, never the file.
        connection.execute("PRAGMA synchronous = NORMAL")
        migrate(connection, str(path))
    except BaseException:
        connection.close()
        raise
    return connection


def _put_aside(path: Path) -> Path:
    number = 1
    while (aside := path.with_name(f"{path.name}.damaged-{number}")).exists():
        number += 1
    path.rename(aside)
    for suffix in ("-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
    return aside
