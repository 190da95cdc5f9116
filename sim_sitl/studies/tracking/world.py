"""The radio world of a tracking run, and one run drawn from it.

Exists because a filter must be judged in a world that is not its own model. The shadowing is
``sim_sitl.propagation.ShadowingField``, the simulator's. Rule: what a run is depends on
the study's seed, the world's name, the path and the run's number alone: cases that differ only in what
the methods are told have the same runs.

Received power (Gao & Sadjadpour, 2026): eq. (7) on a line of sight, eq. (8) elsewhere:

    P = P_t − 10 β log₁₀ d − b_k + σ s_k(a)

with β = β_LOS, b_k = 0 on a line of sight; one β_NLOS and P_t a run, one b_k a vehicle and run;
s_k a field in space, each vehicle its own. A link's state does not change within a run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from groundstation.localization import SearchArea
from groundstation.localization.problem import FloatArray
from sim_sitl.propagation import ShadowingField
from sim_sitl.studies.scoring import case_key
from sim_sitl.studies.tracking.paths import Path

TARGET_HEIGHTS_M = (1.0, 20.0)
HEADING_MEMORY_S = 60.0
"""How long a walker keeps his heading: the cosine of its change falls by e in that time."""
HEIGHT_ERROR = 2.0
"""Error of a told height, in those of the place."""
_LABEL_SPREAD = 2.66
"""Distance of the two states' scores, in their standard deviations: AUC Φ(2.66/√2) = 0.97."""


@dataclass(frozen=True, slots=True)
class Labels:
    """What the methods are told of a link's state."""

    kind: str = "certain"
    """``certain``: 0 or 1, true. ``soft``: a calibrated classifier's probability for each window (AUC 0.97,
    a quarter LOS). ``wrong``: 0.95 or 0.05, true four times in five, window by window."""

    def probabilities(self, line_of_sight: FloatArray, rng: np.random.Generator) -> FloatArray:
        """P(line of sight), same shape as the true states (0 or 1)."""
        if self.kind == "certain":
            return line_of_sight.copy()
        if self.kind == "wrong":
            told = np.where(rng.random(line_of_sight.shape) < 0.2, 1.0 - line_of_sight, line_of_sight)
            result: FloatArray = 0.05 + 0.9 * told
            return result
        score = rng.standard_normal(line_of_sight.shape) + _LABEL_SPREAD * (line_of_sight - 0.5)
        soft: FloatArray = 1.0 / (1.0 + 3.0 * np.exp(-_LABEL_SPREAD * score))
        return soft


@dataclass(frozen=True, slots=True)
class World:
    """What a run is drawn from."""

    name: str
    """Runs of the same world and number share target, power, exponent, biases and fields."""
    line_of_sight: tuple[bool, ...]
    """(K,) state of each vehicle's link."""
    power_dbm: tuple[float, float] = (13.0, 18.0)
    """P_t is uniform between."""
    los_exponent: float = 2.5
    """β_LOS."""
    nlos_exponent: tuple[float, float] = (2.0, 3.5)
    """β_NLOS is uniform between."""
    bias_max_db: float = 8.0
    """b_k is uniform between 0 and this."""
    shadowing_db: float = 5.0
    """σ of the shadowing."""
    correlation_m: float = 25.0
    """Its correlation distance: exp(−Δ/d)."""
    angle_white_rad: float = math.radians(1.0)
    """σ of each window's azimuth and elevation on a line of sight."""
    angle_constant_rad: float = math.radians(1.0)
    """σ of each vehicle's constant error of azimuth and of elevation."""
    place_error_m: float = 0.0
    """σ of the error of the vehicles' told places, east and north each; twice that in height."""
    place_error_shared: float = 0.5
    """Share of its variance that all vehicles have alike (satellites, ionosphere); the rest is each one's."""
    place_error_memory_s: float = 300.0
    """How long such an error lasts: a Gauss–Markov process."""
    place_error_said: bool = False
    """Whether the vehicles say how far off their places may be."""
    labels: Labels = Labels()
    """What is told of the states."""
    ruined_share: float = 0.0
    """Share of windows whose power is far off."""
    ruined_db: float = 20.0
    """How far, up or down."""
    walking_m_s: float = 0.0
    """Speed of the person, who keeps a heading for about a minute and stays in the area; 0: stands still."""


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One flight over one beacon. T windows of each of K vehicles; ENU, metres, radians, dBm."""

    time_s: FloatArray
    """(T,) from the start, seconds."""
    position_enu_m: FloatArray
    """(T, K, 3) as told."""
    rss_dbm: FloatArray
    """(T, K)"""
    azimuth_rad: FloatArray
    """(T, K)"""
    elevation_rad: FloatArray
    """(T, K)"""
    los_probability: FloatArray
    """(T, K) as told."""
    truth_enu_m: FloatArray
    """(T, 3) where the target is. Not told."""
    area: SearchArea
    """Where it may be. Told."""
    place_std_m: tuple[float, float] | None = None
    """What the vehicles say their places may be off by: each horizontal axis, and height; None: nothing."""


def draw_run(world: World, path: Path, time_s: FloatArray, seed: int, number: int) -> Run:
    """Run ``number`` of ``world`` along ``path``, windows at ``time_s`` (T,)."""
    root = np.random.SeedSequence(seed, spawn_key=(case_key(world.name), number))
    scene, noise, told, *fields, steps, satellites = (
        np.random.default_rng(child) for child in root.spawn(5 + len(world.line_of_sight))
    )
    reach, turn = path.radius_m * math.sqrt(scene.random()), 2.0 * math.pi * scene.random()
    start = np.array([reach * math.cos(turn), reach * math.sin(turn), scene.uniform(*TARGET_HEIGHTS_M)])
    truth = _walked(start, world.walking_m_s, time_s, path.radius_m, steps)
    power_dbm = scene.uniform(*world.power_dbm)
    nlos_exponent = scene.uniform(*world.nlos_exponent)
    bias_db = scene.uniform(0.0, world.bias_max_db, path.vehicles)
    constant_rad = world.angle_constant_rad * scene.standard_normal((2, path.vehicles))
    places = path.positions(time_s, start)
    shape = places.shape[:2]
    los = np.broadcast_to(np.array(world.line_of_sight, dtype=float), shape)
    offset = truth[:, None] - places
    distance = np.linalg.norm(offset, axis=-1)
    loss = 10.0 * np.where(los > 0.5, world.los_exponent, nlos_exponent) * np.log10(distance)
    shadowing = np.stack(
        [_along(ShadowingField(rng, world.correlation_m), places[:, k]) for k, rng in enumerate(fields)],
        axis=1,
    )
    rss = power_dbm - loss - (1.0 - los) * bias_db + world.shadowing_db * shadowing
    white = world.angle_white_rad * noise.standard_normal((2, *shape))
    azimuth = np.arctan2(offset[..., 1], offset[..., 0]) + constant_rad[0] + white[0]
    elevation = np.arctan2(offset[..., 2], np.hypot(offset[..., 0], offset[..., 1]))
    elevation = elevation + constant_rad[1] + white[1]
    # An array on an obstructed link reports an angle all the same: it means nothing.
    azimuth = np.where(los > 0.5, azimuth, noise.uniform(-math.pi, math.pi, shape))
    elevation = np.where(los > 0.5, elevation, noise.uniform(-0.5 * math.pi, 0.5 * math.pi, shape))
    ruined = noise.random(shape) < world.ruined_share
    rss = rss + np.where(ruined, np.where(noise.random(shape) < 0.5, 1.0, -1.0) * world.ruined_db, 0.0)
    told_places = places + _place_errors(world, time_s, shape[1], satellites)
    area = SearchArea(np.zeros(2), path.radius_m, *TARGET_HEIGHTS_M)
    return Run(
        time_s, told_places, rss, np.arctan2(np.sin(azimuth), np.cos(azimuth)), elevation,
        world.labels.probabilities(los, told), truth, area,
        (world.place_error_m, HEIGHT_ERROR * world.place_error_m) if world.place_error_said else None,
    )  # fmt: skip


def _place_errors(world: World, time_s: FloatArray, vehicles: int, rng: np.random.Generator) -> FloatArray:
    """(T, K, 3) metres by which the vehicles' told places are off."""
    fresh = rng.standard_normal((time_s.size, 1 + vehicles, 3))
    error = fresh.copy()
    for at, step_s in enumerate(np.diff(time_s), start=1):
        kept = math.exp(-step_s / world.place_error_memory_s)
        error[at] = kept * error[at - 1] + math.sqrt(1.0 - kept * kept) * fresh[at]
    shared = world.place_error_shared
    error = math.sqrt(shared) * error[:, :1] + math.sqrt(1.0 - shared) * error[:, 1:]
    result: FloatArray = world.place_error_m * error * np.array([1.0, 1.0, HEIGHT_ERROR])
    return result


def _walked(
    start_enu_m: FloatArray, speed_m_s: float, time_s: FloatArray, radius_m: float, rng: np.random.Generator
) -> FloatArray:
    """(T, 3) of somebody who walks at one speed and height; at the area's edge he turns to its centre."""
    place = np.tile(start_enu_m, (time_s.size, 1))
    heading = rng.uniform(-math.pi, math.pi)
    turns = rng.standard_normal(time_s.size)
    for at, step_s in enumerate(np.diff(time_s), start=1):
        heading += math.sqrt(2.0 * step_s / HEADING_MEMORY_S) * turns[at]
        stride = speed_m_s * step_s * np.array([math.cos(heading), math.sin(heading)])
        if np.hypot(*(place[at - 1, :2] + stride)) > radius_m:
            heading = math.atan2(-place[at - 1, 1], -place[at - 1, 0])
            stride = speed_m_s * step_s * np.array([math.cos(heading), math.sin(heading)])
        place[at, :2] = place[at - 1, :2] + stride
    return place


def _along(field: ShadowingField, places_enu_m: FloatArray) -> FloatArray:
    east, north, up = places_enu_m.T
    return np.array([field.at(place) for place in zip(east, north, up, strict=True)])
