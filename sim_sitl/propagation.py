"""Received level and angle of one packet on one link.

Line of sight, eq. (7) with a close-in reference (the loss over the first metre):
    P = P_t − L_ref − 10 β log₁₀ d + s·σ_LOS
Obstructed, eq. (8) (``log-distance``):
    P = P_t − L_ref − 10 β_n log₁₀ d − b + s·σ_NLOS,   b = b_max (1 − e^(−A/b_max))
with A the attenuation that the geometry says. Obstructed by rubble, eqs. (9)–(11) (``rubble``):
    P = P_t − 20 log₁₀ d_LOS − L_ref − (31.5 + excess) − 10 β_r log₁₀ d_NLOS − s·σ_SF
s is a unit Gaussian field in space, correlated as exp(−Δ/d_corr) (Gudmundson), each vehicle
and beacon its own. On top: small-scale Rician fading averaged over a packet, and the
measurement's noise. β_n, β_r, excess and σ_SF belong to the beacon (its rubble), and are the
same for every vehicle. The values of the rubble model are ours: the measurements the paper
samples from are not public.

Shares nothing with the station's signal model, by rule.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.domain.geometry import Enu
from sim_sitl.randomness import Stream, generator
from sim_sitl.scenario import BeaconSpec, PropagationSpec, ReceiverSpec
from sim_sitl.world import Obstruction

RUBBLE_REFERENCE_LOSS_DB = 31.5
"""Free space at 1 m and 900 MHz: L₀ of eq. (11) without its excess."""
RUBBLE_LENGTH_M = (1.0, 20.0)
"""Obstructed lengths eq. (11) is used with."""
THERMAL_NOISE_DBM_HZ = -174.0
SHADOWING_MODES = 256
ANTENNA_FLOOR_DB = 20.0
"""An antenna pattern never attenuates by more."""


class ShadowingField:
    """A unit Gaussian field over space, correlated as exp(−Δ/d_corr).

    A sum of plane waves whose wave vectors are drawn from the field's spectrum: in three
    dimensions that of exp(−Δ/d) is the multivariate Cauchy density of scale 1/d.
    """

    def __init__(self, rng: np.random.Generator, correlation_distance_m: float) -> None:
        normal = rng.standard_normal((SHADOWING_MODES, 3))
        scale = np.abs(rng.standard_normal((SHADOWING_MODES, 1)))
        self._wave_rad_m: NDArray[np.float64] = normal / np.maximum(scale, 1e-6) / correlation_distance_m
        # Gaussian amplitudes make every point exactly normal over the ensemble of fields.
        self._cosine: NDArray[np.float64] = rng.standard_normal(SHADOWING_MODES)
        self._sine: NDArray[np.float64] = rng.standard_normal(SHADOWING_MODES)

    def at(self, position_enu_m: Enu) -> float:
        """The field at a place (ENU, metres), unit variance."""
        phase = self._wave_rad_m @ np.array(position_enu_m)
        total = self._cosine @ np.cos(phase) + self._sine @ np.sin(phase)
        return float(total) / math.sqrt(SHADOWING_MODES)


@dataclass(frozen=True, slots=True)
class Reception:
    """One packet as the sensor measured it."""

    heard: bool
    """Whether it reached the sensitivity."""
    rss_dbm: float
    """As reported: with the sensor's offset."""
    noise_dbm: float
    """As reported."""
    snr_db: float
    azimuth_rad: float
    """Earth frame: from east, counter-clockwise."""
    elevation_rad: float
    """Positive up."""
    angle_std_rad: float
    """What the sensor claims. It cannot know of a reflection."""
    obstruction: Obstruction


class LinkChannel:
    """One vehicle's channel to one beacon; every packet is one call."""

    def __init__(
        self,
        propagation: PropagationSpec,
        receiver: ReceiverSpec,
        beacon: BeaconSpec,
        *,
        seed: int,
        vehicle_id: int,
        beacon_key: int,
    ) -> None:
        self._spec = propagation
        self._receiver = receiver
        self._beacon = beacon
        self._seed = seed
        self._key = (vehicle_id, beacon_key)
        self._field = ShadowingField(
            generator(seed, Stream.SHADOWING, vehicle_id, beacon_key), propagation.shadowing_distance_m
        )
        self._fading = generator(seed, Stream.FADING, vehicle_id, beacon_key)
        self._angles = generator(seed, Stream.ANGLE, vehicle_id, beacon_key)
        material = generator(seed, Stream.MATERIAL, beacon_key)
        self._nlos_exponent = material.uniform(*propagation.nlos_exponent)
        self._rubble_exponent = material.uniform(*propagation.rubble_exponent)
        self._rubble_excess_db = material.uniform(*propagation.rubble_excess_db)
        self._rubble_shadowing_db = material.uniform(*propagation.rubble_shadowing_db)
        misalignment = generator(seed, Stream.ANGLE, vehicle_id).standard_normal(2)
        self._reflector_cell: tuple[int, ...] = ()
        self._reflector_angle = (0.0, 0.0)
        self._bias_rad = np.radians(receiver.angle_bias_deg) * misalignment

    def median_loss_db(self, obstruction: Obstruction) -> float:
        """Path loss without shadowing and fading, dB."""
        spec = self._spec
        distance = max(obstruction.distance_m, 1.0)
        if obstruction.line_of_sight:
            return spec.reference_loss_db + 10 * spec.los_exponent * math.log10(distance)
        if spec.nlos_model == "rubble":
            obstructed = min(max(obstruction.length_m, RUBBLE_LENGTH_M[0]), RUBBLE_LENGTH_M[1])
            clear = max(distance - obstructed, 1.0)
            friis = 20 * math.log10(clear) + 20 * math.log10(self._beacon.frequency_hz / 1e6) - 27.55
            through = RUBBLE_REFERENCE_LOSS_DB + self._rubble_excess_db
            return friis + through + 10 * self._rubble_exponent * math.log10(obstructed)
        bias = 0.0
        if spec.nlos_bias_max_db > 0:
            bias = spec.nlos_bias_max_db * -math.expm1(-obstruction.loss_db / spec.nlos_bias_max_db)
        return spec.reference_loss_db + 10 * self._nlos_exponent * math.log10(distance) + bias

    def shadowing_sigma_db(self, obstruction: Obstruction) -> float:
        """Standard deviation of the shadowing field on this kind of link, dB."""
        if obstruction.line_of_sight:
            return self._spec.los_shadowing_db
        return (
            self._rubble_shadowing_db if self._spec.nlos_model == "rubble" else self._spec.nlos_shadowing_db
        )

    def receive(self, vehicle_enu_m: Enu, obstruction: Obstruction) -> Reception:
        """One packet heard from ``vehicle_enu_m`` (ENU, metres)."""
        receiver = self._receiver
        toward = _direction(vehicle_enu_m, self._beacon.position_enu_m)
        level = self._beacon.transmit_power_dbm - self.median_loss_db(obstruction)
        level += self.shadowing_sigma_db(obstruction) * self._field.at(vehicle_enu_m)
        level += self._fading_db(obstruction.line_of_sight)
        level -= self._antenna_loss_db(toward[1])
        level += receiver.level_noise_db * float(self._fading.standard_normal())
        noise = THERMAL_NOISE_DBM_HZ + 10 * math.log10(receiver.bandwidth_hz) + receiver.noise_figure_db
        azimuth, elevation = self._angle(toward, vehicle_enu_m, obstruction.line_of_sight)
        return Reception(
            heard=level >= receiver.sensitivity_dbm,
            rss_dbm=level + self._spec.report_offset_db,
            noise_dbm=noise + self._spec.report_offset_db,
            snr_db=level - noise,
            azimuth_rad=azimuth,
            elevation_rad=elevation,
            angle_std_rad=math.radians(max(receiver.angle_noise_deg, 0.01)),
            obstruction=obstruction,
        )

    def _fading_db(self, line_of_sight: bool) -> float:
        """Mean power of several independent Rician fades, dB about a mean of one."""
        spec = self._spec
        k = 10 ** ((spec.los_rician_k_db if line_of_sight else spec.nlos_rician_k_db) / 10)
        parts = self._fading.standard_normal((spec.fading_averages, 2)) * math.sqrt(0.5 / (k + 1))
        parts[:, 0] += math.sqrt(k / (k + 1))
        return 10 * math.log10(max(float(np.mean(np.sum(parts**2, axis=1))), 1e-6))

    def _antenna_loss_db(self, elevation_rad: float) -> float:
        beamwidth = self._receiver.antenna_beamwidth_deg
        if beamwidth == 0.0:
            return 0.0
        off_deg = math.degrees(elevation_rad) + self._receiver.antenna_downtilt_deg
        return min(12 * (off_deg / beamwidth) ** 2, ANTENNA_FLOOR_DB)

    def _angle(
        self, toward: tuple[float, float], vehicle_enu_m: Enu, line_of_sight: bool
    ) -> tuple[float, float]:
        white = self._angles.standard_normal(2)
        if line_of_sight:
            noise = math.radians(self._receiver.angle_noise_deg) * white
            azimuth, elevation = toward[0], toward[1]
        else:
            # The strongest reflector is seen instead: anywhere, but the same one for a while.
            noise = math.radians(self._receiver.reflection_spread_deg) * white
            azimuth, elevation = self._reflector(vehicle_enu_m)
        azimuth += float(noise[0] + self._bias_rad[0])
        elevation += float(noise[1] + self._bias_rad[1])
        # Over the zenith or the nadir the bearing comes out on the other side.
        if abs(elevation) > math.pi / 2:
            elevation = math.copysign(math.pi, elevation) - elevation
            azimuth += math.pi
        return math.remainder(azimuth, 2 * math.pi), elevation

    def _reflector(self, vehicle_enu_m: Enu) -> tuple[float, float]:
        """(azimuth, elevation) of what is seen instead from this cell of space."""
        cell = tuple(math.floor(x / self._spec.shadowing_distance_m) + 2**20 for x in vehicle_enu_m[:2])
        if cell != self._reflector_cell:
            rng = generator(self._seed, Stream.REFLECTOR, *self._key, *cell)
            self._reflector_cell = cell
            self._reflector_angle = (
                float(rng.uniform(-math.pi, math.pi)),
                float(rng.uniform(math.radians(-80), math.radians(5))),
            )
        return self._reflector_angle


def _direction(from_enu_m: Enu, to_enu_m: Enu) -> tuple[float, float]:
    """(azimuth, elevation) from one place to another: eqs. (1)–(2)."""
    east, north, up = (b - a for a, b in zip(from_enu_m, to_enu_m, strict=True))
    return math.atan2(north, east), math.atan2(up, math.hypot(east, north))
