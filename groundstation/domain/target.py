"""What is believed of a beacon and its links."""

from __future__ import annotations

import math
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
    walking_probability: float | None = None
    """P(the person walks), given what was heard; None: not asked."""
    joined_beacon_ids: tuple[int, ...] = ()
    """Other ids of the same transmitter, as the operator said: their windows count here."""
    vehicle_position_std_m: float = 0.0
    """What the vehicles' own places leave unsure of it, each horizontal axis: no flight lessens it."""

    @property
    def least_radius_90_m(self) -> float:
        """What no flight gets its 90 % radius under."""
        return self.vehicle_position_std_m * math.sqrt(-2.0 * math.log(0.1))


@dataclass(frozen=True, slots=True)
class TargetWaiting:
    """A beacon is heard, but not enough for an estimate yet."""

    beacon_id: int
    time_ns: int
    first_heard_ns: int
    links: int
    needed: str
    """What is missing, in the operator's words."""


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one vehicle brought to a belief, and how well it agrees with it."""

    vehicle_id: int
    weight: float
    """Share, 0 to 1, of the information about the place that it brought; all add up to 1."""
    area_factor: float
    """Without its windows the space where the beacon may be were so many times as large; below 1: it
    contradicts the others."""
    windows: int
    """Link windows taken in, since the first."""
    redundant: int
    """Not taken in: from a place already heard from often enough."""
    outliers: int
    """Taken in with less weight: implausible at every likely place."""
    power_residual_db: float | None
    """How much stronger it hears the beacon than the estimate explains (weaker: negative), dB."""
    power_score: float | None
    """The same in standard deviations: beyond ±2 is unusual, beyond ±3 does not fit."""
    azimuth_residual_deg: float | None
    """How far its bearing points to the right of the estimate (left: negative), degrees."""
    azimuth_score: float | None
    """The same in standard deviations."""
    elevation_residual_deg: float | None
    """How far its bearing points above the estimate (below: negative), degrees."""
    elevation_score: float | None
    """The same in standard deviations."""
    los_probability: float | None
    """Mean P(line of sight) of its windows as far as they are remembered; None: nobody judged them."""


@dataclass(frozen=True, slots=True)
class TargetExplanation:
    """Why a belief is what it is: "why do you think so?"."""

    beacon_id: int
    time_ns: int
    """Station time of the belief that is explained."""
    sequence: int
    """Of its ``TargetState``."""
    contributions: tuple[Contribution, ...]
    """By vehicle."""


@dataclass(frozen=True, slots=True)
class SearchMap:
    """Where a beacon could be, as a raster: squares of a plane that touches WGS84 at ``origin``."""

    beacon_id: int
    time_ns: int
    """Station time of the belief that was drawn."""
    sequence: int
    """Of the ``TargetState`` that it belongs to."""
    origin: Geodetic
    """Of the plane: east and north are counted from here."""
    west_m: float
    """East coordinate of the western edge."""
    north_m: float
    """North coordinate of the northern edge."""
    cell_m: float
    """Side of a square, metres."""
    rows: int
    columns: int
    corners: Ring
    """(latitude_deg, longitude_deg) of the outer corners: north-west, north-east, south-east, south-west."""
    share: bytes
    """Share of the belief in each square: little-endian float32, row by row from the north-west."""
    containment: bytes
    """For each square the share of the belief in the squares that are at least as likely, in units of
    0.0001: little-endian uint16, in the same order. The squares up to 9000 are where 90 % lie."""


@dataclass(frozen=True, slots=True)
class TargetJoined:
    """A beacon that is another one's: the operator said so. It has no belief of its own meanwhile."""

    beacon_id: int
    time_ns: int
    first_heard_ns: int
    last_heard_ns: int
    into_beacon_id: int
