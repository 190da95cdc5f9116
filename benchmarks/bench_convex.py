"""The convex programs of LSRE and of its baselines: our solvers beside CVXPY + Clarabel, same run.

Claims: a solve in a batch is 50 times cheaper than the program in CVXPY as most people write it (built
anew for each solve) and 3 times cheaper than its fast form (parametrised, built once, DPP). A single
solve stands beside them. CVXPY solves with Clarabel, tolerance 1e-9 on both sides; answers are compared
by objective. Times are CPU time, least of the repeats. Over 400 lines: each of five programs stands here
in our form and in CVXPY's, so that one can be read beside the other.

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
from reporting import environment, give

from groundstation.localization import Links, SearchArea, SignalModel
from groundstation.localization.baselines.lifting import lifted_constraints
from groundstation.localization.baselines.lsre_sdp import lsre_sdp_positions, lsre_sdp_program
from groundstation.localization.baselines.rwls_sdp import rwls_sdp_positions, rwls_sdp_program
from groundstation.localization.baselines.sdp_socp import sdp_socp
from groundstation.localization.batch import Batch
from groundstation.localization.interior import minimise
from groundstation.localization.lsre_literal import literal_positions
from groundstation.localization.lsre_sound import convex_concave_step, majoriser
from groundstation.localization.lsre_terms import log_end_weights, log_gains
from groundstation.localization.region import Region

MODEL = SignalModel()
AREA = SearchArea(np.zeros(2), 100.0, 1.0, 20.0)
LINKS = 4
BATCH_SIZES = (1, 3, 10, 30, 100, 300)
"""A single solve is the cost of calls into NumPy; the curve shows from which batch on it is not."""
TOLERANCE = {"tol_gap_abs": 1e-9, "tol_gap_rel": 1e-9, "tol_feas": 1e-9}


def draw(count: int, seed: int) -> Batch:
    """V-C, NLOS by eq. (8): R₀ = 100 m, one β ~ U(2, 3.5) a trial, b_k ~ U(0, 7), b_max ~ U(6, 8) dB."""
    rng = np.random.default_rng(seed)
    turn = 2.0 * math.pi * np.arange(LINKS) / LINKS
    place = np.stack([100.0 * np.cos(turn), 100.0 * np.sin(turn), np.full(LINKS, 50.0)], axis=-1)
    reach, angle = 100.0 * np.sqrt(rng.random(count)), 2.0 * math.pi * rng.random(count)
    truth = np.stack([reach * np.cos(angle), reach * np.sin(angle), rng.uniform(1.0, 20.0, count)], axis=-1)
    shape = (count, LINKS)
    rss = (
        rng.uniform(13.0, 18.0, (count, 1)) + 5.0 * rng.standard_normal(shape) - rng.uniform(0.0, 7.0, shape)
    )
    rss -= (
        10.0 * rng.uniform(2.0, 3.5, (count, 1)) * np.log10(np.linalg.norm(truth[:, None] - place, axis=-1))
    )
    nothing = np.full(shape, np.nan)
    links = Links(np.broadcast_to(place, (*shape, 3)).copy(), rss, nothing, nothing, np.zeros(shape))
    return Batch.of(links, AREA, MODEL, rng.uniform(6.0, 8.0, count))


@dataclass(frozen=True)
class Numbers:
    """What one problem's program is made of, lengths in area radii."""

    place: Any
    gain: Any
    """(K,) m_k/m_t."""
    low: Any
    """(K,) e̲_k."""
    weight: Any
    """(K,) g_k."""
    distance_weight: Any
    """(K,) w_k of RWLS."""
    start: Any
    """(3,) where the convex–concave step is taken."""

    @property
    def tangent(self) -> Any:
        """(K, 3) unit vectors from the vehicles to the start."""
        offset = self.start - self.place
        return offset / np.linalg.norm(offset, axis=1, keepdims=True)


def numbers(batch: Batch, region: Region, start_m: Any) -> list[Numbers]:
    """One for each problem."""
    power, exponent = batch.first_power_dbm(), batch.first_exponents()
    gain = np.exp(log_gains(batch, power, exponent)) * region.scale_m
    weight = np.exp(log_end_weights(batch, exponent))
    low = 10.0 ** (-batch.bias_max_db[:, None] / (20.0 * exponent))
    told = (1.0 / gain) / (1.0 / gain).sum(axis=1, keepdims=True)
    place, start = region.scaled(batch.place), region.scaled(start_m)
    return [Numbers(place[i], gain[i], low[i], weight[i], 1.0 - told[i], start[i]) for i in range(batch.size)]


class Peer:
    """A program in CVXPY whose data are filled in by ``fill``: parameters, or constants of one problem."""

    def __init__(self, cp: Any, name: str, region: Region, one: Numbers | None) -> None:
        self.cp = cp
        self.data: dict[str, tuple[Any, Callable[[Numbers], Any]]] = {}
        self.extra: list[Any] = []
        self.one, self.region = one, region
        self.x, objective, constraints = getattr(self, name)()
        self.problem = cp.Problem(cp.Minimize(objective), constraints)

    def value(self, name: str, compute: Callable[[Numbers], Any], shape: Any, nonneg: bool = False) -> Any:
        """A constant in the program written for one problem, a parameter in the parametrised one."""
        if self.one is not None:
            return compute(self.one)
        parameter = self.cp.Parameter(shape, nonneg=nonneg)
        self.data[name] = (parameter, compute)
        return parameter

    def solve(self, one: Numbers) -> Any:
        """The place (3,), scaled."""
        for parameter, compute in self.data.values():
            parameter.value = compute(one)
        self.problem.solve(solver=self.cp.CLARABEL, **TOLERANCE)
        return self.x.value

    def inside(self, x: Any) -> list[Any]:
        """Heights and disc."""
        return [self.cp.norm(x[:2]) <= 1.0, x[2] <= self.region.half_height, x[2] >= -self.region.half_height]

    def lsre_socp(self) -> Any:
        """(64) as printed, ζ = 1/m_t."""
        cp, ends = self.cp, 2 * LINKS
        x, s, y, tau1, tau2 = cp.Variable(3), *(cp.Variable(ends) for _ in range(4))
        m = self.value("m", lambda one: np.concatenate([one.gain * one.low, one.gain / one.low]), ends, True)
        place = self.value("place", lambda one: np.tile(one.place, (2, 1)), (ends, 3))
        relative = cp.multiply(m, s)

        def rotated(a: Any, b: Any, c: Any) -> Any:
            return cp.SOC(a + b, cp.vstack([a - b, math.sqrt(2.0) * c]), axis=0)

        one, half = np.ones(ends), np.full(ends, 0.5)
        constraints = [
            rotated(tau1, y, math.sqrt(2.0) * one),
            rotated(y, half, relative),
            rotated(tau2, half, relative),
            cp.norm(place - cp.vstack([x] * ends), axis=1) <= s,
        ]
        return x, cp.sum(tau1 + tau2), constraints + self.inside(x)

    def lsre_ccp(self) -> Any:
        """The convex program of one convex–concave step."""
        cp = self.cp
        x, t, far = cp.Variable(3), cp.Variable(LINKS), cp.Variable(LINKS)
        slope = self.value("slope", lambda one: one.gain[:, None] * one.tangent, (LINKS, 3))
        shift = self.value("shift", lambda one: one.gain * (one.tangent * one.place).sum(axis=1), LINKS)
        gain = self.value("gain", lambda one: one.gain, LINKS, True)
        away = self.value("away", lambda one: one.gain[:, None] * one.place, (LINKS, 3))
        weight = self.value("weight", lambda one: one.weight, LINKS, True)
        columns = cp.vstack([gain * x[axis] for axis in range(3)]).T
        constraints = [t >= cp.inv_pos(slope @ x - shift), cp.norm(columns - away, axis=1) <= far]
        return x, weight @ cp.square(t) + weight @ cp.square(far), constraints + self.inside(x)

    def _lifted(self) -> tuple[Any, Any]:
        cp = self.cp
        z = cp.Variable((4, 4), PSD=True)
        square = self.value("square", lambda one: one.gain**2, LINKS, True)
        cross = self.value("cross", lambda one: 2.0 * one.gain[:, None] ** 2 * one.place, (LINKS, 3))
        rest = self.value("rest", lambda one: one.gain**2 * np.square(one.place).sum(axis=1), LINKS, True)
        return z, square * (z[0, 0] + z[1, 1] + z[2, 2]) - cross @ z[:3, 3] + rest

    def lsre_sdp(self) -> Any:
        """(62) with Z₄₄ = 1/m_t²; the two ends of a link taken together, as we do."""
        cp = self.cp
        z, q = self._lifted()
        weight = self.value("weight", lambda one: one.weight, LINKS, True)
        return z[:3, 3], weight @ cp.inv_pos(q) + weight @ q if self.one is not None else self._split(z, q), [
            z[3, 3] == 1.0, *self.inside(z[:3, 3]), *self.extra
        ]  # fmt: skip

    def _split(self, z: Any, q: Any) -> Any:
        # A parameter times a parameter is not DPP: the relative square gets a variable of its own.
        cp = self.cp
        relative = cp.Variable(LINKS)
        self.extra = [relative == q]
        weight = self.data["weight"][0]
        return weight @ cp.inv_pos(relative) + weight @ relative

    def rwls_sdp(self) -> Any:
        """min Σ w_k τ_k, (e² q_k − 1)² ≤ τ_k at both ends."""
        cp = self.cp
        z, q = self._lifted()
        relative, tau = cp.Variable(LINKS), cp.Variable(LINKS)
        weight = self.value("weight", lambda one: one.distance_weight, LINKS, True)
        small = self.value("small", lambda one: one.low**2, LINKS, True)
        large = self.value("large", lambda one: one.low**-2, LINKS, True)
        constraints = [z[3, 3] == 1.0, relative == q, *self.inside(z[:3, 3])]
        constraints += [cp.square(cp.multiply(e, relative) - 1.0) <= tau for e in (small, large)]
        return z[:3, 3], weight @ tau, constraints


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


def draw_los(count: int, seed: int) -> Batch:
    """V-C, LOS: β = 2.5, shadowing 5 dB, angles 1°."""
    batch = draw(count, seed)
    rng = np.random.default_rng(seed + 100)
    truth = np.column_stack([rng.uniform(-70.0, 70.0, (count, 2)), rng.uniform(1.0, 20.0, count)])
    offset = truth[:, None] - batch.place
    shape = offset.shape[:2]
    rss = rng.uniform(13.0, 18.0, (count, 1)) - 25.0 * np.log10(np.linalg.norm(offset, axis=-1))
    noise = math.radians(1.0) * rng.standard_normal((2, *shape))
    azimuth = np.arctan2(offset[..., 1], offset[..., 0]) + noise[0]
    elevation = np.arctan2(offset[..., 2], np.hypot(offset[..., 0], offset[..., 1])) + noise[1]
    rss += 5.0 * rng.standard_normal(shape)
    return Batch.of(Links(batch.place, rss, azimuth, elevation, np.ones(shape)), AREA, MODEL)


def range_data(batch: Batch) -> dict[str, Any]:
    """What the SDP/SOCP hybrid of the one problem of ``batch`` is made of, lengths in area radii."""
    place, told = batch.place[0] / AREA.radius_m, 10.0 ** ((15.0 - batch.received_dbm()[0]) / 25.0)
    told = told / AREA.radius_m
    root = np.sqrt(1.0 - told / told.sum())
    theta, phi = batch.links.azimuth_rad[0], batch.links.elevation_rad[0]
    across = np.stack([-np.sin(theta), np.cos(theta), 0.0 * theta], axis=1)
    upward = np.stack([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), -np.cos(phi)], axis=1)
    rows = np.concatenate([across, upward]) * np.tile(root / told, 2)[:, None]
    right = (rows * np.tile(place, (2, 1))).sum(axis=1)
    square = np.square(place).sum(axis=1)
    return {
        "root": root, "inverse": root / told, "rows": rows, "right": right, "place": place, "square": square,
    }  # fmt: skip


def reduced(data: dict[str, Any], position_m: Any) -> float:
    """The hybrid's objective at a place (3,) with the best r_k."""
    at = position_m / AREA.radius_m
    gap = np.linalg.norm(at - data["place"], axis=1)
    excess = np.maximum(data["inverse"] * gap - data["root"], 0.0)
    return float(np.square(excess).sum() + np.square(data["rows"] @ at - data["right"]).sum())


class RangePeer:
    """The SDP/SOCP hybrid in CVXPY: with the constants of one problem, or parametrised."""

    def __init__(self, cp: Any, constants: dict[str, Any] | None) -> None:
        self.cp = cp
        shapes = {"root": LINKS, "inverse": LINKS, "rows": (2 * LINKS, 3), "right": 2 * LINKS}
        shapes |= {"place": (LINKS, 3), "square": LINKS}
        signed = {"rows", "right", "place"}
        self.data = {name: cp.Parameter(shape, nonneg=name not in signed) for name, shape in shapes.items()}
        data = self.data if constants is None else constants
        z, reach = cp.Variable((4, 4), PSD=True), cp.Variable(LINKS)
        self.x = x = z[:3, 3]
        lifted = z[0, 0] + z[1, 1] + z[2, 2] - 2.0 * data["place"] @ x + data["square"]
        rules = [z[3, 3] == 1.0, cp.square(reach) <= lifted]
        rules += [cp.norm(x - data["place"][k]) <= reach[k] for k in range(LINKS)]
        fit = cp.multiply(data["inverse"], reach) - data["root"]
        cost = cp.sum_squares(fit) + cp.sum_squares(data["rows"] @ x - data["right"])
        self.problem = cp.Problem(cp.Minimize(cost), rules)

    def solve(self, data: dict[str, Any]) -> tuple[float, Any]:
        """Optimum and place (3,), metres."""
        for name, parameter in self.data.items():
            parameter.value = data[name]
        self.problem.solve(solver=self.cp.CLARABEL, **TOLERANCE)
        return float(self.problem.value), AREA.radius_m * np.asarray(self.x.value)


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
