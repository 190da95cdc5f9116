"""Bytes in, whole MAVLink frames out: every frame that leaves here has had its CRC verified.

The rules kept here:

- chunks may have any size and the frames do not depend on how the stream was cut;
- payloads are never decoded: most frames are wanted by nobody;
- after a bad CRC the search goes on one byte later, so a good frame inside is never lost;
- a frame of an unknown id cannot be verified (its CRC_EXTRA is missing). It is kept apart
  (``take_unverified``), and only where the next frame begins at its end and no verified frame
  begins inside it; nothing is learned from it.

Signatures (13 bytes behind the CRC) are measured, not judged: ``Frame.signed`` and ``Frame.raw``
are what a verifier needs.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from fastcrc import crc16

from groundstation.domain.errors import PeerError
from groundstation.mavlink.catalogue import CATALOGUE
from groundstation.mavlink.duplicates import DuplicateFilter
from groundstation.mavlink.statistics import LinkStatistics

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
SIGNED_FLAG = 0x01
SIGNATURE_LENGTH = 13
MAX_UNVERIFIED = 64
"""Unverified frames kept for ``take_unverified``; older ones go, counted."""

_crc: Callable[[bytes], int] = crc16.mcrf4xx
_find_magic = re.compile(b"[\xfd\xfe]").search
_CRC_EXTRA: dict[int, bytes] = {info.message_id: bytes((info.crc_extra,)) for info in CATALOGUE.values()}
_new_frame = tuple.__new__
_BASE_LENGTH: dict[int, int] = {info.message_id: info.base_length for info in CATALOGUE.values()}


class Frame(NamedTuple):
    """One whole frame, header read, payload untouched. Immutable."""

    raw: bytes
    """All of it, from the magic byte to the CRC or the signature."""
    system_id: int
    component_id: int
    message_id: int
    sequence: int
    signed: bool
    """Carries a signature, which nobody has verified here."""

    @property
    def payload(self) -> bytes:
        """The payload as sent, its trailing zeros cut (MAVLink 2)."""
        raw = self.raw
        if raw[0] == MAGIC_V2:
            return raw[10 : 10 + raw[1]]
        return raw[6 : 6 + raw[1]]


class Framer:
    """Finds the frames of one byte stream: one radio, or one peer behind a UDP socket.

    ``duplicates`` may be shared between framers: then a frame that came over another link
    already is dropped here, and counted. Without it nothing is dropped.
    """

    def __init__(
        self, duplicates: DuplicateFilter | None = None, statistics: LinkStatistics | None = None
    ) -> None:
        self.statistics = statistics if statistics is not None else LinkStatistics()
        self._duplicates = duplicates
        self._rest = b""
        self._scanned = 0
        """Bytes of the rest that begin no verified frame."""
        self._unknown_end: int | None = None
        """Where in the rest a frame of unknown id would end that begins at its first byte."""
        self._unverified: deque[bytes] = deque()

    @property
    def pending_bytes(self) -> int:
        """Bytes kept for the next chunk: fewer than three frames' worth."""
        return len(self._rest)

    def take_unverified(self) -> list[bytes]:
        """Whole frames of unknown ids since the last call, to be passed on raw, never decoded."""
        taken = list(self._unverified)
        self._unverified.clear()
        return taken

    def feed(self, chunk: bytes) -> list[Frame]:
        """Verified frames that ``chunk`` completes, in order. Never raises, whatever the bytes."""
        statistics = self.statistics
        statistics.received_bytes += len(chunk)
        buffer = self._rest + chunk if self._rest else bytes(chunk)
        size = len(buffer)
        position = self._scanned
        unknown_end = self._unknown_end
        # Bytes before this are accounted for; a pending unknown frame begins here.
        settled = 0
        frames: list[Frame] = []
        duplicates = self._duplicates
        while position < size:
            magic = buffer[position]
            if unknown_end is not None and position >= unknown_end:
                if position == unknown_end and magic in (MAGIC_V2, MAGIC_V1):
                    self._accept_unknown(buffer[settled:position])
                    settled = position
                unknown_end = None
            if magic == MAGIC_V2:
                if size - position < 12:
                    break
                signed = buffer[position + 2] == SIGNED_FLAG
                if buffer[position + 2] and not signed:
                    # Incompatibility flags that nobody has defined: not a frame we may read.
                    position += 1
                    continue
                end_of_payload = position + 10 + buffer[position + 1]
                end = end_of_payload + (2 + SIGNATURE_LENGTH if signed else 2)
                message_id = buffer[position + 7] | buffer[position + 8] << 8 | buffer[position + 9] << 16
                extra = _CRC_EXTRA.get(message_id)
                if extra is None:
                    if unknown_end is None:
                        statistics.garbage_bytes += position - settled
                        settled = position
                        unknown_end = end
                    position += 1
                    continue
                header = position + 4
            elif magic == MAGIC_V1:
                if size - position < 8:
                    break
                message_id = buffer[position + 5]
                length = buffer[position + 1]
                # MAVLink 1 never cuts zeros: the length must be the message's own, which spares us
                # waiting for the end of most frames that are none.
                if _BASE_LENGTH.get(message_id) != length:
                    position += 1
                    continue
                signed = False
                extra = _CRC_EXTRA[message_id]
                end_of_payload = position + 6 + length
                end = end_of_payload + 2
                header = position + 2
            else:
                found = _find_magic(buffer, position)
                position = found.start() if found else size
                continue
            if end > size:
                break
            system_id = buffer[header + 1]
            component_id = buffer[header + 2]
            crc = buffer[end_of_payload] | buffer[end_of_payload + 1] << 8
            if _crc(buffer[position + 1 : end_of_payload] + extra) != crc:
                heard = statistics.known(system_id, component_id)
                if heard is None:
                    statistics.crc_failures_unattributed += 1
                else:
                    heard.crc_failures += 1
                position += 1
                continue
            statistics.garbage_bytes += position - settled
            unknown_end = None
            raw = buffer[position:end]
            settled = position = end
            source = statistics.source(system_id, component_id)
            statistics.verified_frames += 1
            if duplicates is not None and duplicates.is_duplicate(raw, self):
                source.duplicates += 1
                continue
            sequence = raw[4 if magic == MAGIC_V2 else 2]
            source.received += 1
            if source.last_sequence is not None and sequence == (source.last_sequence + 1) & 0xFF:
                source.last_sequence = sequence
            else:
                source.take_sequence(sequence)
            frames.append(_new_frame(Frame, (raw, system_id, component_id, message_id, sequence, signed)))
        if unknown_end is None or position > unknown_end:
            unknown_end = None
            statistics.garbage_bytes += position - settled
            settled = position
        self._rest = buffer[settled:]
        self._scanned = position - settled
        self._unknown_end = None if unknown_end is None else unknown_end - settled
        return frames

    def _accept_unknown(self, raw: bytes) -> None:
        # Its header is as unverified as the rest: it may add to what is known of a source that has
        # been heard, and must not invent one.
        source = self.statistics.known(raw[5], raw[6])
        if source is not None:
            source.take_sequence(raw[4])
            source.unknown += 1
        else:
            self.statistics.unknown_unattributed += 1
        if len(self._unverified) >= MAX_UNVERIFIED:
            self._unverified.popleft()
            self.statistics.unverified_dropped += 1
        self._unverified.append(raw)


def frame_of(raw: bytes) -> Frame:
    """The header of a frame that a Framer verified once (from the journal, from a file).

    Raises PeerError where the bytes are not one whole frame; the CRC is not looked at again.
    """
    size = len(raw)
    if size >= 12 and raw[0] == MAGIC_V2:
        signed = bool(raw[2] & SIGNED_FLAG)
        if size == 12 + raw[1] + (SIGNATURE_LENGTH if signed else 0):
            message_id = raw[7] | raw[8] << 8 | raw[9] << 16
            return _new_frame(Frame, (raw, raw[5], raw[6], message_id, raw[4], signed))
    elif size >= 8 and raw[0] == MAGIC_V1 and size == 8 + raw[1]:
        return _new_frame(Frame, (raw, raw[3], raw[4], raw[5], raw[2], False))
    shown = raw[:12].hex(" ")
    raise PeerError(f"not one whole MAVLink frame: {size} bytes that begin with {shown or 'nothing'}")
