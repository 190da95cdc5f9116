"""What a localisation problem is, what is assumed of the radio, and what an answer holds.

Exists so that every solver takes the same values and refuses the same nonsense with the
same words. Rule: nothing here solves anything, and an error states what was seen and what
is needed.

Frame: metres east, north, up (ENU). Angles are the paper's (Gao & Sadjadpour, 2026, eqs.
(1)–(2)): radians, azimuth counter-clockwise from east, elevation positive up, both from the
vehicle to the beacon; NaN where a link has no usable angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from groundstation.domain.errors import InputError
from groundstation.domain.target import Environment
from groundstation.localization.ground import GroundHeights

if TYPE_CHECKING:
    from groundstation.localization.posterior import PosteriorAnswer

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_GROUND_SAMPLES = 129
"""Across the area: where the ground's lowest and highest place are looked for."""


def _floats(values: Any) -> FloatArray:
    return np.asarray(values, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """K radio links to one beacon, or N problems of K links each with a leading axis N."""

    position_enu_m: FloatArray
    """(K, 3) or (N, K, 3): where each vehicle was, metres."""
    rss_dbm: FloatArray
    """(K,) or (N, K): received power, averaged, dBm."""
    azimuth_rad: FloatArray
    """(K,) or (N, K): counter-clockwise from east; NaN = no usable angle."""
    elevation_rad: FloatArray
    """(K,) or (N, K): up from the horizontal plane; NaN = no usable angle."""
    los_probability: FloatArray
    """(K,) or (N, K): P(line of sight), 0 to 1; NaN = unknown, which counts as NLOS."""

    def __post_init__(self) -> None:
        for name in ("position_enu_m", "rss_dbm", "azimuth_rad", "elevation_rad", "los_probability"):
            object.__setattr__(self, name, _floats(getattr(self, name)))
        if self.position_enu_m.ndim < 2 or self.position_enu_m.shape[-1] != 3:
            raise InputError(
                f"vehicle positions have shape {self.position_enu_m.shape}; (K, 3) is needed, metres ENU"
            )
        expected = self.position_enu_m.shape[:-1]
        for name in ("rss_dbm", "azimuth_rad", "elevation_rad", "los_probability"):
            if getattr(self, name).shape != expected:
                raise InputError(f"{name} has shape {getattr(self, name).shape}; {expected} is needed")

    @property
    def count(self) -> int:
        """K, links a problem."""
        return int(self.position_enu_m.shape[-2])

    def has_angle(self) -> BoolArray:
        """Which links have both angles."""
        result: BoolArray = np.isfinite(self.azimuth_rad) & np.isfinite(self.elevation_rad)
        return result

    def los(self, threshold: float) -> BoolArray:
        """Which links are labelled LOS: P ≥ ``threshold``; unknown (NaN) is not."""
        result: BoolArray = self.los_probability >= threshold
        return result

    def subset(self, keep: Any) -> Links:
        """The links that ``keep`` selects along the last link axis of a single problem."""
        return Links(
            self.position_enu_m[keep],
            self.rss_dbm[keep],
            self.azimuth_rad[keep],
            self.elevation_rad[keep],
            self.los_probability[keep],
        )

    def problem(self, index: int) -> Links:
        """One problem of a batch."""
        return self.subset(index)

    def take(self, columns: Any) -> Links:
        """The links ``columns`` (N, k) of each problem of a batch."""

        def taken(values: FloatArray) -> FloatArray:
            return np.take_along_axis(values, columns, axis=1)

        place = np.take_along_axis(self.position_enu_m, columns[..., None], axis=1)
        return Links(
            place,
            taken(self.rss_dbm),
            taken(self.azimuth_rad),
            taken(self.elevation_rad),
            taken(self.los_probability),
        )

    def as_batch(self) -> Links:
        """A single problem as a batch of one."""
        return self.subset(None)


@dataclass(frozen=True, slots=True, eq=False)
class SearchArea:
    """Where the target may be: a disc or a polygon, between two heights."""

    center_enu_m: FloatArray
    """(2,) or (3,): the disc's centre, metres; of a polygon its centroid."""
    radius_m: float
    """The disc's radius; of a polygon the radius of the disc round the centroid that holds it."""
    height_min_m: float
    """Lowest height of the target in the ENU frame, metres; over terrain that of the lowest ground."""
    height_max_m: float
    """Highest height of the target in the ENU frame, metres; over terrain that of the highest ground."""
    polygon_en_m: BaseGeometry | None = field(default=None)
    """Polygon or multipolygon in east and north metres; None: the disc."""
    ground: GroundHeights | None = field(default=None)
    """Heights of the ground; None: it is level, and the limits above are all there is (see ``over``)."""
    above_ground_m: tuple[float, float] = (0.0, 0.0)
    """Lowest and highest height of the target above ``ground``, metres; nothing without one."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "center_enu_m", _floats(self.center_enu_m).reshape(-1))
        if self.center_enu_m.size not in {2, 3} or not np.isfinite(self.center_enu_m).all():
            raise InputError(
                f"search area centre is {self.center_enu_m}; two or three finite ENU metres are needed"
            )
        if not (math.isfinite(self.radius_m) and self.radius_m > 0.0):
            raise InputError(f"search area radius is {self.radius_m} m; a positive number is needed")
        if not self.height_max_m >= self.height_min_m:
            raise InputError(
                f"target heights {self.height_min_m} to {self.height_max_m} m;"
                " the highest must not lie under the lowest"
            )

    @classmethod
    def of_polygon(cls, polygon_en_m: BaseGeometry, height_min_m: float, height_max_m: float) -> SearchArea:
        """A polygonal area; raises InputError when it is empty."""
        repaired = shapely.make_valid(polygon_en_m)
        if repaired.is_empty or repaired.area <= 0.0:
            raise InputError("the search area's polygon is empty; a polygon with an area is needed")
        center = np.array([repaired.centroid.x, repaired.centroid.y])
        corners = shapely.get_coordinates(repaired)
        radius = float(np.hypot(*(corners - center).T).max())
        return cls(center, radius, height_min_m, height_max_m, repaired)

    def over(self, ground: GroundHeights, lowest_m: float, highest_m: float) -> SearchArea:
        """The same outline with height limits above ``ground``, metres.

        ``height_min_m`` and ``height_max_m`` become those that hold every place: what works with
        two planes alone (convex programs) stays right, only wider.
        """
        steps = self.center_enu_m[:2, None] + self.radius_m * np.linspace(-1.0, 1.0, _GROUND_SAMPLES)
        east, north = np.meshgrid(steps[0], steps[1])
        up = ground.at(east, north)
        inside = self.contains(east.ravel(), north.ravel()).reshape(up.shape)
        up = up[inside] if inside.any() else up
        return replace(
            self,
            height_min_m=float(up.min()) + lowest_m,
            height_max_m=float(up.max()) + highest_m,
            ground=ground,
            above_ground_m=(lowest_m, highest_m),
        )

    def height_limits_m(self, east_m: FloatArray, north_m: FloatArray) -> tuple[Any, Any]:
        """Lowest and highest height of the target at places, metres ENU; two numbers over level ground."""
        if self.ground is None:
            return self.height_min_m, self.height_max_m
        up = self.ground.at(east_m, north_m)
        return up + self.above_ground_m[0], up + self.above_ground_m[1]

    def contains(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        """Which horizontal points lie inside."""
        if self.polygon_en_m is not None:
            inside: BoolArray = np.asarray(
                shapely.contains_xy(self.polygon_en_m, east_m, north_m), dtype=bool
            )
            return inside
        within: BoolArray = (
            np.hypot(east_m - self.center_enu_m[0], north_m - self.center_enu_m[1]) <= self.radius_m
        )
        return within

    def clip(self, position_enu_m: FloatArray) -> FloatArray:
        """(…, 3) → the nearest places inside area and height limits (Euclidean)."""
        points = np.array(position_enu_m, dtype=np.float64)
        flat = points.reshape(-1, 3)
        outside = ~self.contains(flat[:, 0], flat[:, 1])
        for row in np.flatnonzero(outside):
            flat[row, :2] = self._nearest(flat[row, :2])
        flat[:, 2] = np.clip(flat[:, 2], *self.height_limits_m(flat[:, 0], flat[:, 1]))
        return flat.reshape(points.shape)

    def _nearest(self, point: FloatArray) -> FloatArray:
        if self.polygon_en_m is None:
            offset = point - self.center_enu_m[:2]
            result: FloatArray = self.center_enu_m[:2] + offset * (self.radius_m / np.hypot(*offset))
            return result
        line = shapely.shortest_line(self.polygon_en_m, shapely.Point(point))
        return np.asarray(shapely.get_coordinates(line)[0], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class SignalModel:
    """What is known or assumed of the radio. Defaults: the analytic channel of the paper's V-C."""

    rss_std_db: float = 5.0
    """σ_s of received power on a LOS link, dB."""
    nlos_rss_std_db: float = 5.0
    """σ_s of received power on an NLOS link, dB."""
    azimuth_std_rad: float = math.radians(1.0)
    """σ_θ, radians."""
    elevation_std_rad: float = math.radians(1.0)
    """σ_φ, radians."""
    angle_bias_std_rad: float = 0.0
    """Spread of a constant error of each vehicle's angles (mounting, compass), radians (tracker only)."""
    angle_outlier_probability: float = 0.01
    """Share of LOS angles that point anywhere (used by ``posterior`` only)."""
    rss_outlier_probability: float = 0.01
    """Share of links whose power is far off, the model does not know why (``posterior`` only)."""
    rss_outlier_std_db: float = 20.0
    """How far off such a power is, standard deviation, dB."""
    los_shares: tuple[float, ...] = (0.5,)
    """Equally likely shares of LOS links that angles are weighed under; 0.5 alone takes the
    links' probabilities as they are (``posterior`` and tracker)."""
    los_exponent: float = 2.5
    """β_LOS, path-loss exponent of a LOS link."""
    los_exponent_std: float = 0.0
    """Uncertainty of β_LOS (used by ``posterior`` only)."""
    transmit_power_min_dbm: float = 13.0
    """Lowest transmit power of the prior, dBm."""
    transmit_power_max_dbm: float = 18.0
    """Highest transmit power of the prior, dBm."""
    known_transmit_power_dbm: float | None = None
    """Transmit power where it is known, dBm; None: unknown."""
    antenna_null_mean: float = 0.0
    """Expected order g of the antennas' null overhead, power ∝ cos²ᵍ(elevation) (tracker only): two
    upright dipoles 2, one 1, isotropic antennas 0."""
    antenna_null_std: float = 0.0
    """Uncertainty of that order, shared by all links; 0: the mean is taken as given."""
    receiver_offset_db: float = 0.0
    """What the receivers report above the true power, dB: subtracted from every sample."""
    receiver_offset_std_db: float = 0.0
    """Spread of a constant offset that differs from receiver to receiver, dB (``posterior`` only)."""
    nlos_exponent_min: float = 2.0
    """Lowest NLOS path-loss exponent of the prior."""
    nlos_exponent_max: float = 3.5
    """Highest NLOS path-loss exponent of the prior."""
    nlos_exponent_doubt: float = 0.0
    """How far β_NLOS may lie beyond these limits after all: there its density falls by e for each such
    step of ln β; 0: not at all (tracker only)."""
    vehicle_position_std_m: float = 0.0
    """How far off the vehicles' told places may be, east and north each, metres (``posterior`` and tracker),
    where they do not say so themselves; it does not average out along a flight. Bearings from near by and
    the answer's spread count it, powers hardly change over it."""
    vehicle_height_std_m: float = 0.0
    """The same of their heights, metres."""
    shared_shadowing: float = 0.0
    """Share of the shadowing's variance that all vehicles meet alike at one place, 0 to 1 (tracker only)."""
    nlos_bias_max_db: float = 7.0
    """b_max: an NLOS link loses another 0 to b_max dB, eq. (8)."""
    first_transmit_power_dbm: float = 15.0
    """P̂_t before the first iteration, dBm."""
    first_exponent: float = 2.7
    """β̂ of NLOS links before the first iteration."""
    los_threshold: float = 0.5
    """A link with P(line of sight) at or above it is labelled LOS."""
    minimum_links: int = 4
    """Links that Algorithm 1 asks for."""
    position_tolerance_m: float = 0.1
    """ε_x: an iteration that moves less has converged."""
    transmit_power_tolerance_db: float = 0.1
    """ε_Pt, dB."""
    exponent_tolerance: float = 0.01
    """ε_PLE."""
    maximum_iterations: int = 20
    """J_max."""
    diverging_rounds: int = 3
    """J of (69) up in so many rounds running: diverging, the iteration ends."""
    relaxation: float = 0.5
    """ν of (70)."""
    projection_tolerance: float = 0.05
    """ε_proj of (76)."""

    def __post_init__(self) -> None:
        positive = (
            "rss_std_db", "nlos_rss_std_db", "azimuth_std_rad", "elevation_std_rad", "los_exponent",
            "first_exponent", "nlos_exponent_min", "maximum_iterations",
        )  # fmt: skip
        for name in positive:
            if not getattr(self, name) > 0:
                raise InputError(
                    f"signal model: {name} is {getattr(self, name)}; a positive number is needed"
                )
        for name in ("angle_outlier_probability", "rss_outlier_probability"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise InputError(
                    f"signal model: {name} is {getattr(self, name)}; a share from 0 to below 1 is needed"
                )
        for name in ("vehicle_position_std_m", "vehicle_height_std_m"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise InputError(
                    f"signal model: {name} is {getattr(self, name)}; metres, 0 or more, are needed"
                )
        if self.nlos_exponent_max < self.nlos_exponent_min:
            raise InputError("signal model: nlos_exponent_max lies under nlos_exponent_min")
        if self.transmit_power_max_dbm < self.transmit_power_min_dbm:
            raise InputError("signal model: transmit_power_max_dbm lies under transmit_power_min_dbm")

    @property
    def has_antenna_null(self) -> bool:
        """Whether antennas may have a null overhead."""
        return self.antenna_null_mean != 0.0 or self.antenna_null_std > 0.0

    @property
    def vehicle_std_m(self) -> tuple[float, float]:
        """Standard deviation of a vehicle's told place on each horizontal axis, and of its height, metres."""
        return self.vehicle_position_std_m, self.vehicle_height_std_m

    @property
    def vehicle_variance_m2(self) -> tuple[float, float]:
        """Variance of a vehicle's told place on each horizontal axis, and of its height, m²."""
        return self.vehicle_position_std_m**2, self.vehicle_height_std_m**2

    @property
    def vehicle_covariance_m2(self) -> FloatArray:
        """The same as (3, 3) m²."""
        flat, upright = self.vehicle_variance_m2
        return np.diag([flat, flat, upright])

    @property
    def transmit_power_mean_dbm(self) -> float:
        """Mean of the transmit power's prior (the known power where there is one)."""
        if self.known_transmit_power_dbm is not None:
            return self.known_transmit_power_dbm
        return 0.5 * (self.transmit_power_min_dbm + self.transmit_power_max_dbm)

    @property
    def transmit_power_std_db(self) -> float:
        """Standard deviation of the transmit power's prior; 0 where it is known."""
        if self.known_transmit_power_dbm is not None:
            return 0.0
        return (self.transmit_power_max_dbm - self.transmit_power_min_dbm) / math.sqrt(12.0)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A snapshot's answer."""

    position_enu_m: FloatArray
    """(3,) metres."""
    covariance_m2: FloatArray
    """(3, 3) m²: the Cramér–Rao bound on LOS links, else the posterior's spread about the answer; NaN
    where it was not asked for."""
    environment: Environment
    """Algorithm 1's environment by the links' labels."""
    method: str
    """Name in ``METHODS`` of what gave the position."""
    transmit_power_dbm: float
    """P̂_t; NaN where the method does not estimate it."""
    path_loss_exponent: FloatArray
    """(K,) β̂ of each link."""
    rss_cost_db2: float
    """J of (69) at the answer, dB²; NaN where the method has no power."""
    iterations: int
    """Rounds of the outer iteration; 1 for a closed form."""
    status: str
    """``ok``, ``iteration limit``, ``diverging``, or what went wrong."""
    solve_time_s: float
    """How long it took; NaN where no clock was given. A diagnostic, never an input to anything."""
    belief: PosteriorAnswer | None = None
    """The belief over position and its containment regions; of ``posterior`` only."""
