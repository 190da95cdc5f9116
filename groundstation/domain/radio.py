"""Radio evidence: a capture of a channel, and the averaged window of one link.

A link is one vehicle hearing one beacon. Angles here are the paper's: radians, azimuth
counter-clockwise from east, elevation positive up from the horizontal plane, pointing from
the vehicle to the beacon.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from groundstation.domain.geometry import Geodetic, Quaternion
from groundstation.domain.vehicle import PlaceAccuracy


@dataclass(frozen=True, slots=True, eq=False)
class CirCapture:
    """One channel impulse response, put together from its fragments."""

    time_ns: int
    """Station time of the capture."""
    capture_id: int
    magnitude: NDArray[np.float32]
    """(taps,) linear magnitudes, any scale."""
    tap_spacing_ns: float
    first_path_index: float | None
    """Taps from the window's start; None = unknown."""
    first_tap: int
    """The window's first tap in the full response."""


class CloseReason(StrEnum):
    """Why a window was closed."""

    FULL = "full"
    """M samples."""
    AGE = "age"
    DISTANCE = "distance"
    """The vehicle had flown as far as one window may cover."""
    END = "end"
    """The recording or the session ended."""


@dataclass(frozen=True, slots=True, eq=False)
class LinkWindow:
    """M samples of one link averaged: one vehicle, one beacon, one place.

    Power is averaged in milliwatts, angles on the circle; the standard errors are those of
    the averages. A quantity that no valid sample gave is None.
    """

    vehicle_id: int
    beacon_id: int
    start_ns: int
    """Station time of the first sample."""
    end_ns: int
    """Station time of the last sample."""
    position: Geodetic
    """Mean of the vehicle's interpolated positions at the samples."""
    attitude: Quaternion
    """Attitude at the sample nearest to the middle."""
    path_length_m: float
    """How far the vehicle flew within the window."""
    rss_dbm: float | None
    rss_std_error_db: float | None
    """From the scatter of the samples; None with one sample."""
    rss_count: int
    noise_dbm: float | None
    frequency_hz: int | None
    missed_count: int
    """Packets that the beacon's sequence counter says were sent to us and lost."""
    azimuth_rad: float | None
    azimuth_std_error_rad: float | None
    elevation_rad: float | None
    elevation_std_error_rad: float | None
    aoa_count: int
    captures: tuple[CirCapture, ...]
    """Oldest first."""
    sensor_los_probability: float | None
    """What an on-board classifier says (SAR_LINK_STATE), newest."""
    close_reason: CloseReason
    place_accuracy: PlaceAccuracy | None = None
    """What the vehicle says of ``position``; None: nothing."""

    @property
    def key(self) -> tuple[int, int, int]:
        """(vehicle, beacon, end): names the window in drops and logs."""
        return self.vehicle_id, self.beacon_id, self.end_ns


@dataclass(frozen=True, slots=True)
class LinkActivity:
    """A sample came in on a link: for the operator's eyes, not for estimation."""

    vehicle_id: int
    beacon_id: int
    time_ns: int
    rss_dbm: float | None
    noise_dbm: float | None
    samples_total: int
    captures_total: int
    captures_incomplete_total: int


@dataclass(frozen=True, slots=True)
class Listener:
    """One vehicle that listened for a while: its sensor lived, and its place was known."""

    vehicle_id: int
    position: Geodetic
    """In the middle of the interval."""
    packets: tuple[tuple[int, int], ...]
    """(beacon_id, packets) heard, by beacon; a beacon that is missing was not heard."""


@dataclass(frozen=True, slots=True)
class Listening:
    """Who listened where during one interval, and what was heard: what silence is read from."""

    start_ns: int
    end_ns: int
    """Station time; intervals of a run stand side by side."""
    listeners: tuple[Listener, ...]
    """By vehicle; one that is missing was not listening, as far as is known."""
