"""What following beacons costs: cores for 50 beacons heard by 20 vehicles, a window each a second.

Claims: half a core with all windows of a tick in one update; one window alone costs at most ten times its
share of that. Service settings, a still person, flights round the area; extrapolated from a few beacons. CPU
time of the thread; the updates of a tick are taken once each, so medians and means are given, and the
slowest. With --vehicles, --seconds other loads. Errors beside the exact filter: ``sim-sitl study tracking``.

    OMP_NUM_THREADS=1 python benchmarks/bench_tracking.py [--beacons 3] [--seconds 60] [--out FILE.json]
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from reporting import environment, give

from groundstation.localization import SERVICE_MODEL, SearchArea
from groundstation.tracking import Tracker, TrackingSettings, TrackObservation

AREA = SearchArea(np.zeros(2), 150.0, 0.0, 20.0)
BEACONS = 50
SPEED_M_S = 8.0


def windows(
    truth: np.ndarray, second: int, vehicles: int, los: bool, rng: np.random.Generator
) -> list[TrackObservation]:
    """One tick's windows of all vehicles on a ring; bearings of obstructed links point anywhere."""
    turn = 2.0 * math.pi * np.arange(vehicles) / vehicles + SPEED_M_S / 100.0 * second
    places = np.stack([100.0 * np.cos(turn), 100.0 * np.sin(turn), np.full(vehicles, 50.0)], axis=1)
    offset = truth - places
    rss = 15.0 - 27.0 * np.log10(np.linalg.norm(offset, axis=1)) + 5.0 * rng.standard_normal(vehicles)
    azimuth = np.arctan2(offset[:, 1], offset[:, 0]) + 0.017 * rng.standard_normal(vehicles)
    elevation = np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1]))
    if not los:
        azimuth, elevation = rng.uniform(-np.pi, np.pi, vehicles), rng.uniform(-1.4, 0.1, vehicles)
    return [
        TrackObservation(
            v + 1, (float(places[v, 0]), float(places[v, 1]), float(places[v, 2])), float(rss[v]), None,
            float(azimuth[v]), float(elevation[v]), None, None, 0.9 if los else 0.1, time_s=float(second),
        )
        for v in range(vehicles)
    ]  # fmt: skip


def load(seed: int, los: bool, vehicles: int, beacons: int, seconds: int, alone: bool) -> dict[str, Any]:
    """CPU of ``beacons`` trackers over ``seconds``; ``alone``: every window in an update of its own."""
    rng = np.random.default_rng(seed)
    truths = rng.uniform(-80.0, 80.0, (beacons, 3)) * [1.0, 1.0, 0.0] + [0.0, 0.0, 5.0]
    trackers = [Tracker(AREA, SERVICE_MODEL, TrackingSettings(), seed=n) for n in range(beacons)]
    spent: list[float] = []
    for second in range(seconds):
        for tracker, truth in zip(trackers, truths, strict=True):
            tick = windows(truth, second, vehicles, los, rng)
            for batch in [[window] for window in tick] if alone else [tick]:
                began = time.thread_time()
                tracker.update(batch)
                # What the service asks for after an update.
                _ = tracker.mass
                spent.append(time.thread_time() - began)
    per_beacon_s = sum(spent) / seconds / beacons
    return {
        "ms_an_update": round(1e3 * float(np.mean(spent)), 2),
        "median_ms": round(1e3 * float(np.median(spent)), 2),
        "slowest_ms": round(1e3 * max(spent), 1),
        "cores_for_50_beacons": round(BEACONS * per_beacon_s, 3),
    }


def measured(seed: int, los: bool, vehicles: int, beacons: int, seconds: int) -> dict[str, Any]:
    """A tick at once, and window by window (fewer seconds: it is dear)."""
    together = load(seed, los, vehicles, beacons, seconds, False)
    one = load(seed, los, vehicles, 1, max(seconds // 3, 1), True)
    share = together["ms_an_update"] / vehicles
    return {
        "tick at once": together,
        "window by window": one,
        "one window over its share of a tick": round(one["ms_an_update"] / share, 1),
    }


def run_both(
    measured: Callable[[int, bool, int, int, int], dict[str, Any]],
    description: str | None,
    beacons: int,
    seconds: int,
    least_seconds: int = 1,
) -> None:
    """Measure in line of sight and obstructed, as the command line asks, and write JSON."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--beacons", type=int, default=beacons)
    parser.add_argument("--seconds", type=int, default=seconds)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.seconds < least_seconds:
        parser.error(f"--seconds is {options.seconds}; {least_seconds} or more are needed")
    asked = (options.vehicles, options.beacons, options.seconds)
    report: dict[str, Any] = {
        "environment": environment("numpy", "scipy", "shapely"),
        "seed": options.seed,
        "vehicles": options.vehicles,
        "beacons_measured": options.beacons,
        "seconds": options.seconds,
        "line of sight": measured(options.seed, True, *asked),
        "obstructed": measured(options.seed, False, *asked),
    }
    give(report, options.out)


if __name__ == "__main__":
    run_both(measured, __doc__, beacons=3, seconds=60)
