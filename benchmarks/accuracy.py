"""How far off, and how honest: the whole chain against the simulator's truth, over many seeds.

Every byte goes the way it goes in a flight, only the sockets and the wall clock are left out:
simulated vehicles → MAVLink frames → framing → ingest and command desk → windows → the shipped
classifier → the belief. What the station asks of the vehicles (streams, home, impulse
responses) reaches them, and with ``--fly`` its proposals are confirmed at once and flown, as in
``groundstation demo --auto-confirm``.

``inside``: the truth lies within the 90 % radius round the estimate; an honest belief holds it
in 80–97 % of the trials, for the trials of one scenario share its places. Wilson's interval, 95 %.

    python benchmarks/accuracy.py [--scenarios open-field rubble …] [--seeds 10] [--first-seed 1]
        [--at 30 60] [--vehicles 4] [--beacons N] [--fly] [--jobs 1] [--trials] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import statistics
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from groundstation.channel import load_classifier
from groundstation.command.desk import CommandDesk
from groundstation.command.telemetry import TelemetryDesk
from groundstation.domain.inputs import (
    AnyInput,
    Decision,
    Direction,
    FrameInput,
    MissionInput,
    OperatorInput,
    Record,
    SessionInput,
    TickInput,
)
from groundstation.domain.mission import Mission
from groundstation.domain.radio import LinkWindow
from groundstation.domain.target import LinkVerdict, LosSource, TargetState
from groundstation.domain.vehicle import VehicleState
from groundstation.engine.estimator import Estimator
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.engine.ingest import Ingest
from groundstation.guidance import propose
from groundstation.guidance.settings import GuidanceSettings
from groundstation.mavlink.framing import Framer, frame_of
from groundstation.measurement.settings import MeasurementSettings
from groundstation.mission_files import parse_area
from groundstation.pipeline import Pipeline, Work, mission_with_origin
from groundstation.safety.guard import Source
from sim_sitl.scenario import Scenario, area_geojson, fence_geojson
from sim_sitl.scenario_file import load_scenario
from sim_sitl.simulation import Simulation, SimulationSettings
from sim_sitl.world import World

SCENARIOS = ("open-field", "rubble", "city-block", "deep-rubble")
TICK_S = 0.1
PLAN_S = 5.0
START_NS = 1_000_000_000_000
CONNECTION = "simulated"
MOSTLY = 0.5
"""A beacon counts as line-of-sight when more than this share of its windows truly is."""


@dataclass(frozen=True, slots=True)
class Options:
    """One trial, but for scenario and seed."""

    vehicles: int
    beacons: int | None
    at_s: tuple[float, ...]
    fly: bool


@dataclass(frozen=True, slots=True)
class Trial:
    """One beacon at one time of one run."""

    scenario: str
    seed: int
    beacon_id: str
    at_s: float
    error_m: float | None
    """Horizontal; None: no estimate yet."""
    radius_90_m: float | None
    inside: bool | None
    environment: str
    """As the estimator said."""
    los_share: float
    """Share of its windows so far that truly were line-of-sight."""
    windows: int


class Chain:
    """Simulation and station without sockets; ``step`` gives what the estimator must see."""

    def __init__(self, scenario: Scenario, seed: int, options: Options) -> None:
        self.simulation = Simulation(scenario, options.vehicles, options.beacons, seed)
        self.desk = CommandDesk(replay=not options.fly)
        self.pipeline = Pipeline(Ingest(MeasurementSettings()), self.desk)
        self.telemetry = TelemetryDesk()
        self.targets: dict[int, TargetState] = {}
        self._framers = {vehicle: Framer() for vehicle in self.simulation.vehicles}
        self._fly = options.fly
        self._time_s = 0.0
        self._seq = 0
        self._planned_s = 0.0
        self._start_unix_us = SimulationSettings().start_unix_usec
        area = parse_area(json.dumps(area_geojson(scenario)).encode(), scenario.name)
        fence = parse_area(json.dumps(fence_geojson(scenario)).encode(), scenario.name)
        mission = Mission(
            revision=1,
            search_area=area,
            fence=fence if options.fly else None,
            target_height_min_m=scenario.target_height_min_m,
            target_height_max_m=scenario.target_height_max_m,
        )
        self._first = [
            *self._take(SessionInput("began", "accuracy")),
            *self._take(MissionInput(mission, "settings")),
        ]

    def step(self, time_s: float) -> Iterator[Work]:
        """On to ``time_s``: all frames, then a tick, then (flying) a plan."""
        yield from self._first
        self._first = []
        self._time_s = time_s
        for vehicle, frames in self.simulation.step(time_s).items():
            for frame in self._framers[vehicle].feed(b"".join(frames)):
                yield from self._take(FrameInput(CONNECTION, Direction.IN, frame.raw))
        yield from self._take(TickInput())
        if self._fly and self.targets and time_s - self._planned_s >= PLAN_S:
            self._planned_s = time_s
            yield from self._plan()

    def _plan(self) -> Iterator[Work]:
        now = START_NS + round(self._time_s * 1e9)
        request = self.desk.plan_request(now, list(self.targets.values()))
        plan = propose(request, GuidanceSettings(), self.desk.safety)
        if plan.proposals:
            yield from self._take(plan)
        for proposal in self.desk.plan_request(now, ()).outstanding:
            confirm = OperatorInput(
                "accuracy (automatic)", Decision.CONFIRM, proposal.proposal_id, proposal.vehicle_id
            )
            yield from self._take(confirm)

    def _take(self, entry: AnyInput) -> Iterator[Work]:
        since_us = round(self._time_s * 1e6)
        record = Record(self._seq, START_NS + since_us * 1000, self._start_unix_us + since_us, entry)
        self._seq += 1
        step = self.pipeline.handle(record)
        for send in (*step.frames, *self.telemetry.handle(record, step.ingest, self.targets.values())):
            self._send(send.frame, send.vehicle_id, record.time_ns)
        yield from step.work
        for output in step.ingest:
            if isinstance(output, VehicleState):
                mission = mission_with_origin(self.pipeline.mission, output)
                if mission is not None:
                    yield from self._take(MissionInput(mission, "first valid home"))

    def _send(self, frame: bytes, vehicle_id: int | None, time_ns: int) -> None:
        """What the station sends; requests need no guard, what moves a vehicle passes it."""
        if self._fly:
            verdict = self.desk.guard.admit(frame_of(frame), Source.STATION, time_ns)
            if not verdict.admitted:
                return
            vehicle_id = verdict.vehicle_id or vehicle_id
        for vehicle in [vehicle_id] if vehicle_id else list(self.simulation.vehicles):
            if vehicle in self.simulation.vehicles:
                self.simulation.receive(vehicle, frame)


class Truth:
    """What the simulator knows: places, and which windows truly were line-of-sight."""

    def __init__(self, scenario: Scenario, simulation: Simulation) -> None:
        self._frame = scenario.frame
        self._world = World(scenario.obstacles, scenario.propagation.rubble_attenuation_db_per_m)
        self.beacons = {beacon.beacon_id: beacon for beacon in simulation.beacons}
        self.los: dict[int, list[bool]] = {beacon_id: [] for beacon_id in self.beacons}
        self.judged = 0
        self.judged_right = 0
        self.brier = 0.0
        self._state: dict[tuple[int, int, int], bool] = {}

    def note_window(self, window: LinkWindow) -> None:
        """The geometry at the window's mean place."""
        beacon = self.beacons.get(window.beacon_id)
        if beacon is None:
            return
        place = self._frame.to_enu(window.position)
        clear = self._world.obstruction(beacon, place).line_of_sight
        self.los[window.beacon_id].append(clear)
        self._state[window.vehicle_id, window.beacon_id, window.end_ns] = clear

    def note_verdict(self, verdict: LinkVerdict) -> None:
        """Score the classifier."""
        clear = self._state.get((verdict.vehicle_id, verdict.beacon_id, verdict.time_ns))
        if clear is None or verdict.source is not LosSource.CLASSIFIER:
            return
        self.judged += 1
        self.judged_right += (verdict.los_probability >= 0.5) == clear
        self.brier += (verdict.los_probability - clear) ** 2

    def error_m(self, state: TargetState) -> float:
        """Horizontal distance from the truth."""
        east, north, _ = self._frame.to_enu(state.position)
        true_east, true_north, _ = self.beacons[state.beacon_id].position_enu_m
        return math.hypot(east - true_east, north - true_north)

    def los_share(self, beacon_id: int) -> float:
        """Share of the beacon's windows that truly were line-of-sight."""
        states = self.los[beacon_id]
        return sum(states) / len(states) if states else 0.0


def run(name: str, seed: int, options: Options) -> tuple[list[Trial], dict[str, float]]:
    """One flight. Its trials, and what the classifier and the run's clock scored."""
    scenario = load_scenario(name)
    chain = Chain(scenario, seed, options)
    truth = Truth(scenario, chain.simulation)
    estimator = Estimator(EstimatorSettings(), load_classifier())
    trials: list[Trial] = []
    began = time.process_time()
    for step in range(1, round(max(options.at_s) / TICK_S) + 1):
        for work in chain.step(step * TICK_S):
            if isinstance(work.item, LinkWindow):
                truth.note_window(work.item)
            for output in estimator.handle(work.time_ns, work.item):
                if isinstance(output, TargetState):
                    chain.targets[output.beacon_id] = output
                elif isinstance(output, LinkVerdict):
                    truth.note_verdict(output)
        for at_s in options.at_s:
            if step == round(at_s / TICK_S):
                trials += [_trial(name, seed, at_s, b, chain.targets.get(b), truth) for b in truth.beacons]
    score = {
        "judged": truth.judged,
        "judged_right": truth.judged_right,
        "brier": truth.brier,
        "cpu_s": time.process_time() - began,
    }
    return trials, score


def _trial(
    name: str, seed: int, at_s: float, beacon_id: int, state: TargetState | None, truth: Truth
) -> Trial:
    share = round(truth.los_share(beacon_id), 3)
    if state is None:
        return Trial(name, seed, str(beacon_id), at_s, None, None, None, "none", share, 0)
    error = truth.error_m(state)
    return Trial(
        name, seed, str(beacon_id), at_s, round(error, 2), state.radius_90_m, error <= state.radius_90_m,
        state.environment.name, share, state.windows,
    )  # fmt: skip


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a share."""
    if count == 0:
        return 0.0, 1.0
    z = 1.959964
    share = hits / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count)) / (1 + z * z / count)
    return middle - half, middle + half


def _rms(values: Iterable[float]) -> float | None:
    squares = [value * value for value in values]
    return round(math.sqrt(statistics.fmean(squares)), 1) if squares else None


def summary(trials: list[Trial]) -> dict[str, Any]:
    """Of the trials of one scenario and time."""
    known = [t for t in trials if t.error_m is not None and t.radius_90_m is not None]
    errors = [t.error_m for t in known if t.error_m is not None]
    hits = sum(bool(t.inside) for t in known)
    low, high = wilson(hits, len(known))
    return {
        "trials": len(trials),
        "without_estimate": len(trials) - len(known),
        "inside": hits,
        "inside_share": round(hits / len(known), 3) if known else None,
        "inside_low": round(low, 3),
        "inside_high": round(high, 3),
        "median_error_m": round(statistics.median(errors), 1) if errors else None,
        "rmse_m": _rms(errors),
        "rmse_los_m": _rms(t.error_m for t in known if t.error_m is not None and t.los_share > MOSTLY),
        "rmse_nlos_m": _rms(t.error_m for t in known if t.error_m is not None and t.los_share <= MOSTLY),
        "median_radius_90_m": round(statistics.median(t.radius_90_m or 0.0 for t in known), 1)
        if known
        else None,
    }


def report(name: str, trials: list[Trial], scores: list[dict[str, float]], seeds: range) -> dict[str, Any]:
    """Of one scenario, with a row for each beacon."""
    times = sorted({t.at_s for t in trials})
    judged = sum(s["judged"] for s in scores)
    return {
        "scenario": name,
        "seeds": [seeds.start, seeds.stop - 1],
        "classifier": {
            "windows": int(judged),
            "accuracy": round(sum(s["judged_right"] for s in scores) / judged, 3) if judged else None,
            "brier": round(sum(s["brier"] for s in scores) / judged, 3) if judged else None,
        },
        "cpu_s_a_run": round(statistics.fmean(s["cpu_s"] for s in scores), 1),
        "at": {f"{at:g} s": summary([t for t in trials if t.at_s == at]) for at in times},
        "beacons": {
            f"{beacon} at {at:g} s": summary([t for t in trials if t.at_s == at and t.beacon_id == beacon])
            for beacon in dict.fromkeys(t.beacon_id for t in trials)
            for at in times
        },
    }


def show(result: dict[str, Any]) -> str:
    """A table of one scenario."""
    judge = result["classifier"]
    first, last = result["seeds"]
    lines = [
        f"{result['scenario']}: seeds {first}–{last}, classifier {judge['accuracy']} right of"
        f" {judge['windows']} windows (Brier {judge['brier']}), {result['cpu_s_a_run']} s CPU a run",
        f"  {'':28}{'inside 90 %':>12}  {'Wilson 95 %':>13}{'median':>9}{'RMSE':>8}{'LOS':>8}{'NLOS':>8}"
        f"{'radius':>9}",
    ]
    for label, row in [*result["at"].items(), *result["beacons"].items()]:
        known = row["trials"] - row["without_estimate"]
        interval = f"{row['inside_low']:.2f}–{row['inside_high']:.2f}"
        figures = [row["median_error_m"], row["rmse_m"], row["rmse_los_m"], row["rmse_nlos_m"]]
        cells = "".join(f"{'-' if value is None else value:>8}" for value in figures)
        lines.append(
            f"  {label:28}{row['inside']:>6} of {known:<3}{interval:>14}{cells}"
            f"{row['median_radius_90_m']!s:>9}"
            + (f"   {row['without_estimate']} without estimate" if row["without_estimate"] else "")
        )
    return "\n".join(lines)


def _job(entry: tuple[str, int, Options]) -> tuple[list[Trial], dict[str, float]]:
    return run(*entry)


def main() -> None:
    """Run what was asked for and print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--at", type=float, nargs="+", default=[30.0, 60.0], help="seconds of flight")
    parser.add_argument("--duration", type=float, help="seconds of flight: same as --at with one time")
    parser.add_argument("--vehicles", type=int, default=4)
    parser.add_argument("--beacons", type=int, help="more than the scenario's are drawn; default: its own")
    parser.add_argument("--fly", action="store_true", help="confirm and fly all proposals")
    parser.add_argument("--jobs", type=int, default=1, choices=(1, 2))
    parser.add_argument("--trials", action="store_true", help="also print each trial")
    parser.add_argument("--json", type=Path, help="write figures and trials")
    given = parser.parse_args()
    at_s = (given.duration,) if given.duration else tuple(sorted(given.at))
    options = Options(given.vehicles, given.beacons, at_s, given.fly)
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    results: list[dict[str, Any]] = []
    every: list[Trial] = []
    context = multiprocessing.get_context("spawn")
    with context.Pool(given.jobs) as pool:
        for name in given.scenarios:
            done = list(pool.imap(_job, [(name, seed, options) for seed in seeds]))
            trials = [trial for flight, _ in done for trial in flight]
            every += trials
            results.append(report(name, trials, [score for _, score in done], seeds))
            print(show(results[-1]), flush=True)
            for trial in trials if given.trials else ():
                print("   ", *asdict(trial).values(), flush=True)
    if given.json is not None:
        asked = {"vehicles": given.vehicles, "fly": given.fly, "at_s": list(at_s)}
        tree = {"options": asked, "results": results, "trials": [asdict(t) for t in every]}
        given.json.write_text(json.dumps(tree, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
