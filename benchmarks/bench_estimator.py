"""What the whole estimator costs: 50 beacons heard by 20 vehicles, a window each a second.

Claim: one process keeps up, for what it does beside the beliefs' updates (snapshots, regions, search maps,
"Why there?", who listened, verdicts) is bounded: of many beacons each has its turn less often. The
alternative in the same run is the bare ``Tracker.update`` of the same windows, a tick at once. CPU time of
the thread; the first second, in which all beacons are new at once, is told apart.

    OMP_NUM_THREADS=1 python benchmarks/bench_estimator.py [--beacons 50] [--seconds 20] [--out FILE.json]
"""

from __future__ import annotations

import time
from collections import Counter
from typing import Any

import numpy as np
import shapely
from bench_tracking import run_both, windows

from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.inputs import MissionInput, TickInput
from groundstation.domain.mission import Area, Mission
from groundstation.domain.radio import CloseReason, LinkWindow
from groundstation.engine.estimator import Estimator
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.localization import SERVICE_MODEL, SearchArea
from groundstation.tracking import Tracker, TrackingSettings, TrackObservation

FRAME = LocalFrame(Geodetic(47.25, -122.5, 120.0))
HALF_M = 150.0
NS = 1_000_000_000
SETTLED_S = 3
"""From then on no beacon is new."""


def mission() -> MissionInput:
    """A square of 300 m."""
    corners = ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
    places = [FRAME.to_geodetic((HALF_M * east, HALF_M * north, 0.0)) for east, north in corners]
    ring = tuple((place.latitude_deg, place.longitude_deg) for place in places)
    area = Area(((ring,),))
    return MissionInput(Mission(1, FRAME.origin, area, ground_amsl_m=120.0, height_reference="home"), "bench")


def link_window(heard: TrackObservation, beacon_id: int) -> LinkWindow:
    """What the estimator is given of it."""
    end_ns = round(heard.time_s * NS)
    return LinkWindow(
        vehicle_id=heard.vehicle_id, beacon_id=beacon_id, start_ns=end_ns - NS, end_ns=end_ns,
        position=FRAME.to_geodetic(heard.position_enu_m), attitude=(1.0, 0.0, 0.0, 0.0), path_length_m=8.0,
        rss_dbm=heard.rss_dbm, rss_std_error_db=0.5, rss_count=16, noise_dbm=-110.0,
        frequency_hz=867_500_000, missed_count=0,
        azimuth_rad=heard.azimuth_rad, azimuth_std_error_rad=0.01,
        elevation_rad=heard.elevation_rad, elevation_std_error_rad=0.01, aoa_count=16,
        captures=(), sensor_los_probability=heard.los_probability, close_reason=CloseReason.FULL,
    )  # fmt: skip


def measured(seed: int, los: bool, vehicles: int, beacons: int, seconds: int) -> dict[str, Any]:
    """Cores of the engine, and of the same beacons' bare trackers."""
    rng = np.random.default_rng(seed)
    truths = rng.uniform(-80.0, 80.0, (beacons, 3)) * [1.0, 1.0, 0.0] + [0.0, 0.0, 5.0]
    engine = Estimator(EstimatorSettings(), None)
    engine.handle(0, mission())
    square = shapely.box(-HALF_M, -HALF_M, HALF_M, HALF_M)
    area = SearchArea.of_polygon(square, 0.0, 20.0)
    trackers = [Tracker(area, SERVICE_MODEL, TrackingSettings(), seed=n) for n in range(beacons)]
    told: Counter[str] = Counter()
    spent, bare = np.zeros((2, seconds))
    for second in range(1, seconds + 1):
        ticks = [windows(truth, second, vehicles, los, rng) for truth in truths]
        inputs = [link_window(heard, 1 + n) for n, tick in enumerate(ticks) for heard in tick]
        began = time.thread_time()
        for window in inputs:
            told.update(type(output).__name__ for output in engine.handle(window.end_ns, window))
        for tenth in range(10):
            outputs = engine.handle(second * NS + tenth * NS // 10, TickInput())
            told.update(type(output).__name__ for output in outputs)
        spent[second - 1] = time.thread_time() - began
        began = time.thread_time()
        for tracker, tick in zip(trackers, ticks, strict=True):
            tracker.update(tick)
            _ = tracker.mass
        bare[second - 1] = time.thread_time() - began
    settled = slice(SETTLED_S, None)
    return {
        "cores": round(float(spent[settled].mean()), 3),
        "busiest_second_s": round(float(spent[settled].max()), 2),
        "first_second_s": round(float(spent[0]), 2),
        "bare_updates_cores": round(float(bare[settled].mean()), 3),
        "engine over bare updates": round(float(spent[settled].sum() / bare[settled].sum()), 2),
        "told": dict(sorted(told.items())),
    }


if __name__ == "__main__":
    run_both(measured, __doc__, beacons=50, seconds=20, least_seconds=SETTLED_S + 1)
