"""The append-only list of everything that may change what the station believes.

Rule: a replay of the journal sees what the live run saw, in the same order, or the reader
says what is missing. Files ``journal/000001.journal``, … each begin with

    magic "GSJRNL\\r\\n" | format version u16 | id length u16 | file index u32 | first seq u64
    session id (UTF-8) | CRC-32 u32

and go on with records (codec.py). A file is never appended to by a later run: a restart
begins the next file. A tail that a crash cut short is skipped and counted; damage inside a
file costs the records it touched and no more.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from groundstation.domain.errors import InputError
from groundstation.domain.events import Counter, Event
from groundstation.domain.inputs import FrameInput, Record, TickInput
from groundstation.store.codec import CRC, HEAD, MARKER, MAX_PAYLOAD, decode_record, encode_record
from groundstation.store.settings import StoreSettings
from groundstation.store.writer import BackgroundWriter

FORMAT_VERSION = 1
MAGIC = b"GSJRNL\r\n"
_HEADER = struct.Struct("<8sHHIQ")
_SUFFIX = ".journal"


class Journal:
    """Writes records. ``append`` never blocks on the disk and never fails; see ``events``."""

    def __init__(self, directory: Path, session_id: str, settings: StoreSettings | None = None) -> None:
        """Begins a new file behind those already in ``directory`` (made when missing)."""
        directory.mkdir(parents=True, exist_ok=True)
        self._directory = directory
        self._session_id = session_id
        self._index = _last_index(directory)
        settings = settings or StoreSettings()
        self._writer = BackgroundWriter("journal", self._next_file, settings, settings.segment_bytes)
        self.records_count = 0
        """Records taken in this run."""

    def append(self, record: Record) -> None:
        """Take one record; frames and ticks within the flush interval, all else at once."""
        urgent = not isinstance(record.input, FrameInput | TickInput)
        if self._writer.append(encode_record(record), urgent):
            self.records_count += 1

    def sync(self) -> None:
        """Wait until all of it is on the disk itself (blocks). Raises ResourceError."""
        self._writer.sync()

    def close(self) -> None:
        """Write what waits and stop."""
        self._writer.close()

    @property
    def failure(self) -> str | None:
        """Why nothing can be written at the moment; None when all is well."""
        return self._writer.failure

    def events(self, time_ns: int) -> list[Event]:
        """What the operator must know since the last call: the disk refuses, or takes again."""
        return self._writer.events("journal", "The journal", time_ns)

    def counters(self) -> list[Counter]:
        """Running totals of this run."""
        return [
            Counter("journal_records_total", (), self.records_count),
            Counter("journal_bytes_total", (), self._writer.written_bytes),
            Counter("journal_dropped_total", (), self._writer.dropped_count),
        ]

    def _next_file(self, data: bytes) -> tuple[Path, bytes]:
        self._index += 1
        first_seq = HEAD.unpack_from(data)[4]
        name = self._session_id.encode()
        header = _HEADER.pack(MAGIC, FORMAT_VERSION, len(name), self._index, first_seq) + name
        path = self._directory / f"{self._index:06d}{_SUFFIX}"
        return path, header + CRC.pack(zlib.crc32(header))


class JournalReader:
    """Reads records in order, and counts what could not be read.

    ``path``: a session's directory, its ``journal`` directory, or one file of it.
    """

    def __init__(self, path: Path, after_seq: int = -1) -> None:
        """``after_seq``: skip records up to and with this one."""
        self.files = journal_files(path)
        self._after_seq = after_seq
        self.session_id: str | None = None
        self.first_record: Record | None = None
        self.last_record: Record | None = None
        self.records_count = 0
        self.torn_bytes = 0
        """Behind the last whole record of a file: what a crash cut short."""
        self.damaged_bytes = 0
        """Between whole records: what the disk spoiled."""
        self.missing_count = 0
        """Records that the sequence numbers say existed."""
        self.repeated_count = 0
        """Records with a sequence number that had passed already: skipped."""
        self._whole = not path.is_file()
        self._next_seq: int | None = None

    def __iter__(self) -> Iterator[Record]:
        for index, path in enumerate(self.files):
            following = self.files[index + 1] if index + 1 < len(self.files) else None
            if following is not None and self._all_before(following):
                continue
            yield from self._read_file(path)

    def counters(self) -> list[Counter]:
        """What was read, and what was lost, so far."""
        return [
            Counter("journal_read_records_total", (), self.records_count),
            Counter("journal_torn_bytes_total", (), self.torn_bytes),
            Counter("journal_damaged_bytes_total", (), self.damaged_bytes),
            Counter("journal_missing_records_total", (), self.missing_count),
            Counter("journal_repeated_records_total", (), self.repeated_count),
        ]

    def damage(self) -> str:
        """In one line what was lost; empty when the journal was whole."""
        if not (self.torn_bytes or self.damaged_bytes or self.missing_count):
            return ""
        return (
            f"the journal is not whole: {self.missing_count} records missing, "
            f"{self.damaged_bytes} bytes damaged, {self.torn_bytes} bytes cut short at the end of a file"
        )

    def _all_before(self, following: Path) -> bool:
        """Whether the file before ``following`` holds nothing that is asked for."""
        if self._after_seq < 0:
            return False
        with following.open("rb") as file:
            header = _parse_header(file.read(_HEADER.size + 0xFFFF + CRC.size), following)
        return header is not None and header[2] <= self._after_seq + 1

    def _read_file(self, path: Path) -> Iterator[Record]:
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"cannot read {path}: {error.strerror}") from error
        header = _parse_header(data, path)
        position = 0
        if header is not None:
            position, session_id, _ = header
            self.session_id = self.session_id or session_id
        while position < len(data):
            found = _record_at(data, position)
            if found is None:
                behind = _next_record(data, position + 1)
                if behind is None:
                    self.torn_bytes += len(data) - position
                    return
                self.damaged_bytes += behind - position
                position = behind
                continue
            kind, seq, time_ns, unix_us, start, end = found
            position = end + CRC.size
            if seq <= self._after_seq:
                continue
            if self._next_seq is None:
                self._next_seq = self._after_seq + 1 if self._whole else seq
            if seq < self._next_seq:
                self.repeated_count += 1
                continue
            self.missing_count += seq - self._next_seq
            self._next_seq = seq + 1
            record = decode_record(kind, seq, time_ns, unix_us, data[start:end])
            self.records_count += 1
            self.first_record = self.first_record or record
            self.last_record = record
            yield record


def journal_files(path: Path) -> list[Path]:
    """The journal's files in order.

    Raises:
        InputError: there are none at ``path``.
    """
    if path.is_file():
        return [path]
    directory = path / "journal" if (path / "journal").is_dir() else path
    files = sorted(directory.glob(f"*{_SUFFIX}")) if directory.is_dir() else []
    if not files:
        raise InputError(f"{path}: no journal here; a session's directory with journal/*{_SUFFIX} is needed")
    return files


def _last_index(directory: Path) -> int:
    numbers = [int(path.stem) for path in directory.glob(f"*{_SUFFIX}") if path.stem.isdigit()]
    return max(numbers, default=0)


def _parse_header(data: bytes, path: Path) -> tuple[int, str, int] | None:
    """(end, session id, first seq); None when it is cut short or damaged.

    Raises:
        InputError: not a journal at all, or of a newer version.
    """
    if len(data) < _HEADER.size:
        return None
    magic, version, length, _, first_seq = _HEADER.unpack_from(data)
    end = _HEADER.size + length
    if len(data) < end + CRC.size or CRC.unpack_from(data, end)[0] != zlib.crc32(data[:end]):
        if magic != MAGIC and _next_record(data, 0) is None:
            raise InputError(f"{path}: not a journal (it begins with {data[:8]!r})")
        return None
    if version != FORMAT_VERSION:
        raise InputError(f"{path}: journal format {version}; this version reads {FORMAT_VERSION}")
    return end + CRC.size, data[_HEADER.size : end].decode(), first_seq


def _record_at(data: bytes, position: int) -> tuple[int, int, int, int, int, int] | None:
    """(kind, seq, time_ns, unix_us, payload start, payload end) of a whole record at ``position``."""
    start = position + HEAD.size
    if start + CRC.size > len(data):
        return None
    marker, kind, _, length, seq, time_ns, unix_us = HEAD.unpack_from(data, position)
    end = start + length
    if marker != MARKER or length > MAX_PAYLOAD or end + CRC.size > len(data):
        return None
    if zlib.crc32(memoryview(data)[position:end]) != CRC.unpack_from(data, end)[0]:
        return None
    return kind, seq, time_ns, unix_us, start, end


def _next_record(data: bytes, position: int) -> int | None:
    """Where the next whole record begins at or behind ``position``."""
    while (position := data.find(MARKER, position)) >= 0:
        if _record_at(data, position) is not None:
            return position
        position += 1
    return None
