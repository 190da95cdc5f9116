"""Received power and angles of the studies' links: the paper's V-C channels and the data set's own.

Exists so that a case names its channel, and solvers, limits and reports see the same one.
Rules: every channel is vectorised over trials and links; received power is reported on the
scale of eq. (7), P = P_t at one metre of a LOS link (the reference loss over the first metre
is known to any receiver that knows its frequency, and taken out); what solvers are told of a
channel (``told``) is fixed beforehand, never fitted to the trials.

Values that the paper does not give are ours and marked so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from groundstation.localization import SignalModel
from groundstation.localization.problem import BoolArray, FloatArray
from sim_sitl.propagation import RUBBLE_LENGTH_M, RUBBLE_REFERENCE_LOSS_DB

TRANSMIT_POWER_DBM = (13.0, 18.0)
"""Uniform, each trial (V-C)."""
BIAS_MAX_DB = (6.0, 8.0)
"""b_max that the robust solvers assume, uniform, each trial (V-C)."""
FRIIS_1M_DB = 20.0 * math.log10(900.0) - 27.55
"""Eq. (10) at one metre and 900 MHz."""
CALIBRATION_DISTANCE_M = 100.0
"""Where the rubble channel's mean level is set to that of eq. (8)."""


class Channel(Protocol):
    """How received power comes about."""

    @property
    def told(self) -> SignalModel:
        """What solvers are told of it; angles as in V-C at 1°."""
        ...

    @property
    def bias_max_db(self) -> tuple[float, float]:
        """Range of b_max that the robust solvers assume, uniform over trials."""
        ...

    def loss_db(self, offset_m: FloatArray, line_of_sight: BoolArray, rng: np.random.Generator) -> FloatArray:
        """(N, K) loss beyond the reference, dB, shadowing and all.

        ``offset_m`` (N, K, 3) from target to vehicle, ``line_of_sight`` (N, K).
        """
        ...


@dataclass(frozen=True, slots=True)
class AnalyticChannel:
    """Eq. (7) on LOS links, eq. (8) on the others."""

    los_exponent: float = 2.5
    """β of LOS links."""
    nlos_exponent: tuple[float, float] = (2.0, 3.5)
    """Range of β of NLOS links, uniform."""
    bias_db: tuple[float, float] = (0.0, 7.0)
    """Range of b_k, uniform, each link its own."""
    shadowing_db: float = 5.0
    """σ_s of every link."""
    exponent_per_link: bool = False
    """Whether each link draws its own β; else one serves the trial's NLOS links."""

    @property
    def told(self) -> SignalModel:
        """The truth."""
        return SignalModel(
            rss_std_db=self.shadowing_db, nlos_rss_std_db=self.shadowing_db, los_exponent=self.los_exponent,
            nlos_exponent_min=self.nlos_exponent[0], nlos_exponent_max=self.nlos_exponent[1],
            nlos_bias_max_db=self.bias_db[1],
        )  # fmt: skip

    @property
    def bias_max_db(self) -> tuple[float, float]:
        """The paper's."""
        return BIAS_MAX_DB

    def loss_db(self, offset_m: FloatArray, line_of_sight: BoolArray, rng: np.random.Generator) -> FloatArray:
        """(N, K) of eqs. (7) and (8)."""
        count, links = line_of_sight.shape
        drawn = rng.uniform(*self.nlos_exponent, (count, links if self.exponent_per_link else 1))
        exponent = np.where(line_of_sight, self.los_exponent, drawn)
        bias = np.where(line_of_sight, 0.0, rng.uniform(*self.bias_db, (count, links)))
        shadowing = self.shadowing_db * rng.standard_normal((count, links))
        path: FloatArray = 10.0 * exponent * np.log10(np.linalg.norm(offset_m, axis=-1))
        return path + bias - shadowing


@dataclass(frozen=True, slots=True)
class RubbleChannel:
    """The paper's own construction: Friis (10) over the clear part, eq. (11) through rubble, and a bias.

    The paper samples measured parameters that are not public: every value here is ours. Beside
    eq. (8) the construction loses about 92 dB more; as reported, that constant is taken out, such
    that the mean level at 100 m is that of eq. (8) with its mean exponent and bias. A constant
    that is known changes no limit, but it spares every method a gross error of scale.
    """

    exponent: tuple[float, float] = (2.0, 4.5)
    """Range of β of (11), uniform, one a trial."""
    excess_loss_db: tuple[float, float] = (5.0, 25.0)
    """Range of what L₀ holds beyond free space, uniform, one a trial."""
    shadowing_db: tuple[float, float] = (3.0, 7.0)
    """Range of σ_SF, uniform, one a trial."""
    length_m: tuple[float, float] = RUBBLE_LENGTH_M
    """Range of d_NLOS, uniform, each link its own."""
    bias_db: tuple[float, float] = (0.0, 7.0)
    """Range of b_k, uniform, each link its own."""
    rician_k: tuple[float, float] = (0.0, 2.0)
    """Range of the small-scale K-factor, linear, uniform, each link its own: Rayleigh to 3 dB."""
    fading_samples: int = 16
    """M of eq. (5): powers averaged into one."""
    reference_loss_db: float = RUBBLE_REFERENCE_LOSS_DB
    """L₀ of (11) without its excess."""
    los_exponent: float = 2.5
    """β of LOS links, eq. (7)."""
    los_shadowing_db: float = 5.0
    """σ_s of LOS links."""

    @property
    def reported_db(self) -> float:
        """The constant taken out of every NLOS link's loss, dB."""
        length = np.linspace(*self.length_m, 4001)
        clear = 20.0 * np.log10(CALIBRATION_DISTANCE_M - length).mean() + FRIIS_1M_DB
        through = self.reference_loss_db + np.mean(self.excess_loss_db)
        through += 10.0 * np.mean(self.exponent) * np.log10(length).mean()
        fading = self.fading_moments_db()[0]
        usual = AnalyticChannel()
        path = 10.0 * np.mean(usual.nlos_exponent) * math.log10(CALIBRATION_DISTANCE_M)
        bias = np.mean(self.bias_db) - np.mean(usual.bias_db)
        return float(clear + through + bias - fading - path)

    @property
    def told(self) -> SignalModel:
        """Eq. (8) with the spread of this construction: a link's in σ_s, the trial's in the power's range."""
        length = np.linspace(*self.length_m, 1001)
        betas = np.linspace(*self.exponent, 101)[:, None]
        lost = 20.0 * np.log10(CALIBRATION_DISTANCE_M - length) + 10.0 * betas * np.log10(length)
        (least, most), fading = self.shadowing_db, self.fading_moments_db()[1]
        link = lost.var(axis=1).mean() + (least**2 + least * most + most**2) / 3.0 + fading**2
        shared = lost.mean(axis=1).var() + np.ptp(self.excess_loss_db) ** 2 / 12.0
        low, high = TRANSMIT_POWER_DBM
        half = math.sqrt(3.0 * (shared + (high - low) ** 2 / 12.0))
        return SignalModel(
            rss_std_db=self.los_shadowing_db, los_exponent=self.los_exponent,
            nlos_rss_std_db=math.sqrt(link), nlos_bias_max_db=self.bias_db[1],
            transmit_power_min_dbm=0.5 * (low + high) - half,
            transmit_power_max_dbm=0.5 * (low + high) + half,
        )  # fmt: skip

    @property
    def bias_max_db(self) -> tuple[float, float]:
        """The paper's."""
        return BIAS_MAX_DB

    def fading_moments_db(self) -> tuple[float, float]:
        """Mean and standard deviation of the small-scale term, dB, to second order in its variance."""
        k = np.linspace(*self.rician_k, 201)
        relative = float(np.mean((1.0 + 2.0 * k) / np.square(1.0 + k))) / self.fading_samples
        scale = 10.0 / math.log(10.0)
        return -0.5 * scale * relative, scale * math.sqrt(relative * (1.0 + 0.5 * relative))

    def loss_db(self, offset_m: FloatArray, line_of_sight: BoolArray, rng: np.random.Generator) -> FloatArray:
        """(N, K) of eqs. (9)–(11) with the bias of (8), less ``reported_db``; eq. (7) on LOS links."""
        shape = line_of_sight.shape
        distance = np.linalg.norm(offset_m, axis=-1)
        trial = (shape[0], 1)
        beta, excess = rng.uniform(*self.exponent, trial), rng.uniform(*self.excess_loss_db, trial)
        sigma = rng.uniform(*self.shadowing_db, trial)
        length, bias = rng.uniform(*self.length_m, shape), rng.uniform(*self.bias_db, shape)
        shadowing = rng.standard_normal(shape)
        k = rng.uniform(*self.rician_k, shape)[..., None]
        wave = np.sqrt(0.5 / (k + 1.0)) * rng.standard_normal((2, *shape, self.fading_samples))
        wave[0] += np.sqrt(k / (k + 1.0))
        fading = 10.0 * np.log10(np.square(wave).sum(axis=0).mean(axis=-1))
        friis = 20.0 * np.log10(np.maximum(distance - length, 1.0)) + FRIIS_1M_DB
        through = self.reference_loss_db + excess + 10.0 * beta * np.log10(length) - sigma * shadowing
        obstructed = friis + through + bias - fading - self.reported_db
        clear = 10.0 * self.los_exponent * np.log10(distance) - self.los_shadowing_db * shadowing
        loss: FloatArray = np.where(line_of_sight, clear, obstructed)
        return loss


@dataclass(frozen=True, slots=True)
class AngleReport:
    """What the arrays report."""

    std_deg: float = 1.0
    """σ_θ = σ_φ of LOS links, degrees; 0 with ``rounded_deg``."""
    rounded_deg: float = 0.0
    """LOS angles are rounded to it, degrees; 0: not rounded."""
    nlos_zero: bool = False
    """NLOS angles are reported as zero, as the paper's rows are; else uniform, as a real array's."""

    @property
    def told_std_rad(self) -> float:
        """σ that solvers are told: noise and rounding together."""
        return math.radians(math.hypot(self.std_deg, self.rounded_deg / math.sqrt(12.0)))

    def draw(
        self, offset_m: FloatArray, line_of_sight: BoolArray, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """(N, K) azimuth and elevation from vehicle to target, radians, eqs. (1)–(4).

        ``offset_m`` (N, K, 3) from target to vehicle. An elevation that noise carries over the
        nadir comes out on the other side of it, as it does on an array.
        """
        shape = line_of_sight.shape
        azimuth = np.arctan2(-offset_m[..., 1], -offset_m[..., 0])
        elevation = np.arctan2(-offset_m[..., 2], np.hypot(offset_m[..., 0], offset_m[..., 1]))
        std = math.radians(self.std_deg)
        azimuth = azimuth + std * rng.standard_normal(shape)
        elevation = elevation + std * rng.standard_normal(shape)
        if self.rounded_deg > 0.0:
            step = math.radians(self.rounded_deg)
            azimuth, elevation = step * np.rint(azimuth / step), step * np.rint(elevation / step)
        over = np.abs(elevation) > 0.5 * math.pi
        azimuth = wrapped_rad(np.where(over, azimuth + math.pi, azimuth))
        elevation = np.where(over, np.copysign(math.pi, elevation) - elevation, elevation)
        wrong_azimuth = rng.uniform(-math.pi, math.pi, shape)
        wrong_elevation = rng.uniform(-0.5 * math.pi, 0.5 * math.pi, shape)
        if self.nlos_zero:
            wrong_azimuth, wrong_elevation = np.zeros(shape), np.zeros(shape)
        return (
            np.where(line_of_sight, azimuth, wrong_azimuth),
            np.where(line_of_sight, elevation, wrong_elevation),
        )


def wrapped_rad(angle_rad: FloatArray) -> FloatArray:
    """An angle in (−π, π]."""
    result: FloatArray = math.pi - np.mod(math.pi - angle_rad, 2.0 * math.pi)
    return result


def told_model(channel: Channel, angles: AngleReport) -> SignalModel:
    """The signal model that solvers are given."""
    std = angles.told_std_rad
    return replace(channel.told, azimuth_std_rad=std, elevation_std_rad=std)
