"""Appends bytes to files from a thread of its own: the event loop never waits for a disk.

Rule: bounded loss, bounded memory, no exception. What is appended reaches the operating
system within the flush interval (a killed process loses no more) and the disk itself within
the fsync interval (a power cut loses no more). When the disk refuses, what waits is kept
and tried again, byte for byte where it stopped; only what no longer fits in memory is
dropped, and counted.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

from groundstation.domain.errors import ResourceError
from groundstation.domain.events import Event, Severity
from groundstation.store.settings import StoreSettings

_EAGER_BYTES = 262_144
"""Waiting bytes at which the thread does not wait for the interval."""


class BackgroundWriter:
    """One append-only file, or a series of them, written by one thread."""

    def __init__(
        self,
        name: str,
        next_file: Callable[[bytes], tuple[Path, bytes]],
        settings: StoreSettings,
        rotate_bytes: int | None = None,
    ) -> None:
        """``next_file(first_bytes)`` gives the path and header of the next file.

        ``rotate_bytes``: size at which a new file is begun; None: one file for ever.
        """
        self._next_file = next_file
        self._settings = settings
        self._rotate_bytes = rotate_bytes
        self._condition = threading.Condition()
        self._pending: list[bytes] = []
        self._waiting_bytes = 0
        self._waiting_count = 0
        self._urgent = False
        self._sync_wanted = 0
        self._sync_done = 0
        self._closing = False
        self._failure: str | None = None
        self._reported_failure = False
        self._reported_dropped = 0
        self.dropped_count = 0
        """Entries lost because the disk was full for longer than memory lasts."""
        self.written_bytes = 0
        self.files_count = 0
        self._descriptor: int | None = None
        self._file_bytes = 0
        self._unsynced = False
        self._path: Path | None = None
        self._thread = threading.Thread(target=self._run, name=f"{name}-writer", daemon=True)
        self._thread.start()

    @property
    def failure(self) -> str | None:
        """Why the disk refuses now, in one line; None when it does not."""
        if self._failure is None and not self._closing and not self._thread.is_alive():
            return f"the {self._thread.name} stopped"
        return self._failure

    def append(self, data: bytes, urgent: bool = False, count: int = 1) -> bool:
        """Take ``data`` for writing; False when it had to be dropped. Never blocks on the disk.

        ``urgent`` wakes the thread at once; ``count``: how many entries ``data`` holds.
        """
        with self._condition:
            if self._closing or self._waiting_bytes + len(data) > self._settings.pending_bytes:
                self.dropped_count += count
                return False
            self._pending.append(data)
            self._waiting_count += count
            self._waiting_bytes += len(data)
            if urgent or (self._waiting_bytes >= _EAGER_BYTES and not self._urgent):
                self._urgent = True
                self._condition.notify_all()
        return True

    def sync(self, timeout_s: float = 10.0) -> None:
        """Wait until everything appended so far is on the disk itself. Blocks: not for the event loop.

        Raises:
            ResourceError: the disk refused, or did not answer in time.
        """
        with self._condition:
            self._sync_wanted += 1
            ticket = self._sync_wanted
            self._condition.notify_all()
            done = self._condition.wait_for(
                lambda: self._sync_done >= ticket or self._failure is not None or not self._thread.is_alive(),
                timeout_s,
            )
            if self._sync_done >= ticket:
                return
            reason = self._failure or ("the disk did not answer in time" if not done else "already closed")
        raise ResourceError(reason)

    def close(self) -> None:
        """Write what waits (one last try when the disk refuses; what is left is counted), then stop."""
        with self._condition:
            self._closing = True
            self._condition.notify_all()
        self._thread.join()

    def events(self, code: str, name: str, time_ns: int) -> list[Event]:
        """What the operator must know since the last call: the disk refuses, or takes again."""
        failure = self.failure
        if failure is not None and not self._reported_failure:
            self._reported_failure = True
            text = f"{name} is not being written: {failure}. Free disk space; the station goes on without it"
            return [Event(time_ns, f"{code}.failed", Severity.ERROR, text)]
        if failure is None and self._reported_failure:
            self._reported_failure = False
            lost = self.dropped_count - self._reported_dropped
            self._reported_dropped = self.dropped_count
            outcome = f"{lost} entries are lost" if lost else "nothing is lost"
            text = f"{name} is being written again; {outcome}"
            return [Event(time_ns, f"{code}.recovered", Severity.WARNING, text)]
        return []

    def _run(self) -> None:
        left = b""
        last_sync = time.monotonic()
        while True:
            batch, count, closing, ticket = self._take()
            data = left + b"".join(batch)
            failure, left = self._write(data)
            due = time.monotonic() - last_sync >= self._settings.fsync_interval_s
            if failure is None and self._unsynced and (closing or due or ticket > self._sync_done):
                failure = self._fsync()
                last_sync = time.monotonic()
            with self._condition:
                self._waiting_bytes -= len(data) - len(left)
                self._failure = failure
                if failure is None:
                    self._sync_done = ticket
                taken = 0 if left else count
                self._waiting_count -= taken
                if closing:
                    self.dropped_count += self._waiting_count
                self._condition.notify_all()
                if not closing and failure is not None:
                    self._condition.wait_for(lambda: self._closing, self._settings.retry_interval_s)
            if closing:
                break
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def _take(self) -> tuple[list[bytes], int, bool, int]:
        with self._condition:
            self._condition.wait_for(
                lambda: self._closing or self._urgent or self._sync_wanted > self._sync_done,
                self._settings.flush_interval_s,
            )
            batch, self._pending = self._pending, []
            self._urgent = False
            return batch, self._waiting_count, self._closing, self._sync_wanted

    def _write(self, data: bytes) -> tuple[str | None, bytes]:
        """Why it failed (None: it did not) and what is still to be written."""
        view = memoryview(data)
        try:
            if data and self._must_rotate(len(data)):
                self._open_next(data)
            while view:
                assert self._descriptor is not None
                count = os.write(self._descriptor, view)
                view = view[count:]
                self.written_bytes += count
                self._file_bytes += count
                self._unsynced = True
        except OSError as error:
            return f"cannot write {self._path}: {error.strerror or error}", bytes(view)
        return None, b""

    def _must_rotate(self, size: int) -> bool:
        if self._descriptor is None:
            return True
        # A batch that was cut short by a full disk goes on in the file where it began.
        return (
            self._rotate_bytes is not None
            and self._failure is None
            and self._file_bytes + size > self._rotate_bytes
        )

    def _open_next(self, data: bytes) -> None:
        if self._descriptor is not None:
            os.fsync(self._descriptor)
            os.close(self._descriptor)
            self._descriptor = None
        self._path, header = self._next_file(data)
        descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        try:
            if os.write(descriptor, header) != len(header):
                raise OSError(None, "no space for the file's header")
        except OSError:
            os.close(descriptor)
            raise
        self._descriptor = descriptor
        self._file_bytes = len(header)
        self.files_count += 1
        sync_directory(self._path.parent)

    def _fsync(self) -> str | None:
        assert self._descriptor is not None
        try:
            os.fsync(self._descriptor)
        except OSError as error:
            return f"cannot write {self._path} to the disk: {error.strerror or error}"
        self._unsynced = False
        return None


def sync_directory(directory: Path) -> None:
    """Make a new or renamed file's name survive a power cut."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
