"""Samples that wait for a pose: mapped to station time, not placed yet."""

from __future__ import annotations

from typing import Any, NamedTuple

from groundstation.domain.radio import CirCapture
from groundstation.measurement.link_window import capture_of, capture_state


class WaitingRss(NamedTuple):
    time_ns: int
    arrival_ns: int
    beacon_id: int
    rss_dbm: float
    noise_dbm: float | None
    frequency_hz: int


class WaitingAoa(NamedTuple):
    time_ns: int
    arrival_ns: int
    beacon_id: int
    azimuth_rad: float
    elevation_rad: float
    azimuth_std_rad: float | None
    elevation_std_rad: float | None
    body_frame: bool


class WaitingCir(NamedTuple):
    time_ns: int
    arrival_ns: int
    beacon_id: int
    capture: CirCapture


Waiting = WaitingRss | WaitingAoa | WaitingCir


def sample_state(sample: Waiting) -> list[Any]:
    if isinstance(sample, WaitingCir):
        return ["cir", *sample[:3], capture_state(sample.capture)]
    return ["rss" if isinstance(sample, WaitingRss) else "aoa", *sample]


def sample_of(kept: list[Any]) -> Waiting:
    kind, *fields = kept
    if kind == "cir":
        return WaitingCir(fields[0], fields[1], fields[2], capture_of(fields[3]))
    return WaitingRss(*fields) if kind == "rss" else WaitingAoa(*fields)
