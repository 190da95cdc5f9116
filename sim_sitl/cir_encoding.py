"""A capture as SAR_CIR fragments, as a sensor's firmware would send it.

Why: written from the interface alone and not from the station's decoder, so that the two
check each other. Rule kept here: each encoding is what the dialect says, byte for byte; the
caller adds time, beacon and addresses.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

MAX_DATA_BYTES = 212
"""Data bytes of one SAR_CIR frame."""
TUNNEL_DATA_BYTES = 86
"""Data bytes of a SAR_CIR wrapped in TUNNEL."""
WINDOW_TAPS = 64
"""Taps of the window round the first path that fits one frame."""
WINDOW_LEAD_TAPS = 8
"""Of them before the first path."""
LOG_STEP_DB = 0.25
"""Step of the logarithmic encoding: 255 steps are 63.75 dB below the peak."""


class CirEncoding(IntEnum):
    """SAR_CIR ``encoding``."""

    U8_LOG_MAGNITUDE = 0
    U16_MAGNITUDE = 1
    I8_IQ = 2


class SarCirFields(TypedDict):
    """The fields of one SAR_CIR message that the capture decides; ``data`` padded to 212 bytes."""

    tap_spacing_ns: float
    scale: float
    first_path_index: float
    capture_id: int
    first_tap: int
    tap_count: int
    offset: int
    fragment: int
    fragment_count: int
    encoding: int
    length: int
    data: bytes


def window_round_first_path(
    full_taps: int, first_path_tap: float, taps: int = WINDOW_TAPS, lead_taps: int = WINDOW_LEAD_TAPS
) -> tuple[int, int]:
    """(first tap, tap count) of a window of ``taps`` that begins ``lead_taps`` before the first path."""
    count = min(taps, full_taps)
    first = round(first_path_tap) - lead_taps
    return min(max(first, 0), full_taps - count), count


def encode_capture(
    response: NDArray[np.complex128] | NDArray[np.float64],
    *,
    encoding: CirEncoding,
    tap_spacing_ns: float,
    capture_id: int,
    first_tap: int = 0,
    first_path_index: float | None = None,
    max_data_bytes: int = MAX_DATA_BYTES,
) -> list[SarCirFields]:
    """Encode (taps,) of one capture, complex or magnitudes, into the fields of its fragments.

    ``first_tap`` is the window's first tap in the full response, ``first_path_index`` counts
    taps from the window's start (None: unknown). Magnitudes cannot be sent as I8_IQ.
    """
    scale, payload = quantise(response, encoding)
    # Fragments hold whole taps, so that a receiver may use what arrived.
    step = max_data_bytes - max_data_bytes % 2
    chunks = [payload[start : start + step] for start in range(0, len(payload), step)]
    return [
        SarCirFields(
            tap_spacing_ns=tap_spacing_ns,
            scale=scale,
            first_path_index=float("nan") if first_path_index is None else first_path_index,
            capture_id=capture_id % 65536,
            first_tap=first_tap,
            tap_count=len(response),
            offset=index * step,
            fragment=index,
            fragment_count=len(chunks),
            encoding=int(encoding),
            length=len(chunk),
            data=chunk.ljust(MAX_DATA_BYTES, b"\0"),
        )
        for index, chunk in enumerate(chunks)
    ]


def quantise(
    response: NDArray[np.complex128] | NDArray[np.float64], encoding: CirEncoding
) -> tuple[float, bytes]:
    """(scale, bytes) of a whole capture in one encoding."""
    if encoding is CirEncoding.I8_IQ:
        if not np.iscomplexobj(response):
            raise ValueError("I8_IQ needs a complex response")
        parts = np.stack([response.real, response.imag], axis=1)
        scale = _float32(float(np.max(np.abs(parts))) / 127 or 1.0)
        return scale, np.clip(np.rint(parts / scale), -127, 127).astype(np.int8).tobytes()
    magnitude = np.abs(response)
    peak = float(np.max(magnitude))
    if encoding is CirEncoding.U16_MAGNITUDE:
        scale = _float32(peak / 65535 or 1.0)
        return scale, np.clip(np.rint(magnitude / scale), 0, 65535).astype("<u2").tobytes()
    floor = max(peak, 1e-300) * 1e-9
    below_peak_db = -20 * np.log10(np.maximum(magnitude, floor) / max(peak, floor))
    return LOG_STEP_DB, np.clip(np.rint(below_peak_db / LOG_STEP_DB), 0, 255).astype(np.uint8).tobytes()


def _float32(value: float) -> float:
    """As the wire's float carries it, so that counts and scale belong together."""
    return float(np.float32(value))
