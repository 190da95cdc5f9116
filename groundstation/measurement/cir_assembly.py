"""Puts impulse responses together from their fragments, and decodes their taps.

Why: a full response is five frames, MAVLink does not send again, and frames arrive late, twice
or never. A capture is complete or it is nothing: a response with a hole would be a lie about
the channel. Each way to fail has a name and a counter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.domain.radio import CirCapture
from groundstation.mavlink.messages import CirFragment
from groundstation.measurement.settings import MeasurementSettings

_FINISHED_KEPT = 64


class Encoding(IntEnum):
    """How the taps of SAR_CIR are written."""

    U8_LOG_MAGNITUDE = 0
    U16_MAGNITUDE = 1
    I8_IQ = 2


BYTES_PER_TAP = {Encoding.U8_LOG_MAGNITUDE: 1, Encoding.U16_MAGNITUDE: 2, Encoding.I8_IQ: 2}


class CirOutcome(StrEnum):
    """What became of a fragment or of a capture; each is a counter ``<name>_total``."""

    DUPLICATE = "cir_fragment_duplicate"
    """The fragment, or the whole capture, was already here."""
    MISMATCH = "cir_fragment_mismatch"
    """The fragment contradicts those of the same capture."""
    BAD_METADATA = "cir_bad_metadata"
    """Unknown encoding, or tap spacing, scale or counts that cannot be."""
    BAD_LAYOUT = "cir_bad_layout"
    """The fragments do not fill the capture exactly."""
    EMPTY = "cir_empty"
    """All taps are zero."""
    INCOMPLETE = "cir_incomplete"
    """Given up: fragments missing after the time-out, or room needed for newer captures."""
    COMPLETE = "cir_complete"


def decode_taps(data: bytes, encoding: int, scale: float, tap_count: int) -> NDArray[np.float32]:
    """Linear magnitudes (taps,) of a capture's bytes, any common scale.

    ``U8_LOG_MAGNITUDE``: 10^(−value · scale / 20), the peak being 1; ``U16_MAGNITUDE``: value ·
    scale; ``I8_IQ``: |I + jQ| · scale. Raises ``ValueError`` for an unknown encoding or where
    the bytes are not ``tap_count`` taps.
    """
    kind = Encoding(encoding)
    if len(data) != tap_count * BYTES_PER_TAP[kind]:
        raise ValueError(f"{len(data)} bytes are not {tap_count} taps of {kind.name}")
    if kind is Encoding.U8_LOG_MAGNITUDE:
        steps = np.frombuffer(data, dtype=np.uint8).astype(np.float64)
        return np.power(10.0, steps * (-scale / 20.0)).astype(np.float32)
    if kind is Encoding.U16_MAGNITUDE:
        return (np.frombuffer(data, dtype="<u2").astype(np.float64) * scale).astype(np.float32)
    pairs = np.frombuffer(data, dtype=np.int8).astype(np.float64).reshape(-1, 2)
    return (np.hypot(pairs[:, 0], pairs[:, 1]) * scale).astype(np.float32)


@dataclass(slots=True)
class _Partial:
    beacon_id: int
    capture_id: int
    time_usec: int
    tap_spacing_ns: float
    scale: float
    first_path_index: float | None
    first_tap: int
    tap_count: int
    fragment_count: int
    encoding: int
    station_ns: int
    """Station time of the capture, mapped when its first fragment came."""
    begun_ns: int
    pieces: dict[int, tuple[int, bytes]]

    def agrees(self, f: CirFragment) -> bool:
        return (
            f.time_usec == self.time_usec
            and f.tap_count == self.tap_count
            and f.first_tap == self.first_tap
            and f.fragment_count == self.fragment_count
            and f.encoding == self.encoding
            and f.scale == self.scale
            and f.tap_spacing_ns == self.tap_spacing_ns
        )


class CirAssembler:
    """Captures under way of one vehicle's sensor, by (beacon, capture id)."""

    __slots__ = ("_finished", "_limit", "_partials", "_timeout_ns", "given_up")

    def __init__(self, settings: MeasurementSettings) -> None:
        self._timeout_ns = round(settings.cir_timeout_s * 1e9)
        self._limit = max(1, settings.cir_in_flight)
        self._partials: dict[tuple[int, int], _Partial] = {}
        self._finished: dict[tuple[int, int, int], None] = {}
        self.given_up: list[int] = []
        """Beacons of the captures given up since the caller last looked; the caller empties it."""

    def add(self, fragment: CirFragment, station_ns: int, arrival_ns: int) -> CirCapture | CirOutcome | None:
        """Take a fragment in: the capture it completes, why it was refused, or None (more to come)."""
        if not _sane(fragment):
            return CirOutcome.BAD_METADATA
        key = (fragment.beacon_id, fragment.capture_id)
        if (*key, fragment.time_usec) in self._finished:
            return CirOutcome.DUPLICATE
        partial = self._partials.get(key)
        if partial is not None and not partial.agrees(fragment):
            if fragment.time_usec <= partial.time_usec:
                return CirOutcome.MISMATCH
            # The sensor's counter came round, or it was restarted: the newer capture wins.
            self._give_up(key)
            partial = None
        if partial is None:
            if len(self._partials) >= self._limit:
                self._give_up(next(iter(self._partials)))
            partial = self._partials[key] = _begin(fragment, station_ns, arrival_ns)
        piece = (fragment.offset, fragment.data)
        known = partial.pieces.get(fragment.fragment)
        if known is not None:
            return CirOutcome.DUPLICATE if known == piece else CirOutcome.MISMATCH
        partial.pieces[fragment.fragment] = piece
        if len(partial.pieces) < partial.fragment_count:
            return None
        del self._partials[key]
        self._remember(key, partial.time_usec)
        return _assembled(partial)

    def tick(self, now_ns: int) -> None:
        """Give up the captures whose time is over; they are found in ``given_up``."""
        # Insertion order is the order of ``begun_ns``, so the first that is young ends the search.
        while self._partials:
            key, partial = next(iter(self._partials.items()))
            if now_ns - partial.begun_ns < self._timeout_ns:
                return
            self._give_up(key)

    def clear(self) -> int:
        """Forget all captures under way; returns how many there were."""
        forgotten = len(self._partials)
        self._partials.clear()
        self._finished.clear()
        return forgotten

    def _give_up(self, key: tuple[int, int]) -> None:
        partial = self._partials.pop(key)
        self._remember(key, partial.time_usec)
        self.given_up.append(partial.beacon_id)

    def _remember(self, key: tuple[int, int], time_usec: int) -> None:
        self._finished[(*key, time_usec)] = None
        if len(self._finished) > _FINISHED_KEPT:
            del self._finished[next(iter(self._finished))]

    def state(self) -> dict[str, Any]:
        """Everything, as a tree for a snapshot."""
        return {
            "partials": [
                {
                    **{name: getattr(p, name) for name in _Partial.__slots__ if name != "pieces"},
                    "pieces": [[index, offset, data] for index, (offset, data) in p.pieces.items()],
                }
                for p in self._partials.values()
            ],
            "finished": [list(key) for key in self._finished],
            "given_up": list(self.given_up),
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state()`` gave."""
        self._partials = {}
        for kept in tree["partials"]:
            pieces = {index: (offset, data) for index, offset, data in kept["pieces"]}
            self._partials[kept["beacon_id"], kept["capture_id"]] = _Partial(**{**kept, "pieces": pieces})
        self._finished = {(key[0], key[1], key[2]): None for key in tree["finished"]}
        self.given_up = list(tree["given_up"])


def _sane(f: CirFragment) -> bool:
    if f.encoding not in BYTES_PER_TAP or f.tap_count < 1 or not 0 <= f.fragment < f.fragment_count:
        return False
    if not (math.isfinite(f.tap_spacing_ns) and f.tap_spacing_ns > 0.0):
        return False
    if not (math.isfinite(f.scale) and f.scale > 0.0):
        return False
    total = f.tap_count * BYTES_PER_TAP[Encoding(f.encoding)]
    return len(f.data) > 0 and f.offset + len(f.data) <= total


def _begin(f: CirFragment, station_ns: int, arrival_ns: int) -> _Partial:
    first_path = f.first_path_index
    if first_path is not None and not (math.isfinite(first_path) and 0.0 <= first_path < f.tap_count):
        first_path = None
    return _Partial(
        f.beacon_id,
        f.capture_id,
        f.time_usec,
        f.tap_spacing_ns,
        f.scale,
        first_path,
        f.first_tap,
        f.tap_count,
        f.fragment_count,
        f.encoding,
        station_ns,
        arrival_ns,
        {},
    )


def _assembled(p: _Partial) -> CirCapture | CirOutcome:
    data = bytearray()
    for offset, piece in sorted(p.pieces.values()):
        if offset != len(data):
            return CirOutcome.BAD_LAYOUT
        data += piece
    if len(data) != p.tap_count * BYTES_PER_TAP[Encoding(p.encoding)]:
        return CirOutcome.BAD_LAYOUT
    magnitude = decode_taps(bytes(data), p.encoding, p.scale, p.tap_count)
    if not magnitude.any():
        return CirOutcome.EMPTY
    if not np.isfinite(magnitude).all():
        return CirOutcome.BAD_METADATA
    magnitude.setflags(write=False)
    return CirCapture(
        p.station_ns, p.capture_id, magnitude, p.tap_spacing_ns, p.first_path_index, p.first_tap
    )
