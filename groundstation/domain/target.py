"""What is believed of a beacon and its links."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum

from groundstation.domain.geometry import Geodetic
from groundstation.domain.mission import Ring

Covariance = tuple[float, float, float, float, float, float]
"""Upper triangle of a symmetric 3 × 3, row-major: EE, EN, EU, NN, NU, UU, m²."""


class Environment(IntEnum):
    """Algorithm 1's environments; the numbers are those of SAR_TARGET_ESTIMATE."""

    UNKNOWN = 0
    LOS = 1
    MIXED = 2
    NLOS = 3


class LosSource(StrEnum):
    """Who says whether a link is line-of-sight."""

    CLASSIFIER = "classifier"
    """Our model, from the link's impulse responses."""
    SENSOR = "sensor"
    """An on-board classifier (SAR_LINK_STATE)."""
    PRIOR = "prior"
    """Nobody: the prior from the settings. The link is shown as unclassified."""


@dataclass(frozen=True, slots=True)
class LinkVerdict:
    """P(line of sight) of one link, from one window."""

    vehicle_id: int
    beacon_id: int
    time_ns: int
    los_probability: float
    source: LosSource
    reason: str
    """Why it could not be classified; empty when it was."""
    rss_dbm: float | None
    azimuth_rad: float | None
    elevation_rad: float | None
    captures: int


@dataclass(frozen=True, slots=True)
class SnapshotEstimate:
    """Algorithm 1's answer from the newest window of each vehicle."""

    time_ns: int
    position: Geodetic
    covariance_enu_m2: Covariance
    environment: Environment
    method: str
    transmit_power_dbm: float | None
    path_loss_exponent: tuple[float, ...]
    """One a link, in the order of ``vehicle_ids``."""
    vehicle_ids: tuple[int, ...]
    los_vehicle_ids: tuple[int, ...]
    status: str
    """``ok`` or what the solver says."""


@dataclass(frozen=True, slots=True)
class TargetState:
    """Where a beacon is believed to be, given everything heard so far."""

    beacon_id: int
    time_ns: int
    """Station time of this belief."""
    first_heard_ns: int
    last_heard_ns: int
    position: Geodetic
    covariance_enu_m2: Covariance
    radius_90_m: float
    """Horizontal: the circle round ``position`` that holds 90 % of the belief."""
    environment: Environment
    los_links: int
    links: int
    windows: int
    """Link windows taken in so far."""
    method: str
    height_reference: str
    """``terrain``, ``home``, ``settings`` or ``unknown``: what height limits are measured from."""
    sequence: int
    """Counts this beacon's updates."""
    snapshot: SnapshotEstimate | None
    """The newest Algorithm 1 answer, beside the tracked belief for comparison."""
    regions: tuple[tuple[float, tuple[Ring, ...]], ...] = ()
    """Highest-density regions: share of the belief (0.5, 0.9, 0.95) and its rings, outer ones and
    holes under the even–odd rule; empty when none were computed for this update."""


@dataclass(frozen=True, slots=True)
class TargetWaiting:
    """A beacon is heard, but not enough for an estimate yet."""

    beacon_id: int
    time_ns: int
    first_heard_ns: int
    links: int
    needed: str
    """What is missing, in the operator's words."""
