"""Where the links of a data set run, and what they lose on the way.

Why: the paper's rows carry position, range, angles, received power and link budget, which
must agree with one another and along a moving link. Rules kept here: the beacon is the
origin; large-scale losses are drawn by label, once a link, and shadowing is one correlated
process along its way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_sitl.cir import SPEED_OF_LIGHT_M_S

FREQUENCY_HZ = 867.5e6
DISTANCE_BANDS_M = ((10.0, 100.0, 0.5), (100.0, 150.0, 0.3), (150.0, 200.0, 0.2))
"""(from, to, share) of the paper's distance mix."""
HEIGHT_MAX_M = 20.0
TRANSMIT_POWER_DBM = (13.0, 18.0)
PATH_LOSS = {True: (2.0, 4.0), False: (2.9, 7.0)}
"""By line of sight: close-in exponent and shadowing σ, dB (NYUSIM, UMa)."""
SHADOWING_DISTANCE_M = 20.0
"""Shadowing decorrelates as exp(-distance / this) along a flight (Gudmundson)."""
FOLIAGE_DB_PER_M = 0.4
FOLIAGE_DEPTH_MAX_M = 10.0
PENETRATION = ((5.0, 0.03, 4.0), (10.0, 5.0, 6.0))
"""Outdoor-to-indoor loss 10 log₁₀(A + B f²), f in GHz, and its σ, dB: low-loss and high-loss buildings."""
VEHICLE_SPEED_M_S = 8.0
HOVER_DRIFT_M_S = 0.3
"""A hovering vehicle still drifts by centimetres between captures."""
TARGET_SPEED_M_S = (0.5, 3.0)
"""Of a person who walks or runs; the others are trapped."""
CAPTURE_INTERVAL_S = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class LinkGeometry:
    """One link's consecutive captures, seen from the beacon at the origin."""

    position_enu_m: NDArray[np.float64]
    """(captures, 3) of the vehicle."""
    line_of_sight: bool
    transmit_power_dbm: float
    large_scale_gain_db: NDArray[np.float64]
    """(captures,) minus path loss, shadowing, foliage and penetration."""
    foliage_db: float
    penetration_db: float
    target_speed_m_s: float
    """0: trapped."""
    vehicle_speed_m_s: float

    @property
    def range_m(self) -> NDArray[np.float64]:
        """(captures,)"""
        norm: NDArray[np.float64] = np.linalg.norm(self.position_enu_m, axis=1)
        return norm


def draw_geometry(rng: np.random.Generator, *, line_of_sight: bool, captures: int) -> LinkGeometry:
    """Distance, height, movement, losses and power: the paper's (V-A); loss values are NYUSIM's.

    The target moves in one half of the links, the vehicle in one half; as the target stays
    the origin, the vehicle's track is the relative one.
    """
    shares = [share for _, _, share in DISTANCE_BANDS_M]
    low, high, _ = DISTANCE_BANDS_M[int(rng.choice(len(shares), p=shares))]
    range_m = float(rng.uniform(low, high))
    height_m = float(rng.uniform(0, min(HEIGHT_MAX_M, 0.95 * range_m)))
    horizontal_m = float(np.sqrt(range_m**2 - height_m**2))
    position = np.append(horizontal_m * _unit(rng), height_m)

    vehicle_speed_m_s = VEHICLE_SPEED_M_S if rng.random() < 0.5 else HOVER_DRIFT_M_S
    target_speed_m_s = float(rng.uniform(*TARGET_SPEED_M_S)) if rng.random() < 0.5 else 0.0
    velocity = np.append(vehicle_speed_m_s * _unit(rng) - target_speed_m_s * _unit(rng), 0.0)
    track = position + CAPTURE_INTERVAL_S * np.arange(captures)[:, None] * velocity

    foliage_db = penetration_db = 0.0
    if not line_of_sight:
        foliage_db = FOLIAGE_DB_PER_M * float(rng.uniform(0, FOLIAGE_DEPTH_MAX_M))
        constant, slope, sigma_db = PENETRATION[int(rng.integers(2))]
        mean_db = 10 * np.log10(constant + slope * (FREQUENCY_HZ * 1e-9) ** 2)
        penetration_db = max(float(rng.normal(mean_db, sigma_db)), 0.0)

    exponent, shadow_db = PATH_LOSS[line_of_sight]
    free_space_1m_db = 20 * np.log10(4 * np.pi * FREQUENCY_HZ / SPEED_OF_LIGHT_M_S)
    step_m = CAPTURE_INTERVAL_S * float(np.linalg.norm(velocity))
    loss_db = free_space_1m_db + 10 * exponent * np.log10(np.linalg.norm(track, axis=1))
    loss_db += shadow_db * _correlated(rng, captures, np.exp(-step_m / SHADOWING_DISTANCE_M))
    return LinkGeometry(
        position_enu_m=track,
        line_of_sight=line_of_sight,
        transmit_power_dbm=float(rng.uniform(*TRANSMIT_POWER_DBM)),
        large_scale_gain_db=-loss_db - foliage_db - penetration_db,
        foliage_db=foliage_db,
        penetration_db=penetration_db,
        target_speed_m_s=target_speed_m_s,
        vehicle_speed_m_s=vehicle_speed_m_s,
    )


def reported_angles_deg(geometry: LinkGeometry) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(captures,) azimuth and zenith angle from vehicle to beacon, degrees, as the paper reports them.

    Azimuth from east, counter-clockwise, 0…359; zenith angle 0 straight up. LOS angles are
    rounded to one degree (an error of σ = 0.29°), NLOS angles are zero.
    """
    x, y, z = geometry.position_enu_m.T
    if not geometry.line_of_sight:
        return np.zeros(len(x)), np.zeros(len(x))
    azimuth = np.rint(np.rad2deg(np.arctan2(-y, -x)) % 360) % 360
    return azimuth, np.rint(np.rad2deg(np.arccos(-z / geometry.range_m)))


def _unit(rng: np.random.Generator) -> NDArray[np.float64]:
    """(2,) a direction in the plane."""
    heading_rad = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(heading_rad), np.sin(heading_rad)])


def _correlated(rng: np.random.Generator, count: int, keep: float) -> NDArray[np.float64]:
    """(count,) a first-order Gauss–Markov process of unit variance."""
    values = rng.standard_normal(count)
    for index in range(1, count):
        values[index] = keep * values[index - 1] + np.sqrt(1 - keep * keep) * values[index]
    return values
