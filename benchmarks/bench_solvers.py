"""Solvers and tracker: error beside the limit, cost beside the peer, in one run.

Claims: WLS-Taylor reaches the Cramér–Rao bound and gains from batches; the assembled LSRE
step costs a fraction of the same program written in CVXPY and built anew (answers compared);
the service's NLOS method is the one with the smallest error inside and outside the ring; a
tracker's updates stay below a core for 20 vehicles and 50 beacons (extrapolated from 3).

    python benchmarks/bench_solvers.py [--trials 400] [--seed 1] [--out FILE.json]
"""

from __future__ import annotations

import argparse
import json
import math
import platform
import time
from pathlib import Path
from typing import Any

import clarabel
import numpy as np
import scipy

from groundstation.localization import (
    METHODS,
    SERVICE_MODEL,
    Links,
    SearchArea,
    SignalModel,
    crlb,
    locate_batch,
)
from groundstation.localization.conic import majoriser
from groundstation.localization.lsre import first_exponents, gains_per_m, lsre_criterion
from groundstation.tracking import Belief, TrackingSettings, TrackObservation

MODEL = SignalModel()
RING = 2.0 * math.pi * np.arange(4) / 4
GEOMETRIES = {
    "inside the ring": (RING, 0.0),
    "outside: disc 150 m west of an uneven arc": (np.array([-0.6, -0.2, 0.2, 0.6]), -150.0),
}


def draw(
    trials: int, los: tuple[int, ...], seed: int, ring: Any = RING, shift_m: float = 0.0
) -> tuple[Links, Any, SearchArea]:
    """The paper's V-C with R₀ = 100 m; NLOS by eq. (8): one β ~ U(2, 3.5) a trial, b_k ~ U(0, 7) dB."""
    rng = np.random.default_rng(seed)
    label = np.array(los, dtype=float)
    place = np.stack([100 * np.cos(ring), 100 * np.sin(ring), np.full(ring.size, 50.0)], axis=-1)
    reach, turn = 100 * np.sqrt(rng.random(trials)), 2 * np.pi * rng.random(trials)
    truth = np.stack(
        [reach * np.cos(turn) + shift_m, reach * np.sin(turn), rng.uniform(1, 20, trials)], axis=-1
    )
    offset = truth[:, None] - place
    distance = np.linalg.norm(offset, axis=-1)
    shape = (trials, ring.size)
    exponent = np.where(label > 0, 2.5, rng.uniform(2.0, 3.5, (trials, 1)))
    rss = rng.uniform(13, 18, (trials, 1)) - 10 * exponent * np.log10(distance)
    rss += 5 * rng.standard_normal(shape) - (1 - label) * rng.uniform(0, 7, shape)
    noise = math.radians(1.0) * rng.standard_normal((2, *shape))
    azimuth = np.arctan2(offset[..., 1], offset[..., 0]) + noise[0]
    elevation = np.arctan2(offset[..., 2], np.hypot(offset[..., 0], offset[..., 1])) + noise[1]
    links = Links(
        np.broadcast_to(place, (*shape, 3)).copy(),
        rss,
        np.where(label > 0, azimuth, np.nan),
        np.where(label > 0, elevation, np.nan),
        np.broadcast_to(label, shape).copy(),
    )
    return links, truth, SearchArea(np.array([shift_m, 0.0]), 100.0, 1.0, 20.0)


def score(links: Links, truth: Any, area: SearchArea, method: str) -> dict[str, Any]:
    """RMSE in three dimensions with its standard error, and whether the covariance is honest."""
    began = time.process_time()
    estimates = locate_batch(links, area, method)
    spent = time.process_time() - began
    error = np.array([e.position_enu_m for e in estimates]) - truth
    square = np.square(error).sum(axis=1)
    rmse = float(np.sqrt(square.mean()))
    inside = [
        float(e @ np.linalg.solve(s.covariance_m2, e)) < 6.251 for e, s in zip(error, estimates, strict=True)
    ]
    return {
        "rmse_m": round(rmse, 3),
        "standard_error_m": round(float(square.std() / (2 * rmse * math.sqrt(len(square)))), 3),
        "in_90_percent_ellipsoid": round(float(np.mean(inside)), 3),
        "ms_a_problem_with_covariance": round(1e3 * spent / len(square), 4),
    }


def errors(trials: int, seed: int) -> dict[str, Any]:
    """RMSE of each method in each environment, the limit beside it."""
    table: dict[str, Any] = {}
    links, truth, area = draw(trials, (1, 1, 1, 1), seed)
    bound = float(np.sqrt(np.trace(crlb(truth, links.position_enu_m, MODEL), axis1=1, axis2=2).mean()))
    los = {m: score(links, truth, area, m) for m in ("wls-taylor", "wls-taylor-bounded", "posterior")}
    for row in los.values():
        row["over_bound"] = round(row["rmse_m"] / bound, 4)
    table["LOS"] = {"crlb_m": round(bound, 3), "methods": los}
    links, truth, area = draw(trials, (1, 0, 0, 0), seed + 1)
    mixed = [m for m in METHODS if m.startswith(("projection", "posterior", "lsre-socp"))]
    table["mixed"] = {
        "limit_m": 14.1,
        "methods": {m: score(links, truth, area, m) for m in mixed},
    }
    nlos = [m for m in METHODS if m.startswith(("lsre", "posterior"))]
    for number, (name, (ring, shift)) in enumerate(GEOMETRIES.items()):
        links, truth, area = draw(trials, (0, 0, 0, 0), seed + 2 + number, ring, shift)
        table[f"NLOS, {name}"] = {
            "limit_m": 45.0 if shift == 0.0 else None,
            "methods": {m: score(links, truth, area, m) for m in nlos},
        }
    return table


def wls_batch(seed: int, size: int = 1000) -> dict[str, Any]:
    """One WLS-Taylor at a time against a batch."""
    links, _, area = draw(size, (1, 1, 1, 1), seed)
    began = time.process_time()
    locate_batch(links, area, "wls-taylor-bounded")
    batch = time.process_time() - began
    began = time.process_time()
    for index in range(0, size, 10):
        alone = slice(index, index + 1)
        locate_batch(links.subset(alone), area, "wls-taylor-bounded")
    single = 10 * (time.process_time() - began)
    return {
        "single_us": round(1e6 * single / size, 1),
        "batch_us": round(1e6 * batch / size, 1),
        "ratio": round(single / batch, 1),
    }


def lsre_step(seed: int, problems: int = 20) -> dict[str, Any]:
    """One convex–concave step, ours and CVXPY's built anew, both with Clarabel at 1e-9; criteria compared."""
    import cvxpy

    links, _, area = draw(problems, (0, 0, 0, 0), seed)
    ours = peer = 0.0
    worst = 0.0
    for index in range(problems):
        one = links.problem(index)
        exponent = first_exponents(one, MODEL)
        gain = gains_per_m(one, 15.0, exponent, MODEL)
        end = 10 ** (MODEL.nlos_bias_max_db / (20 * exponent))
        weight = end**2 + end**-2
        start = np.array([10.0, -5.0, 9.0])
        began = time.process_time()
        found, _ = majoriser(one.position_enu_m, gain, weight, area)(start)
        ours += time.process_time() - began
        began = time.process_time()
        x, t = cvxpy.Variable(3), cvxpy.Variable(4)
        offset = start - one.position_enu_m
        distance = np.linalg.norm(offset, axis=1)
        relative = cvxpy.multiply(gain, distance + (offset / distance[:, None]) @ (x - start))
        far = sum(weight[k] * gain[k] ** 2 * cvxpy.sum_squares(x - one.position_enu_m[k]) for k in range(4))
        problem = cvxpy.Problem(
            cvxpy.Minimize(far + cvxpy.sum(cvxpy.multiply(weight, cvxpy.square(t)))),
            [
                t >= cvxpy.inv_pos(relative),
                cvxpy.norm(x[:2]) <= area.radius_m,
                x[2] >= area.height_min_m,
                x[2] <= area.height_max_m,
            ],
        )
        problem.solve(solver=cvxpy.CLARABEL, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
        peer += time.process_time() - began
        ours_value = lsre_criterion(one, found, 15.0, exponent, MODEL)
        peer_value = lsre_criterion(one, np.asarray(x.value), 15.0, exponent, MODEL)
        worst = max(worst, abs(ours_value / peer_value - 1))
    return {
        "ours_ms": round(1e3 * ours / problems, 3),
        "cvxpy_built_anew_ms": round(1e3 * peer / problems, 3),
        "ratio": round(peer / ours, 1),
        "worst_relative_difference_of_criterion": worst,
    }


def tracker(seed: int, los: bool, vehicles: int = 20, beacons: int = 3, seconds: int = 40) -> dict[str, Any]:
    """CPU of the service's belief: a window a vehicle and beacon every two seconds, one update a second.

    Bearings of obstructed links point anywhere, as real arrays' do.
    """
    rng = np.random.default_rng(seed)
    area = SearchArea(np.zeros(2), 150.0, 0.0, 20.0)
    truths = rng.uniform(-80, 80, (beacons, 3)) * [1, 1, 0] + [0, 0, 5]
    beliefs = [Belief(area, SERVICE_MODEL, TrackingSettings()) for _ in truths]
    spent, slowest = 0.0, 0.0
    for second in range(seconds):
        turn = 2 * np.pi * np.arange(vehicles) / vehicles + 0.08 * second
        places = np.stack([100 * np.cos(turn), 100 * np.sin(turn), np.full(vehicles, 50.0)], axis=1)
        for belief, truth in zip(beliefs, truths, strict=True):
            offset = truth - places
            rss = 15 - 27 * np.log10(np.linalg.norm(offset, axis=1)) + 5 * rng.standard_normal(vehicles)
            azimuth = np.arctan2(offset[:, 1], offset[:, 0]) + 0.017 * rng.standard_normal(vehicles)
            elevation = np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1]))
            if not los:
                azimuth, elevation = rng.uniform(-np.pi, np.pi, vehicles), rng.uniform(-1.4, 0.1, vehicles)
            batch = [
                TrackObservation(
                    v, tuple(places[v]), float(rss[v]), None, float(azimuth[v]), float(elevation[v]),
                    None, None, 0.9 if los else 0.1,
                )
                for v in range(vehicles)
                if (v + second) % 2 == 0
            ]  # fmt: skip
            began = time.process_time()
            belief.update(batch)
            took = time.process_time() - began
            spent, slowest = spent + took, max(slowest, took)
    return {
        "vehicles": vehicles,
        "beacons": beacons,
        "ms_a_beacon_update": round(1e3 * spent / seconds / beacons, 2),
        "slowest_update_ms": round(1e3 * slowest, 1),
        "core_share_of_50_beacons": round(50 * spent / seconds / beacons, 3),
    }


def main() -> None:
    """Run all and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--trials", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    report: dict[str, Any] = {
        "environment": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "clarabel": clarabel.__version__,
            "machine": platform.machine(),
        },
        "trials": options.trials,
        "seed": options.seed,
    }
    report["errors"] = errors(options.trials, options.seed)
    report["wls"] = wls_batch(options.seed)
    report["tracker"] = {
        "line of sight": tracker(options.seed, True),
        "obstructed": tracker(options.seed, False),
    }
    try:
        report["lsre_step"] = lsre_step(options.seed)
    except ImportError:
        report["lsre_step"] = "cvxpy is not installed: pip install cvxpy"
    text = json.dumps(report, indent=2, ensure_ascii=False)
    print(text)
    if options.out is not None:
        options.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
