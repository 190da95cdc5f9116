"""One directory for each run of the station, and how a run is taken up again after a stop.

Rule: the journal's first record says ``began``, the first after a restart says ``resumed``
(which every engine takes as: forget the stream, revoke every grant), the last of a clean end
says ``ended``. This module writes them, so no caller can forget. Two stations never share
a directory: a lock that the kernel drops with the process guards it.

    2026-11-22T014500Z/
        meta.json        what made it: version, settings, formats, runs, whether it ended cleanly
        journal/         every input, in order (journal.py)
        snapshots/       the engines' state, now and then (snapshots.py)
        session.sqlite   events, targets, commands, operators' actions (database.py)
        frames.tlog      every frame, both directions, for other tools; frames-2.tlog after a restart
        lock
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from groundstation.domain.errors import InputError, ResourceError
from groundstation.domain.events import Counter, Event, Severity
from groundstation.domain.inputs import AnyInput, Record, SessionInput
from groundstation.store.clock import StationClock
from groundstation.store.database import Database
from groundstation.store.journal import Journal, JournalReader
from groundstation.store.meta import Lock, SessionMeta, read_meta, write_meta
from groundstation.store.recording import Recording
from groundstation.store.settings import StoreSettings
from groundstation.store.snapshots import Snapshot, SnapshotStore

JOURNAL_DIRECTORY = "journal"
SNAPSHOT_DIRECTORY = "snapshots"
DATABASE_NAME = "session.sqlite"


class Session:
    """An open session: the one place where inputs become records."""

    def __init__(
        self,
        directory: Path,
        meta: SessionMeta,
        lock: Lock,
        settings: StoreSettings,
        clock: StationClock,
        seq: int,
    ) -> None:
        """Made by ``open_new`` and ``resume`` only. ``seq``: of the next record."""
        self.directory = directory
        self.meta = meta
        self.settings = settings
        self.clock = clock
        self._lock = lock
        self._seq = seq
        self._closed = False
        self.database = Database(directory / DATABASE_NAME, settings.database_queue)
        self.snapshots = SnapshotStore(directory / SNAPSHOT_DIRECTORY, settings.snapshot_keep)
        self.journal = Journal(directory / JOURNAL_DIRECTORY, meta.session_id, settings)
        self.recording = Recording(directory, settings)
        self.snapshots_count = 0
        self.snapshots_failed_count = 0

    def record(self, entry: AnyInput) -> Record:
        """Stamp ``entry`` with its number and time, journal it, and give it back for handling.

        Never blocks on the disk and never fails because of it.
        """
        time_ns, unix_us = self.clock.now()
        record = Record(self._seq, time_ns, unix_us, entry)
        self._seq += 1
        self.journal.append(record)
        self.recording.append(record)
        self.database.store_record(record)
        return record

    def save_snapshot(self, seq: int, time_ns: int, state: Any) -> Path:
        """Keep ``state`` as it was after record ``seq``. Blocks: call it on a worker thread.

        The journal is put on the disk first: a snapshot is never ahead of it.

        Raises:
            ResourceError: the disk refused; the station goes on, starting again takes longer.
        """
        try:
            self.journal.sync()
            path = self.snapshots.save(Snapshot(seq, time_ns, state))
        except ResourceError:
            self.snapshots_failed_count += 1
            raise
        self.snapshots_count += 1
        return path

    def events(self) -> list[Event]:
        """What the operator must know of this session's files since the last call."""
        time_ns = self.clock.time_ns()
        return [
            *self.journal.events(time_ns),
            *self.recording.events(time_ns),
            *self.database.events(time_ns),
        ]

    def health(self) -> dict[str, str]:
        """For each of the session's files that is not being written: why."""
        failures = {
            "journal": self.journal.failure,
            "recording": self.recording.failure,
            "database": self.database.failure,
        }
        return {name: reason for name, reason in failures.items() if reason is not None}

    def counters(self) -> list[Counter]:
        """Running totals of this run."""
        return [
            *self.journal.counters(),
            *self.recording.counters(),
            *self.database.counters(),
            Counter("snapshots_total", (), self.snapshots_count),
            Counter("snapshots_failed_total", (), self.snapshots_failed_count),
        ]

    def close(self, version: str) -> Record | None:
        """End cleanly: journal ``ended``, write what waits, mark the end. A second call does nothing.

        Raises:
            ResourceError: the end could not be marked; the session will count as stopped short.
        """
        if self._closed:
            return None
        self._closed = True
        record = self.record(SessionInput("ended", version))
        self.abandon()
        if self.journal.failure is None:
            self.meta = self.meta.ended(record.unix_us)
            write_meta(self.directory, self.meta)
        return record

    def abandon(self) -> None:
        """Write what waits and let go, without a clean end: the session can be resumed."""
        self._closed = True
        self.journal.close()
        self.recording.close()
        self.database.close()
        self._lock.release()


@dataclass(frozen=True, slots=True)
class ResumedSession:
    """A session taken up again. Restore ``snapshot``, handle ``tail``, then ``resumed``, then go on."""

    session: Session
    snapshot: Snapshot | None
    """Restore this first; None: begin with empty engines."""
    tail: Iterator[Record]
    """Records of the runs before, behind the snapshot, oldest first; read once. ``resumed`` is not of it."""
    resumed: Record
    """The record that says ``resumed``; journalled already, to be handled behind the tail."""
    events: tuple[Event, ...]
    """What was lost and passed over."""


def open_new(
    data_dir: Path,
    version: str,
    settings: StoreSettings | None = None,
    config: Mapping[str, Any] | None = None,
    clock: StationClock | None = None,
) -> tuple[Session, Record]:
    """A new session directory in ``data_dir``, and the record that says ``began``.

    ``config``: the settings in force, kept in ``meta.json`` (values that JSON can hold).

    Raises:
        ResourceError: the directory cannot be made or written.
    """
    clock = clock or StationClock()
    unix_us = clock.unix_us()
    directory = _make_directory(data_dir, unix_us)
    lock = Lock.take(directory)
    meta = SessionMeta.new(directory.name, version, unix_us, dict(config or {}))
    write_meta(directory, meta)
    session = Session(directory, meta, lock, settings or StoreSettings(), clock, 0)
    return session, session.record(SessionInput("began", version))


def resume(
    directory: Path,
    version: str,
    settings: StoreSettings | None = None,
    config: Mapping[str, Any] | None = None,
    clock: StationClock | None = None,
) -> ResumedSession:
    """Take up the session in ``directory`` where it stopped.

    ``clock``: for tests; it must have been made with the last journalled time.

    Raises:
        InputError: not a session, or of a newer format.
        ResourceError: another station has it open, or it cannot be written.
    """
    meta = read_meta(directory)
    lock = Lock.take(directory)
    try:
        return _resume_locked(directory, meta, lock, version, settings or StoreSettings(), config, clock)
    except BaseException:
        lock.release()
        raise


def _resume_locked(
    directory: Path,
    meta: SessionMeta,
    lock: Lock,
    version: str,
    settings: StoreSettings,
    config: Mapping[str, Any] | None,
    clock: StationClock | None,
) -> ResumedSession:
    snapshot, events = SnapshotStore(directory / SNAPSHOT_DIRECTORY).newest()
    after_seq = -1 if snapshot is None else snapshot.seq
    last_seq, last_ns, damage = _end_of(directory, after_seq)
    if snapshot is not None and snapshot.seq >= last_seq:
        last_seq, last_ns = snapshot.seq, max(last_ns, snapshot.time_ns)
    clock = clock or StationClock(not_before_ns=last_ns)
    time_ns = clock.time_ns()
    events = [Event(time_ns, event.code, event.severity, event.text) for event in events]
    if damage:
        events.append(Event(time_ns, "journal.damaged", Severity.WARNING, f"On restart, {damage}"))
    if clock.held_back_ns:
        text = f"The computer's clock is {clock.held_back_ns / 1e9:.1f} s behind the session's last record"
        events.append(Event(time_ns, "clock.behind", Severity.WARNING, text))
    # Before this run's first record: its file is then none of the tail's.
    tail = _tail(directory, after_seq)
    meta = meta.resumed(version, clock.unix_us(), dict(config or {}))
    write_meta(directory, meta)
    session = Session(directory, meta, lock, settings, clock, last_seq + 1)
    if last_ns and not damage:
        # Of a damaged journal the database's history is what is left.
        session.database.forget_targets_after(last_ns)
    resumed = session.record(SessionInput("resumed", version))
    return ResumedSession(session, snapshot, tail, resumed, tuple(events))


def open_to_read(directory: Path) -> tuple[SessionMeta, JournalReader]:
    """A session's metadata and its whole journal, for a replay. Raises InputError."""
    return read_meta(directory), JournalReader(directory)


def find_resumable(data_dir: Path, max_age_h: float | None = None, unix_us: int | None = None) -> Path | None:
    """The newest session in ``data_dir`` that did not end cleanly and that no station has open.

    ``max_age_h``: pass over it when its last sign of life is older than this at ``unix_us``.
    A session that cannot be read is passed over; a newer one that ended cleanly means that
    the operator has moved on: then there is none.
    """
    if not data_dir.is_dir():
        return None
    for directory in sorted((path for path in data_dir.iterdir() if path.is_dir()), reverse=True):
        try:
            meta = read_meta(directory)
        except (InputError, ResourceError):
            continue
        if meta.ended_unix_us is not None:
            return None
        if Lock.is_taken(directory):
            continue
        if max_age_h is not None and unix_us is not None:
            age_h = (unix_us - _last_sign_us(directory)) / 3.6e9
            if age_h > max_age_h:
                return None
        return directory
    return None


def _make_directory(data_dir: Path, unix_us: int) -> Path:
    name = datetime.fromtimestamp(unix_us // 1_000_000, UTC).strftime("%Y-%m-%dT%H%M%SZ")
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
        number = 1
        while True:
            directory = data_dir / (name if number == 1 else f"{name}-{number}")
            try:
                directory.mkdir()
            except FileExistsError:
                number += 1
                continue
            return directory
    except OSError as error:
        raise ResourceError(f"cannot make a session in {data_dir}: {error.strerror}") from error


def _end_of(directory: Path, after_seq: int) -> tuple[int, int, str]:
    """(seq, station time) of the journal's last record, and what is damaged, from ``after_seq`` on."""
    try:
        reader = JournalReader(directory, after_seq)
    except InputError:
        return -1, 0, ""
    for _ in reader:
        pass
    last = reader.last_record
    return (after_seq, 0, reader.damage()) if last is None else (last.seq, last.time_ns, reader.damage())


def _tail(directory: Path, after_seq: int) -> Iterator[Record]:
    try:
        return iter(JournalReader(directory, after_seq))
    except InputError:
        return iter(())


def _last_sign_us(directory: Path) -> int:
    files = [directory / "meta.json", *(directory / JOURNAL_DIRECTORY).glob("*.journal")]
    return max(int(path.stat().st_mtime_ns // 1000) for path in files)
