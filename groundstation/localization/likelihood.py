"""The one likelihood: what a link's power and bearing say of a place.

Exists so that the snapshot posterior and the tracker weigh evidence alike; the snapshot is
the tracker's first update. Rule: the model is stated here and nowhere else; its two users differ
only in what they can afford to sum over: ``link_states`` (few unrelated links: every combination
of link states) and ``regression`` (many windows along flights: correlated, states by moments).

Model of an observation on link i from place a_i, for a target at x, L_i = log₁₀‖x − a_i‖:

    y_i = P_t − 10 β_i L_i − b_i + o_i + g C_i + n_i + e_i

* A link is in line of sight with probability p_i: β_i = β_LOS, b_i = 0; else β_i = β_NLOS and
  b_i ~ U(0, b_max) (the paper (Gao & Sadjadpour, 2026), eq. (8)). β_LOS is Gaussian, β_NLOS
  uniform, each shared by all links of its kind and summed over a small grid.
* P_t is shared by all links; it and b enter by their first two moments (U(0, 7) dB beside 5 dB of
  shadowing is Gaussian to a hundredth of the error). The receiver's offset o_i is constant along a link.
* C_i = 10 log₁₀ cos²(elevation of the way), g ~ N: upright antennas hear little from straight below.
  One g for all links; taken by ``regression`` only, and by it only where the model's g is not 0.
* n_i is shadowing, a Gaussian field in space, correlation exp(−Δ/d_corr) (Gudmundson, 1991), of
  which a share is common to all vehicles: what stands in the way stands there for each of them.
* e_i is white: measurement noise.
* A bearing points at the target with Gaussian errors on a LOS link, but for a share of outliers;
  on an NLOS link anywhere.
* a_i is told with an error of a metre or so, which is much the same from window to window and, of
  satellite receivers side by side, from vehicle to vehicle. What all share moves the answer as it is:
  ``containment`` adds it. What they do not share turns bearings from near by: white, per bearing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from groundstation.localization.problem import FloatArray, SignalModel

_LEAST_STRAY = 1e-12
ANYWHERE = 1.0 / (2.0 * math.pi * math.pi)
"""Density of a bearing that points anywhere, per rad²: azimuth all round, elevation ±90°."""
_MINIMUM_DISTANCE_M = 1.0
DB_OF_LOG = 5.0 / math.log(10.0)
"""10 log₁₀ of a distance over the natural logarithm of its square."""
_MIXTURE_LOG_DISTANCE = 1.9
_DEEPEST_NULL_DB = -10.0 * math.log10(0.02)


def stray_share(model: SignalModel) -> float:
    """Share of LOS bearings that point anywhere; never quite none: one far off must not rule out all."""
    return max(model.angle_outlier_probability, _LEAST_STRAY)


@dataclass(frozen=True, slots=True, eq=False)
class ExponentGrid:
    """Nodes over (β_LOS, β_NLOS) with their prior."""

    los: FloatArray
    """(Q,) β_LOS of each node."""
    nlos: FloatArray
    """(Q,) β_NLOS of each node."""
    log_prior: FloatArray
    """(Q,) log prior mass, sums to one."""
    los_nodes: FloatArray
    """Different values of ``los``; the grid is their product with ``nlos_nodes``, these innermost."""
    nlos_nodes: FloatArray
    """Different values of ``nlos``."""
    model: SignalModel
    """Whose prior it is."""

    @classmethod
    def of(cls, model: SignalModel, nlos_nodes: int = 9) -> ExponentGrid:
        """β_NLOS uniform between its limits; β_LOS Gaussian (one node when it is certain)."""
        width = (model.nlos_exponent_max - model.nlos_exponent_min) / nlos_nodes
        nlos = model.nlos_exponent_min + width * (np.arange(nlos_nodes) + 0.5)
        if model.los_exponent_std > 0.0:
            # Gauss–Hermite with three nodes.
            los = model.los_exponent + model.los_exponent_std * math.sqrt(3.0) * np.array([-1.0, 0.0, 1.0])
            weight = np.array([1.0, 4.0, 1.0])
        else:
            los, weight = np.array([model.los_exponent]), np.ones(1)
        mass = np.repeat(weight / weight.sum() / nlos_nodes, nlos_nodes)
        return cls(
            np.repeat(los, nlos_nodes), np.tile(nlos, los.size), np.log(mass), los, np.asarray(nlos), model
        )


def expected_excess_db(los_probability: FloatArray, bias_max_db: Any) -> FloatArray:
    """E[b] of links that are LOS with that probability, dB."""
    result: FloatArray = 0.5 * bias_max_db * (1.0 - los_probability)
    return result


def offset_variance_db2(los_probability: FloatArray, model: SignalModel, bias_max_db: Any) -> FloatArray:
    """Variance of what is constant along a link: the receiver's offset and b, dB²."""
    result: FloatArray = (
        model.receiver_offset_std_db**2 + (1.0 - los_probability) * np.square(bias_max_db) / 12.0
    )
    return result


def mixture_variance_db2(los_probability: FloatArray, model: SignalModel, bias_max_db: Any) -> FloatArray:
    """What not knowing the link's state adds to the variance of the power, dB²."""
    gap = (
        10.0
        * (0.5 * (model.nlos_exponent_min + model.nlos_exponent_max) - model.los_exponent)
        * _MIXTURE_LOG_DISTANCE
        + 0.5 * bias_max_db
    )
    result: FloatArray = los_probability * (1.0 - los_probability) * gap**2
    return result


def log_squares(vehicle_enu_m: FloatArray, candidates: FloatArray, null: bool) -> tuple[Any, Any]:
    """``logs_of_squares`` of the ways (n, 3) × (C, 3) → (n, C), in single precision.

    A loss is then right to 10⁻⁵ dB near the origin, at half the memory and less time; sums over
    windows are for the caller to take in double precision.
    """
    middle = vehicle_enu_m.mean(axis=0) if vehicle_enu_m.size else 0.0
    # Differences from a middle: what single precision rounds is then under a tenth of a millimetre.
    here, there = (
        (vehicle_enu_m - middle).astype(np.float32),
        (candidates - middle).astype(np.float32).T.copy(),
    )
    flat = there[0] - here[:, 0, None]
    flat *= flat
    square = there[1] - here[:, 1, None]
    square *= square
    flat += square
    np.subtract(there[2], here[:, 2, None], out=square)
    square *= square
    square += flat
    return logs_of_squares(square, flat, null)


def logs_of_squares(square_m2: Any, flat_m2: Any, null: bool) -> tuple[Any, Any]:
    """What two losses are made of, from squared distances and their horizontal part, both overwritten:

    the path loss and (``null``; else None) −10 log₁₀ cos²(elevation), the loss in a null of order 1
    overhead, each over ``DB_OF_LOG``: whoever adds up many multiplies once. Distances under 1 m count as
    1 m; the null has at most 17 dB: none is empty, with reflections about.
    """
    np.maximum(square_m2, _MINIMUM_DISTANCE_M**2, out=square_m2)
    # NumPy has a vector loop for log, none for log10.
    np.log(square_m2, out=square_m2)
    if not null:
        return square_m2, None
    np.maximum(flat_m2, _MINIMUM_DISTANCE_M**2, out=flat_m2)
    np.log(flat_m2, out=flat_m2)
    np.subtract(square_m2, flat_m2, out=flat_m2)
    flat_m2 *= 2.0
    np.minimum(flat_m2, _DEEPEST_NULL_DB / DB_OF_LOG, out=flat_m2)
    return square_m2, flat_m2


def path_loss_of_square(square_m2: FloatArray) -> FloatArray:
    """10 log₁₀ of the root of squared distances, in place; distances under 1 m count as 1 m."""
    logs_of_squares(square_m2, square_m2, null=False)
    square_m2 *= DB_OF_LOG
    return square_m2


def bearing_residual(
    offset_m: FloatArray, bearing_rad: tuple[Any, Any]
) -> tuple[FloatArray, tuple[Any, Any, Any]]:
    """How far a bearing (azimuth, elevation) turns from the way to ``offset_m`` (3, …): (2, …) radians.

    And what ``angle_variance`` asks for.
    """
    east, north, up = offset_m
    azimuth, elevation = bearing_rad
    cos, sin = np.cos(azimuth), np.sin(azimuth)
    return residual_along((east * cos + north * sin, north * cos - east * sin, up), elevation)


def residual_along(
    offset_m: tuple[Any, Any, Any], elevation_rad: Any
) -> tuple[FloatArray, tuple[Any, Any, Any]]:
    """``bearing_residual`` of a way ``offset_m`` along the bearing's azimuth, across it (left) and up."""
    along, across, up = offset_m
    horizontal2 = np.maximum(along * along + across * across, 0.01)
    up2 = up * up
    residual = np.empty((2, *horizontal2.shape), dtype=horizontal2.dtype)
    # The way turns against the bearing as the bearing turns against the way.
    np.arctan2(-across, along, out=residual[0])
    np.subtract(elevation_rad, np.arctan2(up, np.sqrt(horizontal2)), out=residual[1])
    fourth = horizontal2 + up2
    fourth *= fourth
    up2 /= fourth
    np.divide(horizontal2, fourth, out=fourth)
    return residual, (np.divide(1.0, horizontal2, out=horizontal2), up2, fourth)


def angle_variance(per_m2: tuple[Any, Any, Any], spread_m2: tuple[Any, Any]) -> FloatArray:
    """(2, …) rad² that a variance of a place, horizontal (each axis) and vertical, m², adds to a bearing's.

    ``per_m2``, of each bearing: azimuth² per horizontal m², elevation² per horizontal and per vertical m².
    """
    turn, lift, rise = per_m2
    across, upright = spread_m2
    result: FloatArray = np.empty((2, *turn.shape), dtype=turn.dtype)
    np.multiply(across, turn, out=result[0])
    np.multiply(across, lift, out=result[1])
    result[1] += upright * rise
    return result


def shared_variance_m2(
    place_variance_m2: FloatArray, counts: FloatArray, model: SignalModel
) -> tuple[float, float]:
    """Variances, horizontal (each axis) and of height, that told places bring to an answer from all of them.

    ``place_variance_m2`` (n, 2), of each; ``counts`` (n,): P(line of sight) of its bearing, 0 without one:
    by bearings a place moves the answer; where there are none all count alike. As if common to
    all: right for one receiver, cautious for several. A vague place counts less, as its bearings do
    beside those of places known as the model has them.
    """
    assumed = np.array(model.vehicle_variance_m2)
    weight = 1.0 / np.maximum(place_variance_m2 + assumed, 1e-12)
    weight *= (counts if counts.any() else np.ones_like(counts))[:, None]
    flat, upright = (weight * place_variance_m2).sum(axis=0) / weight.sum(axis=0)
    return float(flat), float(upright)


def bearing_density(
    offset_m: FloatArray,
    across_m2: Any,
    upright_m2: Any,
    bearing_rad: tuple[Any, Any],
    std_rad: tuple[Any, Any],
    vehicle_m2: tuple[float, float] = (0.0, 0.0),
) -> FloatArray:
    """Density of a bearing (azimuth, elevation) per rad², seen over ``offset_m`` (3, …) from the vehicle.

    ``across_m2`` and ``upright_m2``: variance of the target's place in its box, horizontal (each
    axis) and vertical, added to the bearing's where the box is wider than the ray, so that a coarse
    box is not thrown away because its centre lies beside it. ``vehicle_m2``: the same variances of the
    place that the vehicle told.
    """
    (turn, lift), per_m2 = bearing_residual(offset_m, bearing_rad)
    of_vehicle = angle_variance(per_m2, vehicle_m2)
    of_turn, of_lift = angle_variance(per_m2, (across_m2, upright_m2))
    variance_az = widened_variance(std_rad[0] ** 2 + of_vehicle[0], of_turn)
    variance_el = widened_variance(std_rad[1] ** 2 + of_vehicle[1], of_lift)
    density: FloatArray = np.exp(-0.5 * (turn * turn / variance_az + lift * lift / variance_el))
    density /= 2.0 * math.pi * np.sqrt(variance_az * variance_el)
    return density


def widened_variance(variance: Any, of_box: FloatArray) -> FloatArray:
    """The variance of a bearing seen from a box.

    From boxes up to 1.4 σ wide the centres alone add up to the integral (the midpoint rule on a
    Gaussian: error under 10⁻⁴); adding their extent would count it twice.
    """
    wide: FloatArray = of_box * (3.0 / variance)
    wide -= 0.5
    np.maximum(wide, 0.0, out=wide)
    np.minimum(wide, 1.0, out=wide)
    wide *= of_box
    wide += variance
    return wide
