"""One UAV, received power only, no calibration: how far off, and how honest, over many flights.

Each flight is drawn by ``sim_sitl.surveyor`` (two-ray ground, dipoles, airframe, shadowing, fading,
lost lock, decibels with any zero), written as a recording and read by the whole chain as
``groundstation replay FILE.tlog --area AREA.geojson`` reads it. Beside it what others do with
the same samples: the place of the strongest reading, the centroid weighed by power, a
least-squares fit of the log-distance law.

    python benchmarks/lone_surveyor.py [--flights 40] [--first-seed 1] [--plans stops lanes]
        [--at 180 400 600] [--no-area] [--jobs 1] [--trials] [--write DIR] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import statistics
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from groundstation.config import Config
from groundstation.domain.geometry import LocalFrame
from groundstation.domain.mission import Mission
from groundstation.domain.target import TargetState
from groundstation.mission_files import parse_area
from groundstation.replay import replay_tlog
from sim_sitl.surveyor import ORIGIN, Flight, Survey, draw, fly, write_area, write_tlog

FloatArray = NDArray[np.float64]
BLOCK_S = 2.0
"""The simple methods see means of so many seconds, so that fading does not decide."""


@dataclass(frozen=True, slots=True)
class Options:
    """One flight, but for seed and plan."""

    at_s: tuple[float, ...]
    area: bool
    folder: Path | None


@dataclass(frozen=True, slots=True)
class Trial:
    """One flight at one time."""

    seed: int
    plan: str
    at_s: float
    error_m: float | None
    """Horizontal; None: no estimate yet."""
    radius_90_m: float | None
    inside: bool | None
    """Whether the truth lies in the estimate's 90 % radius."""
    strongest_m: float
    centroid_m: float
    fit_m: float
    unknowing_m: float
    """Error of the middle of the area."""


def blocks(flight: Flight, until_s: float) -> tuple[FloatArray, FloatArray]:
    """(m, 3) places and (m,) mean powers of blocks of BLOCK_S; powers are averaged as powers."""
    heard = flight.sample_s < until_s
    times, power = flight.sample_s[heard], flight.power_db[heard]
    number = (times / BLOCK_S).astype(int)
    kept = np.unique(number)
    places = np.stack(
        [np.interp(times, flight.pose_s, flight.position_enu_m[:, axis]) for axis in range(3)], axis=1
    )
    middle = np.array([places[number == k].mean(axis=0) for k in kept])
    level = np.array([10.0 * math.log10(float(np.mean(10.0 ** (0.1 * power[number == k])))) for k in kept])
    return middle.reshape(-1, 3), level


def simple_answers(places: FloatArray, level: FloatArray, half_m: float) -> tuple[FloatArray, ...]:
    """(2,) metres each: strongest place, centroid of the strongest quarter, best log-distance fit."""
    strongest = places[np.argmax(level), :2]
    best = level >= np.quantile(level, 0.75)
    weight = 10.0 ** (0.1 * (level[best] - level.max()))
    centroid = weight @ places[best, :2] / weight.sum()

    def residual(unknown: FloatArray) -> FloatArray:
        away = np.hypot(np.hypot(*(places[:, :2] - unknown[:2]).T), places[:, 2] - 1.5)
        result: FloatArray = level - unknown[2] + 10.0 * unknown[3] * np.log10(np.maximum(away, 1.0))
        return result

    limit = 1.2 * half_m
    bounds = ([-limit, -limit, -np.inf, 1.5], [limit, limit, np.inf, 8.0])
    fits = []
    for start in (
        strongest,
        centroid,
        np.zeros(2),
        *(0.5 * half_m * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])),
    ):
        first = np.array([*np.clip(start, -0.99 * limit, 0.99 * limit), float(level.max()) + 40.0, 2.5])
        fits.append(least_squares(residual, first, bounds=bounds, loss="soft_l1", f_scale=3.0))
    fit = min(fits, key=lambda answer: float(answer.cost)).x[:2]
    return strongest, centroid, fit


def run(seed: int, plan: str, options: Options) -> list[Trial]:
    """One flight through the whole chain."""
    survey = draw(seed, plan)
    flight = fly(survey)
    with tempfile.TemporaryDirectory() as made:
        folder = options.folder or Path(made)
        recording = folder / f"{plan}-{seed}.tlog"
        write_tlog(flight, recording)
        write_area(survey, recording.with_suffix(".geojson"))
        return [_trial(survey, flight, plan, at_s, state) for at_s, state in _replayed(recording, options)]


def _replayed(recording: Path, options: Options) -> list[tuple[float, TargetState | None]]:
    told: list[tuple[int, TargetState]] = []

    def show(record: Any, _step: Any, outputs: Any) -> None:
        told.extend((record.time_ns, output) for output in outputs if isinstance(output, TargetState))

    mission = None
    if options.area:
        area = recording.with_suffix(".geojson")
        mission = Mission(revision=1, search_area=parse_area(area.read_bytes(), area.name))
    result = replay_tlog(recording, Config(), mission=mission, show=show)
    answers: list[tuple[float, TargetState | None]] = []
    for at_s in options.at_s:
        until_ns = result.first_ns + round(at_s * 1e9)
        answers.append(
            (at_s, next((state for time_ns, state in reversed(told) if time_ns <= until_ns), None))
        )
    return answers


def _trial(survey: Survey, flight: Flight, plan: str, at_s: float, state: TargetState | None) -> Trial:
    places, level = blocks(flight, at_s)
    target = np.array(survey.target_enu_m[:2])

    def off(place: FloatArray) -> float:
        return round(float(np.hypot(*(place - target))), 2)

    if level.size >= 5:
        simple = [off(place) for place in simple_answers(places, level, survey.half_width_m)]
    else:
        simple = [off(np.zeros(2))] * 3
    error = radius = inside = None
    if state is not None:
        error = off(np.array(LocalFrame(ORIGIN).to_enu(state.position)[:2]))
        radius = state.radius_90_m
        inside = error <= radius
    return Trial(survey.seed, plan, at_s, error, radius, inside, *simple, off(np.zeros(2)))


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a share."""
    if not count:
        return 0.0, 1.0
    z, share = 1.959964, hits / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count)) / (1 + z * z / count)
    return middle - half, middle + half


def show(trials: list[Trial]) -> str:
    """A table: a line for each plan and time."""
    lines = [
        f"{'':18}{'inside 90 %':>12} {'Wilson 95 %':>12}{'radius':>8} | median error, m (RMSE)"
        f"\n{'':18}{'':33} | {'station':>14}{'strongest':>14}{'centroid':>14}{'fit':>14}{'middle':>14}"
    ]
    for plan, at_s in sorted({(t.plan, t.at_s) for t in trials}):
        some = [t for t in trials if (t.plan, t.at_s) == (plan, at_s)]
        known = [t for t in some if t.error_m is not None]
        hits = sum(bool(t.inside) for t in known)
        low, high = wilson(hits, len(known))
        radius = statistics.median(t.radius_90_m or 0.0 for t in known) if known else math.nan
        cells = ""
        for name in ("error_m", "strongest_m", "centroid_m", "fit_m", "unknowing_m"):
            errors = [getattr(t, name) for t in known]
            rmse = math.sqrt(statistics.fmean(e * e for e in errors)) if errors else math.nan
            cells += f"{statistics.median(errors) if errors else math.nan:7.1f} ({rmse:4.0f})"
        lines.append(
            f"{plan:8}{at_s:6.0f} s  {hits:>5} of {len(known):<4} {low:5.2f}–{high:<5.2f}{radius:8.1f}"
            f" | {cells}"
        )
    return "\n".join(lines)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--plans", nargs="+", choices=("stops", "lanes"), default=["stops", "lanes"])
    parser.add_argument("--at", nargs="+", type=float, default=[180.0, 400.0, 600.0], metavar="SECONDS")
    parser.add_argument("--no-area", action="store_true", help="500 m round the first place instead")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--trials", action="store_true", help="print every trial")
    parser.add_argument("--write", type=Path, help="keep the recordings here")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    if given.write is not None:
        given.write.mkdir(parents=True, exist_ok=True)
    options = Options(tuple(given.at), not given.no_area, given.write)
    seeds = range(given.first_seed, given.first_seed + given.flights)
    tasks = [(seed, plan, options) for plan in given.plans for seed in seeds]
    began = time.process_time()
    if given.jobs > 1:
        with multiprocessing.get_context("spawn").Pool(given.jobs) as pool:
            done = pool.starmap(run, tasks)
    else:
        done = [run(*task) for task in tasks]
    trials = [trial for flight in done for trial in flight]
    print(show(trials), flush=True)
    if given.trials:
        for trial in trials:
            print(*asdict(trial).values())
    print(f"seeds {seeds.start}–{seeds.stop - 1}; {time.process_time() - began:.0f} s of processor time")
    if given.json is not None:
        given.json.write_text(
            json.dumps([asdict(trial) for trial in trials], indent=1) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main()
