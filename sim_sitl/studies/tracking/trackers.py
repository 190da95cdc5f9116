"""The station's trackers, fed a run's windows as the service feeds them.

Rule: they see what ``TrackObservation`` holds, tick by tick, all vehicles' windows at once;
never the truth, which is used here only to say whether a region holds it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import shapely

from groundstation.localization import SearchArea, SignalModel
from groundstation.localization.containment import Raster, region_rings, smooth_raster
from groundstation.localization.mesh import Mesh, moments
from groundstation.localization.problem import FloatArray
from groundstation.tracking import Belief, Tracker, TrackingSettings, TrackObservation
from sim_sitl.studies.tracking.answers import SHARES, Answers, level_and_areas
from sim_sitl.studies.tracking.world import Run

_RASTER_CELLS = 96


class Tracking(Protocol):
    """What a tracker shows of its belief."""

    @property
    def mesh(self) -> Mesh:
        """Boxes."""
        ...

    @property
    def mass(self) -> FloatArray:
        """Share of the belief in each."""
        ...

    @property
    def vehicle_variance_m2(self) -> tuple[float, float]:
        """What its vehicles' places leave unsure of the answer: each horizontal axis, and height."""
        ...

    def update(self, batch: list[TrackObservation]) -> object:
        """Take in the windows of a tick."""
        ...


Make = Callable[[SearchArea, SignalModel, TrackingSettings], Tracking]


def still(area: SearchArea, model: SignalModel, settings: TrackingSettings) -> Tracking:
    """The belief over a still person."""
    return Belief(area, model, settings)


def windows_of(run: Run, tick: int) -> list[TrackObservation]:
    """All vehicles' windows of one tick."""
    said_m = run.place_std_m or (None, None)
    return [
        TrackObservation(
            vehicle_id=vehicle + 1,
            position_enu_m=(
                float(run.position_enu_m[tick, vehicle, 0]),
                float(run.position_enu_m[tick, vehicle, 1]),
                float(run.position_enu_m[tick, vehicle, 2]),
            ),
            rss_dbm=float(run.rss_dbm[tick, vehicle]),
            rss_std_error_db=None,
            azimuth_rad=float(run.azimuth_rad[tick, vehicle]),
            elevation_rad=float(run.elevation_rad[tick, vehicle]),
            azimuth_std_rad=None,
            elevation_std_rad=None,
            los_probability=float(run.los_probability[tick, vehicle]),
            time_s=float(run.time_s[tick]),
            position_std_m=said_m[0],
            height_std_m=said_m[1],
        )
        for vehicle in range(run.rss_dbm.shape[1])
    ]


def track(run: Run, ticks: Any, make: Make, model: SignalModel, settings: TrackingSettings) -> Answers:
    """One tracker's answers at ``ticks``."""
    answers = Answers.none(len(ticks))
    tracker = make(run.area, model, settings)
    spent, row = 0.0, 0
    for tick in range(int(max(ticks)) + 1):
        batch = windows_of(run, tick)
        began = time.thread_time()
        tracker.update(batch)
        spent += time.thread_time() - began
        if tick == ticks[row]:
            _read(tracker, run, tick, answers, row)
            row += 1
    return replace(answers, cpu_s=spent)


def _read(tracker: Tracking, run: Run, tick: int, answers: Answers, row: int) -> None:
    mesh, mass, shift = tracker.mesh, tracker.mass, tracker.vehicle_variance_m2
    answers.mean_enu_m[row] = moments(mesh, mass)[0]
    truth = run.truth_enu_m[tick]
    if isinstance(tracker, Tracker):
        answers.walking[row] = tracker.walking_probability
    answers.level[row], answers.area_m2[row] = level_of(
        smooth_raster(mesh, mass, _RASTER_CELLS, shift), truth
    )
    point = shapely.Point(truth[:2])
    for column, (_, rings) in enumerate(
        region_rings(mesh, mass, SHARES, smooth_raster(mesh, mass, shift=shift))
    ):
        # Even–odd: a ring inside a ring is a hole.
        inside = sum(shapely.contains(shapely.Polygon(ring), point) for ring in rings)
        answers.drawn[row, column] = float(inside % 2)


def level_of(picture: Raster, truth_enu_m: FloatArray) -> tuple[float, FloatArray]:
    """Credible level of the truth, and the regions' areas (3,), m²."""
    east = int(np.floor((truth_enu_m[0] - picture.west_m) / picture.cell_m))
    north = int(np.floor((truth_enu_m[1] - picture.south_m) / picture.cell_m))
    return level_and_areas(picture.mass, picture.cell_m**2, north, east)
