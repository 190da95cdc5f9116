"""The paths of a link through its captures, from two unlike channel models.

Why: a classifier that has seen one generator knows that generator. The plain data are
NYUSIM's (:mod:`sim_sitl.cir`); the randomised ones draw part of their links from the
3GPP cluster model (TR 38.901, 7.5), which differs in how line of sight shows: a K-factor over
Rayleigh clusters instead of a strongest subpath that comes first. Rule kept here: a label
is drawn first, then a channel of that label.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_sitl.cir import SPEED_OF_LIGHT_M_S, ClusterTable, draw_channel
from sim_sitl.dataset.geometry import FREQUENCY_HZ, LinkGeometry


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """What reaches the vehicle, capture by capture."""

    delay_ns: NDArray[np.float64]
    """(paths,) after the first path."""
    amplitude: NDArray[np.complex128]
    """(captures, paths); powers sum to one in each capture on average over phases."""
    cluster: NDArray[np.int64]
    """(paths,)"""
    direction_enu: NDArray[np.float64]
    """(paths, 3) unit vectors from the vehicle towards where each comes from."""


@dataclass(frozen=True, slots=True)
class ScenarioTable:
    """Table 7.5-6 of TR 38.901 for one scenario and state of obstruction, at 6 GHz and below."""

    lg_delay_spread: float
    """Mean of log₁₀(delay spread / s)."""
    lg_delay_spread_sigma: float
    k_factor_db: tuple[float, float] | None
    """Mean and σ; None without a line of sight."""
    delay_scaling: float
    """r_τ."""
    clusters: int
    cluster_shadowing_db: float
    cluster_spread_ns: float
    """c_DS: delay spread within the two strongest clusters."""
    azimuth_spread_deg: float
    ray_spread_deg: float
    """c_ASA."""


UMA = {
    True: ScenarioTable(-7.03, 0.66, (9.0, 3.5), 2.5, 12, 3.0, 3.91, 64.6, 11.0),
    False: ScenarioTable(-6.44, 0.39, None, 2.3, 20, 3.0, 3.91, 74.0, 15.0),
}
UMI = {
    True: ScenarioTable(-7.34, 0.38, (9.0, 5.0), 3.0, 12, 3.0, 5.0, 46.0, 17.0),
    False: ScenarioTable(-7.03, 0.42, None, 2.1, 19, 3.0, 11.0, 56.0, 22.0),
}
INDOOR_OFFICE = {
    True: ScenarioTable(-7.70, 0.18, (7.0, 4.0), 3.6, 15, 6.0, 3.91, 33.0, 8.0),
    False: ScenarioTable(-7.41, 0.14, None, 3.0, 19, 3.0, 3.91, 50.0, 11.0),
}
RAYS = 20
_SUBCLUSTER_OF_RAY = np.repeat([0.0, 1.28, 2.56], [10, 6, 4])
"""(RAYS,) delay of a ray of the two strongest clusters, in c_DS."""
_WEAKEST_CLUSTER_DB = -25.0


def nyusim_paths(
    rng: np.random.Generator,
    geometry: LinkGeometry,
    table: ClusterTable | None = None,
    first_path_gain_db: float = 0.0,
) -> Paths:
    """Paths of the time-cluster model, evolving with the vehicle's movement (12 m)."""
    channel = draw_channel(
        rng,
        line_of_sight=geometry.line_of_sight,
        frequency_hz=FREQUENCY_HZ,
        first_path_direction_enu=-geometry.position_enu_m[0],
        table=table,
        first_path_gain_db=first_path_gain_db,
    )
    amplitudes = [np.sqrt(channel.power) * np.exp(1j * channel.phase_rad)]
    for step_m in np.diff(geometry.position_enu_m, axis=0):
        channel = channel.moved(rng, step_m)
        amplitudes.append(np.sqrt(channel.power) * np.exp(1j * channel.phase_rad))
    return Paths(channel.delay_ns, np.array(amplitudes), channel.cluster, channel.direction_enu)


def scenario_paths(
    rng: np.random.Generator,
    geometry: LinkGeometry,
    table: ScenarioTable,
    first_path_gain_db: float = 0.0,
) -> Paths:
    """Paths of TR 38.901, 7.5 (steps 5 to 11; one polarisation), rays turning with the movement.

    ``first_path_gain_db`` is put on the first arrival on top of the model.
    """
    delay_spread_ns = 1e9 * 10 ** rng.normal(table.lg_delay_spread, table.lg_delay_spread_sigma)
    draw = rng.exponential(table.delay_scaling * delay_spread_ns, table.clusters)
    delay_ns = np.sort(draw) - draw.min()
    power = np.exp(-delay_ns * (table.delay_scaling - 1) / (table.delay_scaling * delay_spread_ns))
    power *= 10 ** (-table.cluster_shadowing_db * rng.standard_normal(table.clusters) / 10)
    power /= power.sum()
    specular = 0.0
    if table.k_factor_db is not None:
        k_db = float(np.clip(rng.normal(*table.k_factor_db), -5.0, 20.0))
        # Eq. (7.5-3): a strong direct path would else shorten the delay spread.
        delay_ns /= 0.7705 - 0.0433 * k_db + 0.0002 * k_db**2 + 0.000017 * k_db**3
        specular = 10 ** (k_db / 10) / (1 + 10 ** (k_db / 10))
        power *= 1 - specular
    kept = power >= 10 ** (_WEAKEST_CLUSTER_DB / 10) * (power.max() + specular)
    kept[0] = True
    delay_ns, power = delay_ns[kept], power[kept]

    towards = -geometry.position_enu_m[0] / np.linalg.norm(geometry.position_enu_m[0])
    azimuth = np.arctan2(towards[1], towards[0]) + np.deg2rad(table.azimuth_spread_deg) * rng.standard_normal(
        len(power)
    )
    elevation = np.deg2rad(9.0) * rng.standard_normal(len(power))
    ray_azimuth = azimuth[:, None] + np.deg2rad(table.ray_spread_deg) * rng.standard_normal(
        (len(power), RAYS)
    )
    ray_elevation = elevation[:, None] + np.deg2rad(3.0) * rng.standard_normal((len(power), RAYS))
    ray_delay_ns = np.repeat(delay_ns[:, None], RAYS, axis=1)
    strongest = np.argsort(power)[-2:]
    ray_delay_ns[strongest] += table.cluster_spread_ns * _SUBCLUSTER_OF_RAY
    ray_power = np.repeat(power[:, None] / RAYS, RAYS, axis=1)
    cluster = np.repeat(np.arange(len(power)), RAYS)
    direction = np.stack(
        [
            np.cos(ray_elevation) * np.cos(ray_azimuth),
            np.cos(ray_elevation) * np.sin(ray_azimuth),
            np.sin(ray_elevation),
        ],
        axis=-1,
    ).reshape(-1, 3)
    gain = 10 ** (first_path_gain_db / 10)
    if specular:
        delays = np.append(0.0, ray_delay_ns.ravel())
        powers = np.append(gain * specular, ray_power.ravel())
        cluster, direction = np.append(0, cluster), np.vstack([towards, direction])
    else:
        ray_power[0] *= gain
        delays, powers = ray_delay_ns.ravel(), ray_power.ravel()
    powers /= powers.sum()
    moved_m = geometry.position_enu_m - geometry.position_enu_m[0]
    phase = rng.uniform(0, 2 * np.pi, len(powers))
    phase = phase + 2 * np.pi * FREQUENCY_HZ / SPEED_OF_LIGHT_M_S * (moved_m @ direction.T)
    return Paths(delays, np.sqrt(powers) * np.exp(1j * phase), cluster, direction)
