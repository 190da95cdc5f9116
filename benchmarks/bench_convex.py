"""The convex programs of LSRE and of its baselines: our solvers beside CVXPY + Clarabel, same run.

Claims: a solve in a batch is 50 times cheaper than the program in CVXPY as most people write it (built
anew for each solve) and 3 times cheaper than its fast form (parametrised, built once, DPP). A single
solve stands beside them. CVXPY solves with Clarabel, tolerance 1e-9 on both sides; answers are compared
by objective. Times are CPU time, least of the repeats. ``convex_peers`` has the programs in CVXPY,
``convex_problems`` what both sides solve.

    python benchmarks/bench_convex.py [--problems 10] [--seed 1] [--out FILE.json]
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from convex_peers import Peer, RangePeer
from convex_problems import AREA, draw, draw_los, numbers, range_data
from reporting import environment, give

from groundstation.localization.baselines.lifting import lifted_constraints
from groundstation.localization.baselines.lsre_sdp import lsre_sdp_positions, lsre_sdp_program
from groundstation.localization.baselines.rwls_sdp import rwls_sdp_positions, rwls_sdp_program
from groundstation.localization.baselines.sdp_socp import sdp_socp
from groundstation.localization.batch import Batch
from groundstation.localization.interior import minimise
from groundstation.localization.lsre_literal import literal_positions
from groundstation.localization.lsre_sound import convex_concave_step, majoriser
from groundstation.localization.region import Region

BATCH_SIZES = (1, 3, 10, 30, 100, 300)
"""A single solve is the cost of calls into NumPy; the curve shows from which batch on it is not."""


@dataclass(frozen=True)
class Ours:
    """One of our solvers."""

    solve: Callable[[Batch, Region, Any], Any]
    """Batch, region, starts (N, 3) → places (N, 3), metres."""
    objective: Callable[[Batch, Region, Any], Any] | None
    """Batch, region, starts → optima (N,) in the peer's terms; None: the peer's infimum is not attained."""
    batch: int
    """Problems of the batch that is timed."""


def _first(batch: Batch) -> tuple[Any, Any]:
    return batch.first_power_dbm(), batch.first_exponents()


def _ccp_optimum(batch: Batch, region: Region, start: Any) -> Any:
    bound, value = majoriser(batch, region, start, *_first(batch))
    found = region.scaled(convex_concave_step(batch, region, start, *_first(batch)))
    return bound.evaluate(found)[0] * value


def _sdp_optimum(batch: Batch, region: Region, start: Any) -> Any:
    program, inner, scale = lsre_sdp_program(batch, region, *_first(batch))
    return minimise(program, lifted_constraints(region), inner, centred=True).value * scale


def _rwls_optimum(batch: Batch, region: Region, start: Any) -> Any:
    return minimise(*rwls_sdp_program(batch, region, *_first(batch)), centred=True).value


PROGRAMS = {
    "lsre_socp": Ours(lambda b, r, s: literal_positions(b, *_first(b)), None, 1000),
    "lsre_ccp": Ours(lambda b, r, s: convex_concave_step(b, r, s, *_first(b)), _ccp_optimum, 1000),
    "lsre_sdp": Ours(lambda b, r, s: lsre_sdp_positions(b, *_first(b)), _sdp_optimum, 1000),
    "rwls_sdp": Ours(lambda b, r, s: rwls_sdp_positions(b, *_first(b)), _rwls_optimum, 1000),
}


def least(action: Callable[[], Any], repeats: int) -> float:
    """Least CPU seconds of so many calls."""
    best = math.inf
    for _ in range(repeats):
        began = time.process_time()
        action()
        best = min(best, time.process_time() - began)
    return best


def measure(cp: Any, name: str, problems: int, seed: int) -> dict[str, Any]:
    """One program."""
    ours, region = PROGRAMS[name], Region.of(AREA)
    many, few = draw(ours.batch, seed), draw(problems, seed + 1)
    start = np.tile([10.0, -5.0, 9.0], (ours.batch, 1))
    data = numbers(few, region, start[:problems])
    batch_s = least(lambda: ours.solve(many, region, start), 5) / ours.batch
    curve = {}
    for size in BATCH_SIZES:
        some = many.rows(slice(0, size))
        curve[str(size)] = round(
            1e6 * least(lambda p=some, n=size: ours.solve(p, region, start[:n]), 5) / size, 1
        )
    single_s, anew_s, parametrised_s = [], [], []
    places, values = [], []
    fixed = Peer(cp, name, region, None)
    dpp = bool(fixed.problem.is_dcp(dpp=True))
    fixed.solve(data[0])
    for row, one in enumerate(data):
        part = few.rows([row])
        single_s.append(least(lambda p=part: ours.solve(p, region, start[:1]), 5))
        anew_s.append(least(lambda o=one: Peer(cp, name, region, o).solve(o), 2))
        parametrised_s.append(least(lambda o=one: fixed.solve(o), 3))
        places.append(region.metres(np.asarray(fixed.solve(one))))
        values.append(float(fixed.problem.value))
    found = ours.solve(few, region, start[:problems])
    single, anew, parametrised = (float(np.mean(v)) for v in (single_s, anew_s, parametrised_s))
    worst = None
    if ours.objective is not None:
        optimum = ours.objective(few, region, start[:problems])
        worst = float(np.max(np.abs(optimum - values) / np.maximum(np.abs(values), 1e-3)))
    return {
        "ours_single_us": round(1e6 * single, 1),
        "ours_in_a_batch_us": round(1e6 * batch_s, 2),
        "batch": ours.batch,
        "ours_us_a_solve_by_batch_size": curve,
        "cvxpy_built_anew_us": round(1e6 * anew, 1),
        "cvxpy_parametrised_us": round(1e6 * parametrised, 1),
        "parametrised_is_dpp": dpp,
        "anew_over_single": round(anew / single, 1),
        "anew_over_batch": round(anew / batch_s, 1),
        "parametrised_over_single": round(parametrised / single, 2),
        "parametrised_over_batch": round(parametrised / batch_s, 1),
        "worst_relative_difference_of_objective": worst,
        "worst_difference_east_north_m": float(np.abs(found - np.array(places))[:, :2].max()),
    }


def reduced(data: dict[str, Any], position_m: Any) -> float:
    """The hybrid's objective at a place (3,) with the best r_k."""
    at = position_m / AREA.radius_m
    gap = np.linalg.norm(at - data["place"], axis=1)
    excess = np.maximum(data["inverse"] * gap - data["root"], 0.0)
    return float(np.square(excess).sum() + np.square(data["rows"] @ at - data["right"]).sum())


def measure_sdp_socp(cp: Any, problems: int, seed: int, size: int = 1000) -> dict[str, Any]:
    """The LOS baseline, with neither heights nor area, as it is written."""
    many, few = draw_los(size, seed), draw_los(problems, seed + 1)
    batch_s = least(lambda: sdp_socp(many), 5) / size
    peer = RangePeer(cp, None)
    peer.solve(range_data(few.rows([0])))
    times: list[list[float]] = [[], [], []]
    worst = apart = 0.0
    for row in range(problems):
        one = few.rows([row])
        data = range_data(one)
        times[0].append(least(lambda o=one: sdp_socp(o), 5))
        times[1].append(least(lambda d=data: RangePeer(cp, d).solve(d), 2))
        times[2].append(least(lambda d=data: peer.solve(d), 3))
        value, place = peer.solve(data)
        found = sdp_socp(one).position_enu_m[0]
        worst = max(worst, abs(reduced(data, found) / value - 1.0))
        apart = max(apart, float(np.abs(found - place).max()))
    single, anew, parametrised = (float(np.mean(v)) for v in times)
    return {
        "ours_single_us": round(1e6 * single, 1),
        "ours_in_a_batch_us": round(1e6 * batch_s, 2),
        "batch": size,
        "cvxpy_built_anew_us": round(1e6 * anew, 1),
        "cvxpy_parametrised_us": round(1e6 * parametrised, 1),
        "parametrised_is_dpp": bool(peer.problem.is_dcp(dpp=True)),
        "anew_over_single": round(anew / single, 1),
        "anew_over_batch": round(anew / batch_s, 1),
        "parametrised_over_single": round(parametrised / single, 2),
        "parametrised_over_batch": round(parametrised / batch_s, 1),
        "worst_relative_difference_of_objective": worst,
        "worst_difference_m": apart,
    }


def main() -> None:
    """Run all and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--problems", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    report: dict[str, Any] = {"name": "convex", "problems": options.problems, "seed": options.seed}
    try:
        import cvxpy
    except ImportError:
        report["figures"] = "cvxpy is not installed: pip install groundstation[bench]"
    else:
        report["environment"] = environment("numpy", "cvxpy", "clarabel")
        report["figures"] = {}
        for number, name in enumerate(PROGRAMS, 1):
            print(f"[{number}/{len(PROGRAMS)}] {name}", file=sys.stderr, flush=True)
            report["figures"][name] = measure(cvxpy, name, options.problems, options.seed)
        print("sdp_socp", file=sys.stderr, flush=True)
        report["figures"]["sdp_socp"] = measure_sdp_socp(cvxpy, options.problems, options.seed)
    give(report, options.out)


if __name__ == "__main__":
    main()
