"""Where vehicles and targets are: the paper's V-C and V-D, and geometries the paper does not look at.

Rules: the frame is ENU in metres, centred on the search area; the target is uniform in the
area whatever the geometry, so that the area tells no solver more than "somewhere in here".

V-C: vehicles at 50 m; four on the circle R₀, the others evenly on an inner ring (its radius
R₀/2 and its offset of 45° are ours); the target uniform in the disc R₀, 1–20 m high.

V-D: rows of the data set, which puts the target at the origin and each vehicle 0–20 m above
it. An area centred on that origin would give the answer away, so the area's centre is drawn
instead, uniform round the target, and so is the target's height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from groundstation.localization import SearchArea
from groundstation.localization.problem import FloatArray
from sim_sitl.dataset.geometry import DISTANCE_BANDS_M

VEHICLE_HEIGHT_M = 50.0
TARGET_HEIGHTS_M = (1.0, 20.0)
OUTER_VEHICLES = 4
"""As many stand on the outer circle; more go to the inner ring."""
INNER_RADIUS_SHARE = 0.5
INNER_OFFSET_RAD = math.radians(45.0)
ROW_HEIGHT_MAX_M = 20.0
"""V-D: vehicles are up to so far above the target."""


class Geometry(Protocol):
    """How one case places K vehicles and a target."""

    @property
    def vehicles(self) -> int:
        """K."""
        ...

    @property
    def radius_m(self) -> float:
        """Radius of the search area."""
        ...

    def place(self, target_enu_m: FloatArray, rng: np.random.Generator) -> FloatArray:
        """(N, K, 3) vehicles for targets (N, 3), metres ENU from the area's centre."""
        ...


def area_of(geometry: Geometry) -> SearchArea:
    """The disc that the target is uniform in, between the paper's heights."""
    return SearchArea(np.zeros(2), geometry.radius_m, *TARGET_HEIGHTS_M)


def draw_targets(count: int, radius_m: float, rng: np.random.Generator) -> FloatArray:
    """(N, 3) uniform in the disc round the origin, heights uniform over 1–20 m."""
    distance = radius_m * np.sqrt(rng.random(count))
    azimuth = rng.uniform(-math.pi, math.pi, count)
    height = rng.uniform(*TARGET_HEIGHTS_M, count)
    return np.stack([distance * np.cos(azimuth), distance * np.sin(azimuth), height], axis=1)


def ring_enu_m(vehicles: int, radius_m: float) -> FloatArray:
    """(K, 3) vehicles of V-C: up to four evenly on the circle, the others on the inner ring."""
    outer = min(vehicles, OUTER_VEHICLES)
    inner = vehicles - outer
    azimuth = np.concatenate(
        [
            2 * math.pi * np.arange(outer) / outer,
            INNER_OFFSET_RAD + 2 * math.pi * np.arange(inner) / max(inner, 1),
        ]
    )
    distance = radius_m * np.repeat([1.0, INNER_RADIUS_SHARE], [outer, inner])
    height = np.full(vehicles, VEHICLE_HEIGHT_M)
    return np.stack([distance * np.cos(azimuth), distance * np.sin(azimuth), height], axis=1)


@dataclass(frozen=True, slots=True)
class Ring:
    """V-C: the vehicles' ring round the area, R₀ the radius of both."""

    vehicles: int = 4
    """K."""
    radius_m: float = 100.0
    """R₀."""

    def place(self, target_enu_m: FloatArray, rng: np.random.Generator) -> FloatArray:
        """(N, K, 3): the same for every trial; draws nothing."""
        ring = ring_enu_m(self.vehicles, self.radius_m)
        return np.broadcast_to(ring, (len(target_enu_m), *ring.shape)).copy()


@dataclass(frozen=True, slots=True)
class Fixed:
    """Vehicles where they are told to be, 50 m high, the same in every trial."""

    position_en_m: tuple[tuple[float, float], ...]
    """(east, north) of each vehicle from the area's centre, metres."""
    radius_m: float = 100.0
    """Radius of the search area."""

    @property
    def vehicles(self) -> int:
        """K."""
        return len(self.position_en_m)

    def place(self, target_enu_m: FloatArray, rng: np.random.Generator) -> FloatArray:
        """(N, K, 3); draws nothing."""
        flat = np.array(self.position_en_m, dtype=np.float64)
        vehicles = np.column_stack([flat, np.full(len(flat), VEHICLE_HEIGHT_M)])
        return np.broadcast_to(vehicles, (len(target_enu_m), *vehicles.shape)).copy()


@dataclass(frozen=True, slots=True)
class DatasetRows:
    """V-D: each vehicle a row of the data set, its distance by the paper's mix, 0–20 m above the target."""

    vehicles: int = 4
    """K."""
    radius_m: float = 100.0
    """Radius of the search area, whose centre is drawn round the target."""

    def place(self, target_enu_m: FloatArray, rng: np.random.Generator) -> FloatArray:
        """(N, K, 3): every vehicle on its own, in any direction from the target."""
        shape = (len(target_enu_m), self.vehicles)
        low, high, share = (np.array(column) for column in zip(*DISTANCE_BANDS_M, strict=True))
        band = rng.choice(len(share), size=shape, p=share)
        range_m = rng.uniform(low[band], high[band])
        above_m = rng.uniform(0.0, np.minimum(ROW_HEIGHT_MAX_M, 0.95 * range_m))
        azimuth = rng.uniform(-math.pi, math.pi, shape)
        horizontal = np.sqrt(range_m**2 - above_m**2)
        offset = np.stack([horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), above_m], axis=-1)
        placed: FloatArray = target_enu_m[:, None, :] + offset
        return placed

    def density(self, vehicles_enu_m: FloatArray, target_enu_m: FloatArray) -> FloatArray:
        """(S,) density of where vehicles (K, 3) are, up to a factor, given each target (S, 3)."""
        offset = vehicles_enu_m - target_enu_m[:, None, :]
        range_m = np.linalg.norm(offset, axis=-1)
        low, high, share = (np.array(column) for column in zip(*DISTANCE_BANDS_M, strict=True))
        inside = (range_m[..., None] >= low) & (range_m[..., None] < high)
        highest = np.minimum(ROW_HEIGHT_MAX_M, 0.95 * range_m)
        level = (offset[..., 2] >= 0.0) & (offset[..., 2] <= highest)
        # Rows are taken at a link's last packet, up to 3 m from where the mix put it.
        each = (inside * share / (high - low)).sum(axis=-1) + 1e-5
        product: FloatArray = np.prod(each * level / (highest * range_m), axis=-1)
        return product


def on_circle(
    azimuth_deg: tuple[float, ...], distance_m: float, centre_en_m: tuple[float, float] = (0.0, 0.0)
) -> tuple[tuple[float, float], ...]:
    """(east, north) places on a circle, for ``Fixed``."""
    return tuple(
        (
            round(centre_en_m[0] + distance_m * math.cos(math.radians(azimuth)), 6),
            round(centre_en_m[1] + distance_m * math.sin(math.radians(azimuth)), 6),
        )
        for azimuth in azimuth_deg
    )


HARD_GEOMETRIES: dict[str, tuple[str, Geometry]] = {
    "outside": (
        "targets outside the ring: a ring of 100 m, 250 m away from the disc that they are in",
        Fixed(on_circle((0, 90, 180, 270), 100.0, (-250.0, 0.0))),
    ),
    "wide": (
        "an area of 300 m round a ring of 100 m",
        Fixed(on_circle((0, 90, 180, 270), 100.0), radius_m=300.0),
    ),
    "uneven": (
        "an uneven ring: three vehicles within 40°, one opposite",
        Fixed(on_circle((0, 20, 40, 200), 100.0)),
    ),
    "one-close": (
        "one vehicle over the area, 50 m east of its centre; three 300 m away",
        Fixed(((50.0, 0.0), *on_circle((60, 180, 300), 300.0))),
    ),
    "one-side": (
        "all vehicles on one side, 150 m from the centre, within 60°",
        Fixed(on_circle((150, 170, 190, 210), 150.0)),
    ),
    "k2": ("two vehicles, opposite", Ring(2)),
    "k3": ("three vehicles on the circle", Ring(3)),
    "r200": ("the paper's ring, 200 m", Ring(radius_m=200.0)),
    "r400": ("the paper's ring, 400 m", Ring(radius_m=400.0)),
}
"""Where the paper does not look: name → (what it is, geometry)."""
