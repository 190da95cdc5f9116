"""A small radio world of the tests' own: shadowing as a field in space, b and exponent per run."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from groundstation.localization import SearchArea
from groundstation.tracking import TrackObservation


@dataclass(frozen=True)
class Flight:
    seconds: list[list[TrackObservation]]
    truth_enu_m: np.ndarray
    area: SearchArea


@pytest.fixture(scope="session")
def fly() -> Callable[..., Flight]:
    """``fly(rng, los, seconds)``: vehicles at 8 m/s on a 100 m orbit, one window a second each."""

    def make(
        rng: np.random.Generator,
        los: tuple[int, ...] = (0, 0, 0, 0),
        seconds: int = 60,
        std_db: float = 5.0,
        correlation_m: float = 25.0,
        bias_max_db: float = 8.0,
        ruined: float = 0.0,
        with_angles: bool = True,
        offset_db: float = 0.0,
    ) -> Flight:
        reach, turn = 100.0 * math.sqrt(rng.random()), 2.0 * math.pi * rng.random()
        truth = np.array([reach * math.cos(turn), reach * math.sin(turn), rng.uniform(1.0, 20.0)])
        power, nlos_exponent = rng.uniform(13.0, 18.0) + offset_db, rng.uniform(2.0, 3.5)
        heard: list[list[TrackObservation]] = [[] for _ in range(seconds)]
        for vehicle, is_los in enumerate(los):
            angle = 2.0 * math.pi * vehicle / len(los) + 0.08 * np.arange(seconds)
            place = np.stack([100.0 * np.cos(angle), 100.0 * np.sin(angle), np.full(seconds, 50.0)], axis=1)
            gap = np.linalg.norm(place[:, None] - place[None], axis=2)
            field = np.linalg.cholesky(np.exp(-gap / correlation_m) + 1e-9 * np.eye(seconds))
            shadow = std_db * field @ rng.standard_normal(seconds)
            offset = truth - place
            distance = np.linalg.norm(offset, axis=1)
            exponent = 2.5 if is_los else nlos_exponent
            bias = 0.0 if is_los else rng.uniform(0.0, bias_max_db)
            rss = power - 10.0 * exponent * np.log10(distance) - bias + shadow
            rss = rss - 20.0 * (rng.random(seconds) < ruined)
            noise = np.radians(1.0) * (rng.standard_normal((2, seconds)) + rng.standard_normal((2, 1)))
            azimuth = np.arctan2(offset[:, 1], offset[:, 0]) + noise[0]
            elevation = np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1])) + noise[1]
            told = bool(is_los) and with_angles
            for second in range(seconds):
                heard[second].append(
                    TrackObservation(
                        vehicle_id=vehicle + 1,
                        position_enu_m=tuple(place[second]),
                        rss_dbm=float(rss[second]),
                        rss_std_error_db=None,
                        azimuth_rad=float(azimuth[second]) if told else None,
                        elevation_rad=float(elevation[second]) if told else None,
                        azimuth_std_rad=None,
                        elevation_std_rad=None,
                        los_probability=float(is_los),
                    )
                )
        return Flight(heard, truth, SearchArea(np.zeros(2), 100.0, 1.0, 20.0))

    return make
