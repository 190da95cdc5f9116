"""Means of a window's samples, and how far they may be off.

Power in milliwatts, as the detector adds energy; its standard error goes to decibels by the
delta method. Azimuth on the circle (vector mean), elevation plainly: errors are reported per
angle, and a mean of unit vectors on the sphere would pull the elevation towards the pole by the
azimuth's scatter. The standard error of a mean angle is the larger of what the scatter says and
what the sensor says, over √n: a sensor that flatters itself is caught by its scatter, one whose
few samples happen to agree by its own word.
"""

from __future__ import annotations

import math

from groundstation.domain.geometry import Geodetic, Quaternion
from groundstation.measurement.angles import IDENTITY
from groundstation.measurement.pose_history import Pose

_DB_PER_NEPER = 10.0 / math.log(10.0)


def mean_power(levels_dbm: list[float]) -> tuple[float | None, float | None]:
    """Mean of powers, averaged in milliwatts, and its standard error: dBm and dB.

    Delta method: σ_dB = 10/ln 10 · s/(√n · mean), s the sample's standard deviation in
    milliwatts; None with fewer than two samples.
    """
    n = len(levels_dbm)
    if n == 0:
        return None, None
    # Relative to the strongest, so that no level under- or overflows.
    top_dbm = max(levels_dbm)
    ratios = [10.0 ** ((level - top_dbm) / 10.0) for level in levels_dbm]
    mean = math.fsum(ratios) / n
    mean_dbm = top_dbm + 10.0 * math.log10(mean)
    if n == 1:
        return mean_dbm, None
    variance = math.fsum((ratio - mean) ** 2 for ratio in ratios) / (n - 1)
    return mean_dbm, _DB_PER_NEPER * math.sqrt(variance / n) / mean


def mean_bearing(
    rows: list[tuple[float, float, float | None, float | None]], default_std_rad: float
) -> tuple[float | None, float | None, float | None, float | None]:
    """Mean azimuth with its standard error, mean elevation with its own, radians.

    ``rows``: azimuth, elevation and the sensor's standard errors (None = not said). An angle's
    error is max(scatter, root mean square of the reported) / √n; a single unreported one takes
    ``default_std_rad``. Azimuths that cancel out have an error of π.
    """
    n = len(rows)
    if n == 0:
        return None, None, None, None
    east = math.fsum(math.cos(row[0]) for row in rows) / n
    north = math.fsum(math.sin(row[0]) for row in rows) / n
    azimuth = math.atan2(north, east)
    elevation = math.fsum(row[1] for row in rows) / n
    around = [math.remainder(row[0] - azimuth, 2.0 * math.pi) for row in rows]
    upward = [row[1] - elevation for row in rows]
    azimuth_error = _angle_error(around, [row[2] for row in rows], default_std_rad)
    if math.hypot(east, north) < 1e-6:
        azimuth_error = math.pi
    return azimuth, azimuth_error, elevation, _angle_error(upward, [row[3] for row in rows], default_std_rad)


def _angle_error(deviations: list[float], reported: list[float | None], default_std_rad: float) -> float:
    n = len(deviations)
    said = [std for std in reported if std is not None]
    # A sensor that says nothing and scattered too little to tell is held to the default.
    own = math.sqrt(math.fsum(std * std for std in said) / len(said)) if said else None
    scatter = math.sqrt(math.fsum(d * d for d in deviations) / (n - 1)) if n > 1 else 0.0
    if own is None:
        own = default_std_rad if n < 3 else 0.0
    return min(max(scatter, own) / math.sqrt(n), math.pi)


def mean_position(rows: list[Pose]) -> Geodetic:
    """Mean of nearby positions, across the date line if need be."""
    n = len(rows)
    lat0, lon0, alt0, _ = rows[0]
    lat = lat0 + math.fsum(row[0] - lat0 for row in rows) / n
    lon = lon0 + math.fsum(math.remainder(row[1] - lon0, 360.0) for row in rows) / n
    alt = alt0 + math.fsum(row[2] - alt0 for row in rows) / n
    return Geodetic(lat, math.remainder(lon, 360.0), alt)


def middle_attitude(rows: list[tuple[int, Pose]], middle_ns: int) -> Quaternion:
    """Attitude known nearest to ``middle_ns``; level and facing north where none is known."""
    best: Quaternion = IDENTITY
    best_ns: int | None = None
    for time_ns, pose in rows:
        attitude = pose.attitude
        away_ns = abs(time_ns - middle_ns)
        if attitude is not None and (best_ns is None or away_ns < best_ns):
            best, best_ns = attitude, away_ns
    return best
