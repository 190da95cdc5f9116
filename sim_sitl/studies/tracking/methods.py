"""Who is put to the runs, by name.

Rule: each gets the run and what its case tells it; only ``exact`` and the case's own draws know the world.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from groundstation.localization import SearchArea, SignalModel
from groundstation.tracking import Tracker, TrackingSettings
from sim_sitl.studies.tracking.answers import SHARES, Answers
from sim_sitl.studies.tracking.cases import SERVICE, Case
from sim_sitl.studies.tracking.exact import ExactFilter, Resolution
from sim_sitl.studies.tracking.least_squares import fit
from sim_sitl.studies.tracking.particles import track_particles
from sim_sitl.studies.tracking.trackers import Tracking, still, track
from sim_sitl.studies.tracking.world import Run

Method = Callable[[Case, Run, Any, int], Answers]
"""(case, run, ticks, a seed of the run's own) → answers at the ticks."""

OURS, EXACT = "tracker", "exact"
"""The method that others are set beside, and the yardstick."""


def _tracker(case: Case, run: Run, ticks: Any, seed: int) -> Answers:
    return track(run, ticks, _maker(seed), case.told.model, case.told.settings)


def _service(case: Case, run: Run, ticks: Any, seed: int) -> Answers:
    return track(run, ticks, _maker(seed), SERVICE.model, SERVICE.settings)


def _still(case: Case, run: Run, ticks: Any, seed: int) -> Answers:
    return track(run, ticks, still, case.told.model, case.told.settings)


def _maker(seed: int) -> Callable[[SearchArea, SignalModel, TrackingSettings], Tracking]:
    def made(area: SearchArea, model: SignalModel, settings: TrackingSettings) -> Tracking:
        return Tracker(area, model, settings, seed=seed)

    return made


def _exact(case: Case, run: Run, ticks: Any, seed: int) -> Answers:
    return ExactFilter(run, case.world, ticks, Resolution()).answers()


def _particles(case: Case, run: Run, ticks: Any, seed: int) -> Answers:
    return track_particles(run, ticks, case.told, seed)


def _least_squares(case: Case, run: Run, ticks: Any, seed: int) -> Answers:
    return fit(run, ticks, case.told)


def _centre(case: Case, run: Run, ticks: Any, seed: int) -> Answers:
    """Always the middle; its region is the disc about it."""
    began = time.thread_time()
    answers = Answers.none(len(ticks))
    area = run.area
    middle = 0.5 * (area.height_min_m + area.height_max_m)
    answers.mean_enu_m[:] = [*area.center_enu_m[:2], middle]
    reach = np.hypot(*(run.truth_enu_m[ticks, :2] - area.center_enu_m[:2]).T) / area.radius_m
    answers.level[:] = reach * reach
    answers.area_m2[:] = [math.pi * area.radius_m**2 * share for share in SHARES]
    return replace(answers, cpu_s=time.thread_time() - began)


METHODS: Mapping[str, tuple[Method, str]] = {
    "tracker": (_tracker, "the station's tracker, told the case's values"),
    "tracker-service": (_service, "the same with the service's wide assumptions"),
    "still": (_still, "the tracker without its walking person"),
    "particles": (_particles, "bootstrap particle filter (filterpy)"),
    "least-squares": (_least_squares, "weighted nonlinear least squares (SciPy)"),
    "centre": (_centre, "always the middle of the area"),
    "exact": (_exact, "exact Bayes filter, told the world"),
}
