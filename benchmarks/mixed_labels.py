"""The mixed environment's methods with a right and with a wrong LOS label, and readings of (76).

Same trials for all: the studies' cases ``mixed-k4`` (one LOS link, labelled so) and ``nlos-k4``
with its first link labelled LOS although it is not, its reported angles drawn uniformly. 3D
RMSE ± standard error, metres; ``taken`` is the share of answers on the LOS ray.

    OMP_NUM_THREADS=1 python benchmarks/mixed_labels.py [--trials 2000] [--seed 1]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from groundstation.localization.batch import Batch
from groundstation.localization.locate import answer_batch
from groundstation.localization.lsre_literal import lsre_socp, lsre_socp_iterative
from groundstation.localization.problem import FloatArray
from groundstation.localization.rays import Rays
from sim_sitl.studies.cases import CASES
from sim_sitl.studies.trials import Trials

METHODS = (
    "lsre-socp", "lsre-socp-iterative", "1aoa-nrss", "projection-3nlos", "angle-reconstruction",
    "projection-label-aware-literal", "projection-label-aware", "posterior",
)  # fmt: skip
FAR_M = 500.0
DOUBT = 0.9


def batch_of(trials: Trials) -> Batch:
    return Batch.of(trials.links, trials.area, trials.model, trials.bias_max_db)


def right_labels(trials: int, seed: int) -> Trials:
    return CASES["mixed-k4"].draw(trials, np.random.default_rng([seed, 0]))


def wrong_labels(trials: int, seed: int) -> Trials:
    drawn = CASES["nlos-k4"].draw(trials, np.random.default_rng([seed, 1]))
    probability = drawn.links.los_probability.copy()
    probability[:, 0] = 1.0
    return replace(drawn, links=replace(drawn.links, los_probability=probability))


def readings(batch: Batch) -> Iterator[tuple[str, FloatArray]]:
    """What else (73)–(76) may be taken to mean."""
    rays = Rays.of(batch)
    first = lsre_socp(batch).position_enu_m
    projected = rays.at(rays.along_m(first))
    yield "(73) once, always projected", projected
    iterated = lsre_socp_iterative(batch).position_enu_m
    yield "(73) and (66)–(70), always projected", rays.at(rays.along_m(iterated))
    within = batch.area.clip(rays.at(rays.along_within_heights_m(first, batch.area)))
    yield "(73) once, always projected, within the heights", within
    exponent = batch.first_exponents()

    def cost(position: FloatArray) -> FloatArray:
        path = 10.0 * exponent * np.log10(batch.distances_m(position))
        return batch.rss_cost_db2(position, (batch.received_dbm() + path).mean(axis=1), exponent)

    kept = cost(projected) <= (1.0 + batch.model.projection_tolerance) * cost(first)
    yield "(76) with β̂ kept, P̂_t refitted at each candidate", np.where(kept[:, None], projected, first)


def line(name: str, batch: Batch, position: FloatArray, truth: FloatArray) -> str:
    error2 = np.square(position - truth).sum(axis=1)
    near = error2 < FAR_M**2
    rays = Rays.of(batch)
    taken = np.linalg.norm(position - rays.at(rays.along_m(position)), axis=1) < 0.01

    def rmse(values: FloatArray) -> str:
        mean = float(values.mean())
        return f"{math.sqrt(mean):6.1f} ± {values.std() / math.sqrt(values.size) / 2 / math.sqrt(mean):4.1f}"

    far = "" if near.all() else f"; without {np.sum(~near)} over {FAR_M:.0f} m {rmse(error2[near])}"
    median = math.sqrt(float(np.median(error2)))
    return f"{name:52s} {rmse(error2)}  median {median:5.1f}  taken {taken.mean():5.1%}{far}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--trials", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    for title, draw in (("right label", right_labels), ("wrong label", wrong_labels)):
        trials = draw(arguments.trials, arguments.seed)
        batch = batch_of(trials)
        print(f"\n{title}: {arguments.trials} trials, seed {arguments.seed}")
        for method in METHODS:
            answers, _ = answer_batch(batch, method)
            print(line(method, batch, answers.position_enu_m, trials.truth_enu_m), flush=True)
        doubt = np.where(trials.links.los_probability > 0.5, DOUBT, 0.0)
        doubted = replace(batch, links=replace(batch.links, los_probability=doubt))
        answers, _ = answer_batch(doubted, "posterior")
        print(line(f"posterior, told P(LOS) = {DOUBT}", batch, answers.position_enu_m, trials.truth_enu_m))
        for name, position in readings(batch):
            print(line(name, batch, position, trials.truth_enu_m))


if __name__ == "__main__":
    main()
