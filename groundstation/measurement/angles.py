"""Rotations and bearings: from a sensor's angles to the paper's.

A sensor speaks of north, east, down or of its airframe (forward, right, down): azimuth from
x towards y, elevation positive up, bearing (cos el cos az, cos el sin az, −sin el). The paper
(Gao & Sadjadpour, 2026) and everything downstream speak of azimuth counter-clockwise from
east and elevation positive up from the horizontal plane.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from groundstation.domain.geometry import Quaternion, wrap_angle_rad

Vector = tuple[float, float, float]

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)
"""Level, nose to the north."""

_COS_FLOOR = 1e-3
_SLERP_LINEAR_BELOW = 1e-6


class Bearing(NamedTuple):
    """Direction from vehicle to beacon in the paper's angles, with its standard errors."""

    azimuth_rad: float
    """Counter-clockwise from east, in [−π, π)."""
    elevation_rad: float
    """Positive up from the horizontal plane."""
    azimuth_std_rad: float | None
    """None where the sensor does not say; at most π: near the vertical an azimuth means nothing."""
    elevation_std_rad: float | None


def usable_angles(azimuth_rad: float, elevation_rad: float) -> bool:
    """Whether a reported direction is a direction: finite, and elevation within ±π/2."""
    return math.isfinite(azimuth_rad) and abs(elevation_rad) <= math.pi / 2 + 1e-6


def known_std(std_rad: float) -> float | None:
    """A reported standard error, None where it says nothing (NaN, infinite, zero or negative)."""
    return std_rad if math.isfinite(std_rad) and std_rad > 0.0 else None


def rotate(attitude: Quaternion, v: Vector) -> Vector:
    """``v`` (forward, right, down) in north, east, down: v + 2 q⃗ × (q⃗ × v + w v)."""
    w, x, y, z = attitude
    a, b, c = v
    tx = y * c - z * b + w * a
    ty = z * a - x * c + w * b
    tz = x * b - y * a + w * c
    return a + 2.0 * (y * tz - z * ty), b + 2.0 * (z * tx - x * tz), c + 2.0 * (x * ty - y * tx)


def earth_bearing(
    azimuth_rad: float, elevation_rad: float, azimuth_std_rad: float | None, elevation_std_rad: float | None
) -> Bearing:
    """Bearing from angles in north, east, down: only the azimuth's zero and sense change."""
    elevation_rad = min(max(elevation_rad, -math.pi / 2), math.pi / 2)
    return Bearing(
        wrap_angle_rad(math.pi / 2 - azimuth_rad),
        elevation_rad,
        _capped(azimuth_std_rad),
        _capped(elevation_std_rad),
    )


def body_bearing(
    azimuth_rad: float,
    elevation_rad: float,
    azimuth_std_rad: float | None,
    elevation_std_rad: float | None,
    attitude: Quaternion,
) -> Bearing:
    """Bearing from airframe angles, rotated by ``attitude``.

    Errors: the two are independent and small, so on the unit sphere they are two tangent
    vectors, σ_az cos el along the parallel and σ_el along the meridian. Rotated, they are
    projected on the earth's parallel and meridian at the bearing.
    """
    cos_az, sin_az = math.cos(azimuth_rad), math.sin(azimuth_rad)
    cos_el, sin_el = math.cos(elevation_rad), math.sin(elevation_rad)
    north, east, down = rotate(attitude, (cos_el * cos_az, cos_el * sin_az, -sin_el))
    horizontal = math.hypot(north, east)
    azimuth = math.atan2(north, east)
    elevation = math.atan2(-down, horizontal)
    if azimuth_std_rad is None or elevation_std_rad is None:
        return Bearing(azimuth, elevation, None, None)

    along_north, along_east, _ = rotate(attitude, (-sin_az, cos_az, 0.0))
    parallel_part = (north * along_east - east * along_north) / max(horizontal, 1e-300)
    # Both pairs of tangents are orthonormal in one plane: a turn by one angle, its cosine this.
    cos2 = min(parallel_part * parallel_part, 1.0)
    sin2 = 1.0 - cos2
    var_along = (azimuth_std_rad * max(cos_el, _COS_FLOOR)) ** 2
    var_upward = elevation_std_rad * elevation_std_rad
    azimuth_std = math.sqrt(var_along * cos2 + var_upward * sin2) / max(horizontal, _COS_FLOOR)
    elevation_std = math.sqrt(var_along * sin2 + var_upward * cos2)
    return Bearing(azimuth, elevation, min(azimuth_std, math.pi), min(elevation_std, math.pi))


def slerp(a: Quaternion, b: Quaternion, fraction: float) -> Quaternion:
    """Attitude ``fraction`` of the way from ``a`` to ``b`` along the shorter great circle, unit norm."""
    dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    sign = 1.0
    if dot < 0.0:
        dot, sign = -dot, -1.0
    if dot > 1.0 - _SLERP_LINEAR_BELOW:
        wa, wb = 1.0 - fraction, fraction * sign
    else:
        angle = math.acos(dot)
        scale = 1.0 / math.sin(angle)
        wa = math.sin((1.0 - fraction) * angle) * scale
        wb = math.sin(fraction * angle) * scale * sign
    w = wa * a[0] + wb * b[0]
    x = wa * a[1] + wb * b[1]
    y = wa * a[2] + wb * b[2]
    z = wa * a[3] + wb * b[3]
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    return w / norm, x / norm, y / norm, z / norm


def _capped(std_rad: float | None) -> float | None:
    return None if std_rad is None else min(std_rad, math.pi)
