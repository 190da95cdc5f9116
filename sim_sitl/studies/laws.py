"""The exact law of received power on a link, tabulated from a channel's own definition.

Exists for ``limits``: what the best estimator would know of a channel. Rule: written from the
channels' generative definitions alone; shares no code with ``groundstation.localization``.

With level ℓ (transmit power less what all links lose alike) and class c (what all NLOS links
of a trial share, such as β) given, links are independent, and a link at distance d receives
y = ℓ − 10 β_c log₁₀ d + e, where the density of e is a table over e (and over d where its
shape depends on d). ℓ and c have quadrature nodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, singledispatch
from typing import Any

import numpy as np
from scipy.special import ndtr

from groundstation.localization.problem import FloatArray
from sim_sitl.dataset.geometry import PATH_LOSS
from sim_sitl.studies.channels import (
    FRIIS_1M_DB,
    TRANSMIT_POWER_DBM,
    AnalyticChannel,
    Channel,
    RubbleChannel,
)
from sim_sitl.studies.end_to_end import DatasetChannel, calibration_rows

STEP_DB = 0.02
"""Raster of the tables over e where nothing but the raster limits them."""
REACH_DB = 160.0
"""Tables run from −reach to +reach."""
LOG_DISTANCE = (0.0, 3.3)
"""log₁₀ d that distance bins cover; beyond, the outermost bin serves."""
LEVEL_NODES = 5
EXPONENT_NODES = 12


@dataclass(frozen=True, slots=True, eq=False)
class Law:
    """Densities of received power; L level nodes, C classes, D distance bins, R raster points."""

    power_dbm: FloatArray
    """(L,) nodes of the transmit power, which is ℓ of a LOS link."""
    level_dbm: FloatArray
    """(L,) nodes of ℓ of NLOS links."""
    level_weight: FloatArray
    """(L,) summing to one."""
    class_weight: FloatArray
    """(C,) summing to one."""
    nlos_exponent: FloatArray
    """(C,) β_c."""
    nlos_density: FloatArray
    """(C or 1, D, R) density of e of an NLOS link, 1/dB."""
    los_exponent: float
    """β of a LOS link."""
    los_density: FloatArray
    """(R,) density of e of a LOS link, 1/dB."""

    def los(self, rss_dbm: FloatArray, offset_m: FloatArray) -> FloatArray:
        """(K, S, L) densities of K received powers were the links LOS, 1/dB.

        ``rss_dbm`` (K,); ``offset_m`` (S, K, 3) from each of S candidates to the vehicles.
        """
        path = 10.0 * self.los_exponent * _log_distance(offset_m)
        return self._lookup(self.los_density, self.power_dbm, rss_dbm[:, None] + path, 0)

    def nlos(self, rss_dbm: FloatArray, offset_m: FloatArray) -> FloatArray:
        """(K, S, C, L) the same were they NLOS."""
        log_distance = _log_distance(offset_m)
        classes, bins, size = self.nlos_density.shape
        row: Any = np.zeros((1, 1, 1), dtype=np.int32)
        if bins > 1:
            share = (log_distance - LOG_DISTANCE[0]) / (LOG_DISTANCE[1] - LOG_DISTANCE[0])
            row = (np.clip((share * bins).astype(np.int32), 0, bins - 1) * size)[..., None]
        if classes > 1:
            row = row + (np.arange(classes) * bins * size).astype(np.int32)
        path = 10.0 * self.nlos_exponent * log_distance[..., None]
        return self._lookup(self.nlos_density.ravel(), self.level_dbm, rss_dbm[:, None, None] + path, row)

    def _lookup(
        self, table: FloatArray, level_dbm: FloatArray, from_level_db: FloatArray, row: Any
    ) -> FloatArray:
        """(…, L) densities at e = (…) − ℓ in the rows of a flat table that begin at ``row``."""
        size = self.los_density.size
        step = 2.0 * REACH_DB / (size - 1)
        level = np.rint(level_dbm / step).astype(np.int32)
        place = np.rint((from_level_db + REACH_DB) / step)
        place = np.clip(place, int(level.max()), size - 1 + int(level.min())).astype(np.int32)
        found: FloatArray = table[(place + row)[..., None] - level]
        return found


@singledispatch
def law_of(channel: Channel) -> Law:
    """The law of a channel; raises TypeError for one that has none here."""
    raise TypeError(f"no exact law is written down for {type(channel).__name__}")


@law_of.register
@cache
def _analytic(channel: AnalyticChannel) -> Law:
    """Eqs. (7), (8): b_k integrated exactly, a difference of normal distribution functions."""
    level, level_weight = legendre(*TRANSMIT_POWER_DBM, LEVEL_NODES)
    exponent, weight = legendre(*channel.nlos_exponent, EXPONENT_NODES)
    excess = _raster()
    low, high = channel.bias_db
    nlos = (ndtr((excess + high) / channel.shadowing_db) - ndtr((excess + low) / channel.shadowing_db)) / (
        high - low
    )
    table = nlos[None, None, :]
    if channel.exponent_per_link:
        mean = 0.5 * sum(channel.nlos_exponent)
        moved = np.rint(10.0 * (exponent - mean) * _bin_centres(256)[:, None] / STEP_DB).astype(np.int64)
        table = np.zeros((1, len(moved), excess.size))
        for number, shifts in enumerate(moved):
            # e = −10 (β − mean) log₁₀ d + (what is left), β integrated at this distance.
            for share, shift in zip(weight, shifts, strict=True):
                table[0, number] += share * np.roll(nlos, -int(shift))
        exponent, weight = np.array([mean]), np.ones(1)
    return Law(
        level, level, level_weight, weight, exponent, table, channel.los_exponent,
        _normal(excess, channel.shadowing_db),
    )  # fmt: skip


@law_of.register
@cache
def _dataset(channel: DatasetChannel) -> Law:
    """Rows of the data set: a kernel estimate from the calibration's links, which no trial holds.

    Kernels are Gaussian, by Silverman's rule, about samples drawn together so that the
    variance stays the sample's (Fryer, 1976).
    """
    level, level_weight = legendre(*TRANSMIT_POWER_DBM, LEVEL_NODES)
    excess = _raster()
    density = {}
    for state, rows in calibration_rows(channel.calibration_links).items():
        sample = rows.excess_db.ravel() + channel.reported_db
        width = 1.06 * sample.std() * sample.size**-0.2
        sample = sample.mean() + (sample - sample.mean()) / math.hypot(1.0, width / sample.std())
        density[state] = np.mean([_normal(excess - value, width) for value in sample], axis=0)
    return Law(
        level, level, level_weight, np.ones(1), np.array([PATH_LOSS[False][0]]),
        density[False][None, None, :], PATH_LOSS[True][0], density[True],
    )  # fmt: skip


@law_of.register
@cache
def _rubble(channel: RubbleChannel) -> Law:
    """Friis + (11): β, excess loss and σ_SF shared by the trial, obstructed length and bias each link's.

    Small-scale fading, about 1 dB beside at least 3 dB of shadowing, enters by its two moments.
    """
    power, power_weight = legendre(*TRANSMIT_POWER_DBM, 3)
    loss, loss_weight = legendre(*channel.excess_loss_db, 7)
    power, loss = (grid.ravel() for grid in np.meshgrid(power, loss, indexing="ij"))
    level = power - loss - (FRIIS_1M_DB + channel.reference_loss_db - channel.reported_db)
    exponent, exponent_weight = legendre(*channel.exponent, 8)
    shadowing, shadowing_weight = legendre(*channel.shadowing_db, 3)
    length, length_weight = legendre(*channel.length_m, 24)
    fading_mean, fading_std = channel.fading_moments_db()
    low, high = channel.bias_db
    excess = _raster(0.2)
    distance = 10.0 ** _bin_centres(48)
    clear = 20.0 * np.log10(np.maximum(distance[:, None] - length, 1.0) / distance[:, None])
    tables = []
    for beta in exponent:
        lost = clear + 10.0 * beta * np.log10(length) - fading_mean
        for sigma in shadowing:
            std = math.hypot(sigma, fading_std)
            table = np.zeros((distance.size, excess.size))
            for column, weight in zip(lost.T, length_weight, strict=True):
                shifted = excess + column[:, None]
                table += weight * (ndtr((shifted + high) / std) - ndtr((shifted + low) / std))
            tables.append(table / (high - low))
    return Law(
        power, level, np.outer(power_weight, loss_weight).ravel(),
        np.outer(exponent_weight, shadowing_weight).ravel(), np.full(len(tables), 2.0), np.array(tables),
        channel.los_exponent, _normal(excess, channel.los_shadowing_db),
    )  # fmt: skip


def _log_distance(offset_m: FloatArray) -> FloatArray:
    """(K, S) log₁₀ of distances, not under a metre, from offsets (S, K, 3)."""
    return np.asarray(np.log10(np.maximum(np.linalg.norm(offset_m, axis=-1), 1.0)).T)


def legendre(low: float, high: float, nodes: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights (summing to one) of Gauss–Legendre over a uniform variable."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    return low + 0.5 * (high - low) * (node + 1.0), 0.5 * weight


def _raster(step_db: float = STEP_DB) -> FloatArray:
    count = 2 * round(REACH_DB / step_db) + 1
    return np.asarray(np.linspace(-REACH_DB, REACH_DB, count))


def _bin_centres(bins: int) -> FloatArray:
    edges = np.linspace(*LOG_DISTANCE, bins + 1)
    return np.asarray(0.5 * (edges[:-1] + edges[1:]))


def _normal(excess_db: FloatArray, std_db: float) -> FloatArray:
    result: FloatArray = np.exp(-0.5 * np.square(excess_db / std_db)) / (std_db * math.sqrt(2.0 * math.pi))
    return result
