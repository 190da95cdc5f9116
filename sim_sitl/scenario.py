"""What a simulated world is made of, as values: places, beacons, obstacles, propagation.

Keeps the rule that a run is decided by (scenario, vehicles, beacons, seed) and nothing else.
Positions are metres east, north and up from the scenario's origin, which lies on the ground;
the ground is flat. The file format is documented in docs/scenarios.md and read by
scenario_file.py.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from groundstation.domain.geometry import Enu, Geodetic, LocalFrame

Ring2d = tuple[tuple[float, float], ...]
"""(east_m, north_m) corners, not repeated at the end."""

DISC_CORNERS = 72
"""Corners of the polygon that stands for a disc in GeoJSON."""


@dataclass(frozen=True, slots=True)
class Region:
    """A polygon on the ground; a disc is kept as the polygon that circumscribes it."""

    corners_m: Ring2d
    """(east_m, north_m)."""
    center_m: tuple[float, float]
    """Of the disc, or the middle of the polygon's bounding box."""
    radius_m: float | None
    """Of the disc; None for a polygon."""

    def contains(self, east_m: float, north_m: float) -> bool:
        """Whether the point lies inside."""
        if self.radius_m is not None:
            return math.hypot(east_m - self.center_m[0], north_m - self.center_m[1]) <= self.radius_m
        return point_in_ring(self.corners_m, east_m, north_m)


def disc(center_m: tuple[float, float], radius_m: float) -> Region:
    """A disc as a region."""
    reach_m = radius_m / math.cos(math.pi / DISC_CORNERS)
    corners = tuple(
        (
            center_m[0] + reach_m * math.cos(2 * math.pi * i / DISC_CORNERS),
            center_m[1] + reach_m * math.sin(2 * math.pi * i / DISC_CORNERS),
        )
        for i in range(DISC_CORNERS)
    )
    return Region(corners, center_m, radius_m)


def polygon(corners_m: Ring2d) -> Region:
    """A polygon as a region."""
    east = [corner[0] for corner in corners_m]
    north = [corner[1] for corner in corners_m]
    return Region(corners_m, ((min(east) + max(east)) / 2, (min(north) + max(north)) / 2), None)


def point_in_ring(ring: Ring2d, east_m: float, north_m: float) -> bool:
    """Whether a point lies inside a simple polygon (even–odd rule)."""
    inside = False
    previous_east, previous_north = ring[-1]
    for east, north in ring:
        if (north > north_m) != (previous_north > north_m):
            crossing = east + (north_m - north) * (previous_east - east) / (previous_north - north)
            if east_m < crossing:
                inside = not inside
        previous_east, previous_north = east, north
    return inside


@dataclass(frozen=True, slots=True)
class BeaconSpec:
    """One transmitter: a phone."""

    beacon_id: int
    """Device id, uint64."""
    position_enu_m: Enu
    """Up is above the ground; negative where it lies below."""
    transmit_power_dbm: float
    packet_interval_s: float
    frequency_hz: int
    buried_depth_m: float
    """Thickness of the rubble that lies on it, straight up; 0 = open to the sky."""


@dataclass(frozen=True, slots=True)
class Obstacle:
    """A vertical prism that radio goes through with loss: a building, a pile of rubble."""

    name: str
    corners_m: Ring2d
    base_m: float
    """Height of its lower face above the ground."""
    top_m: float
    """Height of its upper face above the ground."""
    attenuation_db_per_m: float
    """Loss along the obstructed length."""
    entry_loss_db: float
    """Loss of getting in at all (a wall)."""


@dataclass(frozen=True, slots=True)
class PropagationSpec:
    """Numbers of propagation.py; see there for the equations."""

    reference_loss_db: float = 31.2
    """Free space over the first metre at 867.5 MHz."""
    report_offset_db: float = 31.2
    """What the sensor adds before it reports: calibrated to the level at one metre, as eq. (7) is written."""
    los_exponent: float = 2.5
    los_shadowing_db: float = 5.0
    nlos_model: str = "log-distance"
    """``log-distance``: eq. (8). ``rubble``: eqs. (10)–(11) for buried beacons and rubble."""
    nlos_exponent: tuple[float, float] = (2.5, 3.5)
    """Drawn once per beacon."""
    nlos_bias_max_db: float = 7.0
    """The bias b of eq. (8) saturates here: what goes round the obstacle takes over."""
    nlos_shadowing_db: float = 7.0
    shadowing_distance_m: float = 25.0
    """Shadowing decorrelates as exp(−distance / this)."""
    rubble_exponent: tuple[float, float] = (2.0, 4.5)
    """Of eq. (11), drawn once per beacon."""
    rubble_excess_db: tuple[float, float] = (5.0, 25.0)
    """Above 31.5 dB in L0 of eq. (11), drawn once per beacon."""
    rubble_shadowing_db: tuple[float, float] = (3.0, 7.0)
    """Drawn once per beacon."""
    rubble_attenuation_db_per_m: float = 1.5
    """Of the rubble on a buried beacon, in the log-distance model."""
    los_rician_k_db: float = 10.0
    nlos_rician_k_db: float = -3.0
    fading_averages: int = 8
    """Independent fades that one packet's level is the mean of."""


@dataclass(frozen=True, slots=True)
class ReceiverSpec:
    """The radio sensor of every vehicle."""

    bandwidth_hz: float = 125_000.0
    noise_figure_db: float = 6.0
    sensitivity_dbm: float = -137.0
    """Packets below are lost. Before the report offset; a spread-spectrum receiver hears below its noise."""
    level_noise_db: float = 0.3
    """Standard deviation of the level's measurement."""
    angle_noise_deg: float = 1.0
    """White, on line-of-sight angles."""
    angle_bias_deg: float = 0.3
    """Standard deviation of each vehicle's constant misalignment."""
    reflection_spread_deg: float = 4.0
    """White, on the angles of obstructed links, round the reflector that is seen instead."""
    antenna_beamwidth_deg: float = 0.0
    """In elevation, 3 dB; 0 = isotropic. All azimuths alike."""
    antenna_downtilt_deg: float = 30.0


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """How the swarm stands and flies before anybody commands it."""

    ring_radius_m: float = 100.0
    ring_center_m: tuple[float, float] = (0.0, 0.0)
    altitude_m: float = 50.0
    """Above home."""
    speed_m_s: float = 8.0
    pattern: str = "orbit"
    """``orbit`` round the ring's centre or ``hover`` on it, until first commanded."""
    home_m: tuple[float, float] = (0.0, 0.0)
    """Where vehicles that are on the ground stand, in a row 3 m apart."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """A whole world."""

    name: str
    title: str
    origin: Geodetic
    relative: bool
    """Whether an overlay may move the origin to the recording's home."""
    area: Region
    fence: Region
    target_height_min_m: float
    target_height_max_m: float
    beacons: tuple[BeaconSpec, ...]
    obstacles: tuple[Obstacle, ...]
    vehicles: VehicleSpec
    propagation: PropagationSpec
    receiver: ReceiverSpec

    @property
    def frame(self) -> LocalFrame:
        """The scenario's local frame."""
        return LocalFrame(self.origin)

    def at(self, origin: Geodetic) -> Scenario:
        """The same world somewhere else."""
        return replace(self, origin=origin)


def area_geojson(scenario: Scenario) -> dict[str, Any]:
    """The search area as a GeoJSON Feature (Polygon), with the target's height limits."""
    return _feature(
        scenario,
        scenario.area,
        {
            "name": f"{scenario.name}: search area",
            "target_height_min_m": scenario.target_height_min_m,
            "target_height_max_m": scenario.target_height_max_m,
            "ground_amsl_m": scenario.origin.altitude_amsl_m,
        },
    )


def fence_geojson(scenario: Scenario) -> dict[str, Any]:
    """The fence as a GeoJSON Feature (Polygon)."""
    return _feature(scenario, scenario.fence, {"name": f"{scenario.name}: fence"})


def _feature(scenario: Scenario, region: Region, properties: dict[str, Any]) -> dict[str, Any]:
    places = [scenario.frame.to_geodetic((east, north, 0.0)) for east, north in region.corners_m]
    ring = [[round(place.longitude_deg, 8), round(place.latitude_deg, 8)] for place in places]
    signed_area = sum(
        a[0] * b[1] - b[0] * a[1]
        for a, b in zip(region.corners_m, region.corners_m[1:] + region.corners_m[:1], strict=True)
    )
    if signed_area < 0:
        ring.reverse()
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "Polygon", "coordinates": [[*ring, ring[0]]]},
    }


def write_geojson(scenario: Scenario, area: Path | None, fence: Path | None) -> None:
    """Write search area and fence where a path is given."""
    for path, feature in ((area, area_geojson(scenario)), (fence, fence_geojson(scenario))):
        if path is not None:
            path.write_text(json.dumps(feature, indent=1) + "\n", encoding="utf-8")
