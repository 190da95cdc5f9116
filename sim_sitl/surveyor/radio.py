"""The channel of one survey: power at any pose, readings of a receiver that loses lock.

Two rays over ground (Fresnel coefficient of a vertical polarisation, weakened by roughness),
half-wave dipoles at both ends (the transmitter's tilted, the receiver's fixed to the airframe), a
random pattern of the airframe in body azimuth, shadowing with an exponential correlation over the
vehicle's place, Rician fading, outliers. Rule: the mean power is a function of the pose, the same
at the same place; what changes with time is in ``samples`` alone.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_sitl.randomness import Stream, generator
from sim_sitl.surveyor.survey import Survey

FloatArray = NDArray[np.float64]

_LIGHT_M_S = 299_792_458.0
_WAVES = 240


class Radio:
    """The channel of one survey: power at any pose, the same at the same place."""

    def __init__(self, survey: Survey) -> None:
        self._survey = survey
        rng = generator(survey.seed, Stream.SURVEY, 1)
        tilt, toward = survey.transmitter_tilt_rad, rng.uniform(0.0, 2.0 * math.pi)
        self._transmitter_axis = np.array(
            [math.sin(tilt) * math.cos(toward), math.sin(tilt) * math.sin(toward), math.cos(tilt)]
        )
        # Frequencies of a field with exponential correlation: Student-t with one degree of freedom.
        waves = rng.normal(size=(_WAVES, 2)) / np.sqrt(rng.chisquare(1.0, size=(_WAVES, 1)))
        self._wave_rad_m = waves / survey.shadowing_m
        self._phase_rad = rng.uniform(0.0, 2.0 * math.pi, _WAVES)
        # So that the pattern's root mean square over the azimuth is that size on average.
        self._airframe = survey.airframe_std_db * rng.normal(size=(3, 2)) / math.sqrt(3.0)

    def mean_power_db(self, position_enu_m: FloatArray, attitude_rad: FloatArray) -> FloatArray:
        """(n,) without fading, dB over the threshold of lock; (n, 3) metres and (n, 3) radians."""
        survey = self._survey
        target = np.array(survey.target_enu_m)
        wave_m = _LIGHT_M_S / survey.frequency_hz
        axes = _body_axes(attitude_rad)
        field: Any = 0.0
        for image in (1.0, -1.0):
            source = target * np.array([1.0, 1.0, image])
            ray = position_enu_m - source
            distance = np.linalg.norm(ray, axis=1)
            ray = ray / distance[:, None]
            # The reflected ray leaves the antenna downwards.
            leaving = ray * np.array([1.0, 1.0, image])
            amplitude = _dipole(leaving @ self._transmitter_axis) * _dipole(
                np.einsum("ni,ni->n", ray, axes[:, 2])
            )
            if image < 0.0:
                amplitude = amplitude * self._reflection(ray[:, 2], wave_m)
            field = field + amplitude / distance * np.exp(-2j * math.pi * distance / wave_m)
        power = 20.0 * np.log10(np.maximum(np.abs(field), 1e-12)) + 40.0 + survey.margin_db
        way = position_enu_m - target
        power -= survey.clutter_db_per_m * np.hypot(way[:, 0], way[:, 1])
        result: FloatArray = power + self._airframe_db(way, axes) + self._shadowing_db(position_enu_m)
        return result

    def _reflection(self, sine: FloatArray, wave_m: float) -> FloatArray:
        """Fresnel's coefficient, weakened by the ground's roughness (Ament)."""
        relative = self._survey.ground_permittivity
        root = np.sqrt(relative - (1.0 - sine**2))
        smooth = (relative * sine - root) / (relative * sine + root)
        rough = np.exp(-2.0 * (2.0 * math.pi / wave_m * self._survey.roughness_m * sine) ** 2)
        result: FloatArray = smooth * rough
        return result

    def _airframe_db(self, from_target_m: FloatArray, axes: FloatArray) -> FloatArray:
        toward = -from_target_m / np.linalg.norm(from_target_m, axis=1)[:, None]
        forward = np.einsum("ni,ni->n", toward, axes[:, 0])
        right = np.einsum("ni,ni->n", toward, axes[:, 1])
        azimuth = np.arctan2(right, forward)
        order = np.arange(1, 4)[:, None]
        waves = self._airframe[:, :1] * np.cos(order * azimuth) + self._airframe[:, 1:] * np.sin(
            order * azimuth
        )
        result: FloatArray = waves.sum(axis=0) * np.hypot(forward, right)
        return result

    def _shadowing_db(self, position_enu_m: FloatArray) -> FloatArray:
        phase = position_enu_m[:, :2] @ self._wave_rad_m.T + self._phase_rad
        result: FloatArray = (
            self._survey.shadowing_std_db * math.sqrt(2.0 / _WAVES) * np.cos(phase).sum(axis=1)
        )
        return result

    def samples(
        self,
        position_enu_m: FloatArray,
        attitude_rad: FloatArray,
        interval_s: float,
        rng: np.random.Generator,
    ) -> tuple[FloatArray, Any]:
        """(n,) readings of consecutive samples in the receiver's decibels, and which were given."""
        survey = self._survey
        mean = self.mean_power_db(position_enu_m, attitude_rad)
        k = 10.0 ** (0.1 * survey.rician_k_db)
        moved = np.linalg.norm(np.diff(position_enu_m, axis=0, prepend=position_enu_m[:1]), axis=1)
        wave_m = _LIGHT_M_S / survey.frequency_hz
        # Hovering in the wind, the scattered part changes within half a second.
        keep = np.exp(-interval_s / 0.5 - moved / (0.4 * wave_m))
        drawn = (rng.normal(size=mean.size) + 1j * rng.normal(size=mean.size)) / math.sqrt(2.0)
        scattered = np.empty(mean.size, dtype=complex)
        state = drawn[0]
        for i, stays in enumerate(keep):
            state = stays * state + math.sqrt(max(1.0 - stays**2, 0.0)) * drawn[i]
            scattered[i] = state
        fading = np.abs(math.sqrt(k / (k + 1.0)) + scattered / math.sqrt(k + 1.0))
        level = mean + 20.0 * np.log10(np.maximum(fading, 1e-3))
        level += np.where(rng.random(mean.size) < 0.01, rng.normal(0.0, 15.0, mean.size), 0.0)
        locked = level + rng.normal(0.0, 1.0, mean.size) > 0.0
        drift = np.cumsum(rng.normal(0.0, 0.4 * math.sqrt(interval_s), mean.size))
        floor = -15.0 + 3.0 * np.tanh(drift / 3.0) + rng.normal(0.0, 2.5, mean.size)
        heard = locked | (survey.unlocked == "noise")
        return np.where(locked, level, floor) + survey.unit_offset_db, heard


def _body_axes(attitude_rad: FloatArray) -> FloatArray:
    """(n, 3, 3): forward, right and up of the airframe in ENU."""
    roll, pitch, yaw = attitude_rad.T
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    forward = np.stack([cp * sy, cp * cy, sp], axis=1)
    right = np.stack([sr * sp * sy + cr * cy, sr * sp * cy - cr * sy, -sr * cp], axis=1)
    return np.stack([forward, right, np.cross(right, forward)], axis=1)


def _dipole(cosine: FloatArray) -> FloatArray:
    """Amplitude of a half-wave dipole, ``cosine`` to its axis; 25 dB deep at most."""
    sine = np.sqrt(np.maximum(1.0 - np.square(cosine), 1e-9))
    result: FloatArray = np.maximum(np.abs(np.cos(0.5 * math.pi * cosine)) / sine, 10.0 ** (-25.0 / 20.0))
    return result
