"""How a walker's particles change from one step to the next.

Exists so that what is assumed of walking stands in one place, apart from how windows are weighed.
Velocity is an Ornstein–Uhlenbeck process on each axis, a = exp(−Δ/τ), cut at 1.5 m/s:

    v(t + Δ) = a v(t) + √(1 − a²) σ ξ

Rule: nothing stays fixed for good. Of a constant that no step renews, the survivors of the
resampling soon hold a handful of values, each sure of its own, and the region is too small. So
offsets and errors of bearing slowly return to their prior, in closed form, and exponents wander.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from groundstation.localization.problem import FloatArray, SearchArea, SignalModel
from groundstation.tracking.settings import TrackingSettings
from groundstation.tracking.walking_points import Points

_OFFSET_MEMORY_S = 120.0
"""How long what was learned of a vehicle's offset counts: what stands in the way changes as one walks."""
_BEARING_MEMORY_S = 60.0
"""The same of its error of bearing."""
_EXPONENT_DRIFT = 0.02
"""Random walk of an exponent, per √s: the rubble round a walker changes."""
_CLIMB_M = 0.3
"""Random walk of the height, m per √s."""


def sent_off(points: Points, settings: TrackingSettings, rng: np.random.Generator) -> Points:
    """Points that stood still, now with a velocity each."""
    std = settings.walking_speed_std_mps
    return replace(points, velocity_mps=_slowed(std * rng.standard_normal((2, points.count)), settings))


def moved(
    points: Points,
    elapsed_s: float,
    area: SearchArea,
    model: SignalModel,
    settings: TrackingSettings,
    rng: np.random.Generator,
) -> Points:
    """Points ``elapsed_s`` later: places, velocities and exponents."""
    keep = math.exp(-elapsed_s / settings.walking_memory_s)
    kick = settings.walking_speed_std_mps * math.sqrt(1.0 - keep * keep)
    before = points.velocity_mps
    velocity = _slowed(keep * before + kick * rng.standard_normal(before.shape), settings)
    place = points.position_enu_m.copy()
    place[:2] += 0.5 * elapsed_s * (before + velocity)
    # At the area's edge one turns back.
    outside = ~area.contains(place[0], place[1])
    place[:, outside] = points.position_enu_m[:, outside]
    velocity[:, outside] *= -1.0
    # Over rubble one walks up and down.
    place[2] += _CLIMB_M * math.sqrt(elapsed_s) * rng.standard_normal(points.count)
    place[2] = np.clip(place[2], area.height_min_m, area.height_max_m)
    orders = points.orders.copy()
    orders[1] += _EXPONENT_DRIFT * math.sqrt(elapsed_s) * rng.standard_normal(points.count)
    np.clip(orders[1], model.nlos_exponent_min, model.nlos_exponent_max, out=orders[1])
    return replace(points, position_enu_m=place, velocity_mps=velocity, orders=orders)


def drifted(
    points: Points, covariance: FloatArray, elapsed_s: float, model: SignalModel
) -> tuple[Points, FloatArray]:
    """Points and the covariance (1 + V, 1 + V) of their nuisances ``elapsed_s`` later.

    Offsets and errors of bearing return to their prior; the transmit power stays.
    """
    keep = math.exp(-elapsed_s / _OFFSET_MEMORY_S)
    factor = np.full(covariance.shape[0], keep)
    factor[0] = 1.0
    covariance = covariance * factor * factor[:, None]
    offsets = np.arange(1, factor.size)
    covariance[offsets, offsets] += 1.0 - keep * keep
    kept = math.exp(-elapsed_s / _BEARING_MEMORY_S)
    prior = model.angle_bias_std_rad**2
    return replace(
        points,
        nuisance=points.nuisance * factor[:, None],
        bias_rad=kept * points.bias_rad,
        bias_rad2=prior + kept * kept * (points.bias_rad2 - prior),
    ), covariance


def _slowed(velocity_mps: FloatArray, settings: TrackingSettings) -> FloatArray:
    limit = settings.walking_speed_max_mps
    slowed: FloatArray = velocity_mps * (limit / np.maximum(np.hypot(*velocity_mps), limit))
    return slowed
