"""Regions stay honest with silences, in a world with a detection range: vehicles on strips, some hear it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from groundstation.localization import SearchArea, SignalModel
from groundstation.tracking import Belief, TrackingSettings, TrackObservation, containment
from groundstation.tracking.receivers import Receivers
from groundstation.tracking.silence import Ear, Silence

MODEL = SignalModel(nlos_bias_max_db=8.0)
SETTINGS = TrackingSettings(base_cells=12, maximum_cells=400)
RADIUS_M, SECONDS, VEHICLES = 250.0, 40, 4
AREA = SearchArea(np.zeros(2), RADIUS_M, 1.0, 20.0)


@dataclass
class Outcome:
    error_m: float
    radius_90_m: float


def strip(vehicle: int) -> np.ndarray:
    """North along one lane and back along the next, 8 m/s, 50 m up; (SECONDS, 3)."""
    width = 2.0 * RADIUS_M / VEHICLES
    flown = 8.0 * np.arange(SECONDS)
    back = flown > 2.0 * RADIUS_M
    east = -RADIUS_M + width * (vehicle + np.where(back, 0.75, 0.25))
    north = np.where(back, 3.0 * RADIUS_M - flown, flown - RADIUS_M)
    return np.stack([east, north, np.full(SECONDS, 50.0)], axis=1)


def fly(rng: np.random.Generator, silences: bool, speaks_s: tuple[int, int] | None) -> Outcome | None:
    """One run; ``speaks_s``: (so many seconds, out of so many); None: always. None: it was never heard."""
    reach, turn = RADIUS_M * math.sqrt(rng.random()), 2.0 * math.pi * rng.random()
    truth = np.array([reach * math.cos(turn), reach * math.sin(turn), rng.uniform(1.0, 20.0)])
    power, exponent = rng.uniform(13.0, 18.0), rng.uniform(2.0, 3.5)
    limit = 15.5 - 27.5 * math.log10(rng.uniform(60.0, 160.0)) - 4.0
    places = [strip(vehicle) for vehicle in range(VEHICLES)]
    level = np.zeros((VEHICLES, SECONDS))
    for vehicle, place in enumerate(places):
        gap = np.linalg.norm(place[:, None] - place[None], axis=2)
        field = np.linalg.cholesky(np.exp(-gap / 25.0) + 1e-9 * np.eye(SECONDS))
        level[vehicle] = power - 10.0 * exponent * np.log10(np.linalg.norm(truth - place, axis=1))
        level[vehicle] += 5.0 * field @ rng.standard_normal(SECONDS) - rng.uniform(0.0, 8.0)
    spoken = np.ones(SECONDS, dtype=bool)
    if speaks_s is not None:
        spoken = (np.arange(SECONDS) + rng.integers(speaks_s[1])) % speaks_s[1] < speaks_s[0]
    got = (level >= limit) & spoken & (rng.random(level.shape) > 0.1)
    if not got.any():
        return None
    belief, silence, receivers = Belief(AREA, MODEL, SETTINGS), Silence(SETTINGS), Receivers(SETTINGS)
    windows, newest, known = [], {}, False
    for second in range(SECONDS):
        for vehicle in np.flatnonzero(got[:, second]).tolist():
            place, rss = tuple(places[vehicle][second].tolist()), float(level[vehicle, second])
            receivers.heard(vehicle, rss, None)
            silence.heard(vehicle, place, rss, 0.0, (1, 0))
            newest[vehicle], known = (rss, second), True
            windows.append(TrackObservation(vehicle, place, rss, *[None] * 5, 0.0, time_s=float(second)))
        if second % 2:
            ears = [
                Ear(v, tuple(places[v][second].tolist()), int(got[v, second - 1 : second + 1].sum()))
                for v in range(VEHICLES)
            ]
            strong = [
                v
                for v, (rss, when) in newest.items()
                if rss >= (receivers.sensitivity_dbm(v) or 0.0) + 10.0 and second - when < 15
            ]
            if known:
                silence.listen(second - 1.0, second + 1.0, ears, strong)
            else:
                for ear in ears:
                    silence.before(ear.vehicle_id, ear.position_enu_m, 2.0)
    if silences:
        belief.set_field("silence", silence.field(receivers, MODEL))
    belief.update(windows)
    said = containment(belief.mesh, belief.mass)
    return Outcome(float(np.hypot(*(said.position_enu_m - truth)[:2])), said.radius_90_m)


@pytest.mark.parametrize("speaks_s", [None, (6, 20)])
def test_with_a_detection_range_the_region_holds_and_the_error_falls(
    speaks_s: tuple[int, int] | None,
) -> None:
    """48 runs of 40 s (those in which it was heard), seed 11: the 90 % radius holds, the error falls."""
    runs = {
        silences: [fly(np.random.default_rng([11, trial]), silences, speaks_s) for trial in range(48)]
        for silences in (False, True)
    }
    heard = {silences: [run for run in found if run is not None] for silences, found in runs.items()}
    assert len(heard[True]) >= 36
    rmse = {
        silences: math.sqrt(sum(run.error_m**2 for run in found) / len(found))
        for silences, found in heard.items()
    }
    inside = [run.error_m <= run.radius_90_m for run in heard[True]]
    assert sum(inside) / len(inside) >= 0.85
    assert rmse[True] < 0.95 * rmse[False]
