"""What the classifier is asked and what it answers.

Rule kept here: plain frozen values, so that the engine needs nothing of the network.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True, eq=False)
class ChannelCapture:
    """One channel impulse response of a link."""

    magnitude: ArrayLike
    """(taps,) linear magnitudes, any scale."""
    tap_spacing_ns: float
    first_path_index: float | None = None
    """Taps from the window's start; None = find the leading edge ourselves."""


class VerdictStatus(StrEnum):
    """Whether a link's responses could be judged."""

    CLASSIFIED = "classified"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Verdict:
    """P(line of sight) of one link."""

    los_probability: float
    """Calibrated; the prior where the status is ``unknown``. Six decimals."""
    status: VerdictStatus
    reason: str
    """Why a link is unknown, or which of its captures were left out; else empty."""
    captures_used: int
    """Captures that the probability rests on."""


class UnusableCaptureError(ValueError):
    """A capture cannot be judged; the message says why."""


def as_magnitude(capture: ChannelCapture) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """(taps,) float64 of a capture. Raises UnusableCaptureError on anything but a finite vector."""
    try:
        magnitude = np.asarray(capture.magnitude, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UnusableCaptureError("magnitudes are not numbers") from error
    if magnitude.ndim != 1:
        raise UnusableCaptureError(f"magnitudes have {magnitude.ndim} dimensions; one is needed")
    if not np.all(np.isfinite(magnitude)):
        raise UnusableCaptureError("magnitudes are not finite")
    if np.any(magnitude < 0):
        raise UnusableCaptureError("magnitudes are negative")
    return magnitude.reshape(-1)
