"""The problems that ``bench_convex`` solves: drawn as in the paper's V-C, and as the programs' numbers.

Our solvers take a ``Batch``; the same numbers in units of the area's radius are what a program in
CVXPY is made of, so that both sides solve the same thing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from groundstation.localization import Links, SearchArea, SignalModel
from groundstation.localization.batch import Batch
from groundstation.localization.lsre_terms import log_end_weights, log_gains
from groundstation.localization.region import Region

MODEL = SignalModel()
AREA = SearchArea(np.zeros(2), 100.0, 1.0, 20.0)
LINKS = 4


def draw(count: int, seed: int) -> Batch:
    """V-C, NLOS by eq. (8): R₀ = 100 m, one β ~ U(2, 3.5) a trial, b_k ~ U(0, 7), b_max ~ U(6, 8) dB."""
    rng = np.random.default_rng(seed)
    turn = 2.0 * math.pi * np.arange(LINKS) / LINKS
    place = np.stack([100.0 * np.cos(turn), 100.0 * np.sin(turn), np.full(LINKS, 50.0)], axis=-1)
    reach, angle = 100.0 * np.sqrt(rng.random(count)), 2.0 * math.pi * rng.random(count)
    truth = np.stack([reach * np.cos(angle), reach * np.sin(angle), rng.uniform(1.0, 20.0, count)], axis=-1)
    shape = (count, LINKS)
    rss = (
        rng.uniform(13.0, 18.0, (count, 1)) + 5.0 * rng.standard_normal(shape) - rng.uniform(0.0, 7.0, shape)
    )
    rss -= (
        10.0 * rng.uniform(2.0, 3.5, (count, 1)) * np.log10(np.linalg.norm(truth[:, None] - place, axis=-1))
    )
    nothing = np.full(shape, np.nan)
    links = Links(np.broadcast_to(place, (*shape, 3)).copy(), rss, nothing, nothing, np.zeros(shape))
    return Batch.of(links, AREA, MODEL, rng.uniform(6.0, 8.0, count))


def draw_los(count: int, seed: int) -> Batch:
    """V-C, LOS: β = 2.5, shadowing 5 dB, angles 1°."""
    batch = draw(count, seed)
    rng = np.random.default_rng(seed + 100)
    truth = np.column_stack([rng.uniform(-70.0, 70.0, (count, 2)), rng.uniform(1.0, 20.0, count)])
    offset = truth[:, None] - batch.place
    shape = offset.shape[:2]
    rss = rng.uniform(13.0, 18.0, (count, 1)) - 25.0 * np.log10(np.linalg.norm(offset, axis=-1))
    noise = math.radians(1.0) * rng.standard_normal((2, *shape))
    azimuth = np.arctan2(offset[..., 1], offset[..., 0]) + noise[0]
    elevation = np.arctan2(offset[..., 2], np.hypot(offset[..., 0], offset[..., 1])) + noise[1]
    rss += 5.0 * rng.standard_normal(shape)
    return Batch.of(Links(batch.place, rss, azimuth, elevation, np.ones(shape)), AREA, MODEL)


@dataclass(frozen=True)
class Numbers:
    """What one problem's program is made of, lengths in area radii."""

    place: Any
    gain: Any
    """(K,) m_k/m_t."""
    low: Any
    """(K,) e̲_k."""
    weight: Any
    """(K,) g_k."""
    distance_weight: Any
    """(K,) w_k of RWLS."""
    start: Any
    """(3,) where the convex–concave step is taken."""

    @property
    def tangent(self) -> Any:
        """(K, 3) unit vectors from the vehicles to the start."""
        offset = self.start - self.place
        return offset / np.linalg.norm(offset, axis=1, keepdims=True)


def numbers(batch: Batch, region: Region, start_m: Any) -> list[Numbers]:
    """One for each problem."""
    power, exponent = batch.first_power_dbm(), batch.first_exponents()
    gain = np.exp(log_gains(batch, power, exponent)) * region.scale_m
    weight = np.exp(log_end_weights(batch, exponent))
    low = 10.0 ** (-batch.bias_max_db[:, None] / (20.0 * exponent))
    told = (1.0 / gain) / (1.0 / gain).sum(axis=1, keepdims=True)
    place, start = region.scaled(batch.place), region.scaled(start_m)
    return [Numbers(place[i], gain[i], low[i], weight[i], 1.0 - told[i], start[i]) for i in range(batch.size)]


def range_data(batch: Batch) -> dict[str, Any]:
    """What the SDP/SOCP hybrid of the one problem of ``batch`` is made of, lengths in area radii."""
    place, told = batch.place[0] / AREA.radius_m, 10.0 ** ((15.0 - batch.received_dbm()[0]) / 25.0)
    told = told / AREA.radius_m
    root = np.sqrt(1.0 - told / told.sum())
    theta, phi = batch.links.azimuth_rad[0], batch.links.elevation_rad[0]
    across = np.stack([-np.sin(theta), np.cos(theta), 0.0 * theta], axis=1)
    upward = np.stack([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), -np.cos(phi)], axis=1)
    rows = np.concatenate([across, upward]) * np.tile(root / told, 2)[:, None]
    right = (rows * np.tile(place, (2, 1))).sum(axis=1)
    square = np.square(place).sum(axis=1)
    return {
        "root": root, "inverse": root / told, "rows": rows, "right": right, "place": place, "square": square,
    }  # fmt: skip
