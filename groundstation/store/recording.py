"""``frames.tlog``: every frame in both directions, for other ground stations' tools.

Rule: it holds what the journal's frames hold, no more; each record is 8 bytes of wall clock
(big-endian µs since the Unix epoch) and the raw frame. A later run never appends to an
earlier run's file, whose last record a crash may have cut short.
"""

from __future__ import annotations

import struct
from pathlib import Path

from groundstation.domain.events import Counter, Event
from groundstation.domain.inputs import FrameInput, Record
from groundstation.store.settings import StoreSettings
from groundstation.store.writer import BackgroundWriter

_TIME = struct.Struct(">Q")


class Recording:
    """Writes the session's ``.tlog``; by the rules of ``BackgroundWriter``."""

    def __init__(self, directory: Path, settings: StoreSettings) -> None:
        """The file is made with its first frame."""
        self._directory = directory
        self._writer = BackgroundWriter("recording", self._next_file, settings)
        self.frames_count = 0

    def append(self, record: Record) -> None:
        """Take the frame of ``record``, if it has one."""
        if isinstance(record.input, FrameInput) and self._writer.append(
            _TIME.pack(record.unix_us) + record.input.frame
        ):
            self.frames_count += 1

    def close(self) -> None:
        """Write what waits and stop."""
        self._writer.close()

    @property
    def failure(self) -> str | None:
        """Why nothing can be written at the moment; None when all is well."""
        return self._writer.failure

    def events(self, time_ns: int) -> list[Event]:
        """What the operator must know since the last call."""
        return self._writer.events("recording", "The recording (.tlog)", time_ns)

    def counters(self) -> list[Counter]:
        """Running totals of this run."""
        return [
            Counter("recording_frames_total", (), self.frames_count),
            Counter("recording_dropped_total", (), self._writer.dropped_count),
        ]

    def _next_file(self, data: bytes) -> tuple[Path, bytes]:
        number = 1
        while (path := self._directory / _name(number)).exists():
            number += 1
        return path, b""


def _name(number: int) -> str:
    return "frames.tlog" if number == 1 else f"frames-{number}.tlog"
