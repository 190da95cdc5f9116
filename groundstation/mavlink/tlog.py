"""``.tlog`` files: what every other ground station reads and writes.

A record is 8 bytes of big-endian Unix microseconds, then one raw frame. A recording that stops
within a record is normal (power went, disk full): it ends there. Bytes that are no record are an
error that says where.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from struct import Struct
from types import TracebackType

from groundstation.domain.errors import InputError, ResourceError
from groundstation.mavlink.framing import MAGIC_V1, MAGIC_V2, SIGNATURE_LENGTH, SIGNED_FLAG

_TIME = Struct(">Q")
_CHUNK = 1 << 18
_LATEST_US = 253_402_300_800_000_000
"""Year 10000: a later time is none."""


class TlogReader:
    """Iterates over the (unix_us, frame) records of one file, once.

    Raises InputError where the file is missing or holds something else; ``truncated_bytes`` says
    after the end how much of a last record was there.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.records = 0
        """Whole records read so far."""
        self.position = 0
        """Byte of the file where the next record begins."""
        self.truncated_bytes = 0
        """Of the last record, whose rest is missing; 0: the file ends with a whole one."""

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        try:
            file = self.path.open("rb")
        except OSError as error:
            raise InputError(f"cannot read {self.path}: {error.strerror}") from error
        with file:
            buffer = b""
            offset = 0
            while True:
                length = self._record_length(buffer, offset)
                if length is None or len(buffer) - offset < length:
                    chunk = file.read(_CHUNK)
                    if not chunk:
                        break
                    buffer = buffer[offset:] + chunk
                    offset = 0
                    continue
                unix_us = _TIME.unpack_from(buffer, offset)[0]
                frame = buffer[offset + 8 : offset + length]
                offset += length
                self.position += length
                self.records += 1
                yield unix_us, frame
            self.truncated_bytes = len(buffer) - offset
        if not self.records:
            raise InputError(f"{self.path} holds no MAVLink frame: {self._needed()}")

    def _record_length(self, buffer: bytes, offset: int) -> int | None:
        """Bytes of the record that begins at ``offset``; None where too little is there to say."""
        available = len(buffer) - offset
        if available >= 8 and _TIME.unpack_from(buffer, offset)[0] >= _LATEST_US:
            raise self._garbage(buffer, offset)
        if available < 9:
            return None
        magic = buffer[offset + 8]
        if magic not in (MAGIC_V1, MAGIC_V2):
            raise self._garbage(buffer, offset)
        if available < 11:
            return None
        payload = buffer[offset + 9]
        if magic == MAGIC_V1:
            return 8 + 8 + payload
        return 8 + 12 + payload + (SIGNATURE_LENGTH if buffer[offset + 10] & SIGNED_FLAG else 0)

    def _garbage(self, buffer: bytes, offset: int) -> InputError:
        seen = buffer[offset : offset + 12].hex(" ")
        return InputError(f"{self.path} is damaged at byte {self.position}: saw {seen}; {self._needed()}")

    @staticmethod
    def _needed() -> str:
        return "a .tlog record is 8 bytes of big-endian Unix microseconds and a MAVLink frame (fd … or fe …)"


def read_tlog(path: Path | str) -> TlogReader:
    """The (unix_us, frame) records of ``path``, in file order. Errors as in TlogReader."""
    return TlogReader(path)


class TlogWriter:
    """Appends records to a file; made new, or continued with ``append``."""

    def __init__(self, path: Path | str, append: bool = False) -> None:
        self.path = Path(path)
        self.records = 0
        try:
            self._file = self.path.open("ab" if append else "wb")
        except OSError as error:
            raise ResourceError(f"cannot write {self.path}: {error.strerror}") from error

    def write(self, unix_us: int, frame: bytes) -> None:
        """Adds one frame. Raises ResourceError where the disk refuses."""
        try:
            self._file.write(_TIME.pack(unix_us) + frame)
        except OSError as error:
            raise ResourceError(f"cannot write {self.path}: {error.strerror}") from error
        self.records += 1

    def flush(self) -> None:
        """Hands what was written to the system."""
        try:
            self._file.flush()
        except OSError as error:
            raise ResourceError(f"cannot write {self.path}: {error.strerror}") from error

    def close(self) -> None:
        """Flushes and closes."""
        try:
            self._file.close()
        except OSError as error:
            raise ResourceError(f"cannot write {self.path}: {error.strerror}") from error

    def __enter__(self) -> TlogWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
