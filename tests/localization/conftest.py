"""The paper's geometry of V-C, drawn with a seed: vehicles on a ring at 50 m, target in the disc."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from groundstation.localization import Links, SearchArea


@dataclass(frozen=True)
class Drawn:
    links: Links
    truth_enu_m: np.ndarray
    area: SearchArea


@pytest.fixture(scope="session")
def draw() -> Callable[..., Drawn]:
    """``draw(trials, los, seed, …)``: N problems; ``los`` the labels, all known to be right."""

    def make(
        trials: int,
        los: tuple[int, ...],
        seed: int,
        radius_m: float = 100.0,
        ring: np.ndarray | None = None,
        shift_m: float = 0.0,
        rss_std_db: float = 5.0,
        angle_std_deg: float = 1.0,
    ) -> Drawn:
        rng = np.random.default_rng(seed)
        label = np.array(los, dtype=float)
        count = label.size
        turn = 2.0 * math.pi * np.arange(count) / count if ring is None else ring
        place = np.stack([radius_m * np.cos(turn), radius_m * np.sin(turn), np.full(count, 50.0)], axis=-1)
        reach = radius_m * np.sqrt(rng.random(trials))
        angle = 2.0 * math.pi * rng.random(trials)
        truth = np.stack(
            [reach * np.cos(angle) + shift_m, reach * np.sin(angle), rng.uniform(1.0, 20.0, trials)], axis=-1
        )
        offset = truth[:, None] - place
        distance = np.linalg.norm(offset, axis=-1)
        exponent = np.where(label > 0, 2.5, rng.uniform(2.0, 3.5, (trials, 1)))
        bias = (1.0 - label) * rng.uniform(0.0, 7.0, (trials, count))
        rss = rng.uniform(13.0, 18.0, (trials, 1)) - 10.0 * exponent * np.log10(distance) - bias
        rss += rss_std_db * rng.standard_normal((trials, count))
        noise = np.radians(angle_std_deg) * rng.standard_normal((2, trials, count))
        azimuth = np.arctan2(offset[..., 1], offset[..., 0]) + noise[0]
        elevation = np.arctan2(offset[..., 2], np.hypot(offset[..., 0], offset[..., 1])) + noise[1]
        azimuth = np.where(label > 0, azimuth, np.nan)
        elevation = np.where(label > 0, elevation, np.nan)
        links = Links(
            np.broadcast_to(place, (trials, count, 3)).copy(),
            rss,
            azimuth,
            elevation,
            np.broadcast_to(label, (trials, count)).copy(),
        )
        return Drawn(links, truth, SearchArea(np.array([shift_m, 0.0]), radius_m, 1.0, 20.0))

    return make
