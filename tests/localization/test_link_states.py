from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from groundstation.localization.bearings import angle_log_likelihood
from groundstation.localization.likelihood import ANYWHERE, ExponentGrid
from groundstation.localization.link_states import MAXIMUM_DOUBTFUL, LinkStates, doubtful_links
from groundstation.localization.problem import Links, SignalModel
from groundstation.localization.regression import Evidence
from groundstation.localization.whitening import Observations, whiten

MODEL = SignalModel(
    receiver_offset_std_db=1.5,
    los_exponent_std=0.2,
    angle_outlier_probability=0.03,
    rss_outlier_probability=0.0,
)
GRID = ExponentGrid.of(MODEL, 5)


def snapshot(p: list[float], seed: int, bearings: bool = True) -> Links:
    rng = np.random.default_rng(seed)
    count = len(p)
    turn = 2.0 * math.pi * rng.random(count)
    place = np.stack([90 * np.cos(turn), 90 * np.sin(turn), np.full(count, 50.0)], axis=1)
    angle = np.full(count, 1.0 if bearings else np.nan)
    return Links(
        place,
        rng.uniform(-45, -30, count),
        angle * (turn + math.pi + rng.normal(0, 0.1, count)),
        angle * rng.uniform(-0.7, -0.3, count),
        np.array(p),
    )


def boxes(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform([-80, -80, 0], [80, 80, 20], (count, 3)), rng.uniform(0.1, 8.0, (count, 2))


def tracker_log_likelihood(
    links: Links,
    p: np.ndarray,
    center: np.ndarray,
    half: np.ndarray,
    model: SignalModel,
    white_variance_db2: np.ndarray | None = None,
) -> np.ndarray:
    """What the tracker's regression says of the same links at states ``p``, one window a vehicle."""
    count = links.count
    seen = Observations(
        links.position_enu_m, np.arange(count), links.rss_dbm, p,
        np.zeros(count) if white_variance_db2 is None else white_variance_db2,
        links.azimuth_rad, links.elevation_rad,
        np.tile([model.azimuth_std_rad, model.elevation_std_rad], (count, 1)),
        p, np.ones(count), np.full((count, 1), -1), np.tile(model.vehicle_variance_m2, (count, 1)),
    )  # fmt: skip
    evidence = Evidence.empty(len(center), count)
    rows = whiten(seen, 0, count, 25.0, model)
    evidence.add(seen, rows, center)
    evidence.angle_log += angle_log_likelihood(seen, 0, center, half, model)
    scale = np.log(rows.scale).sum() + 0.5 * np.linalg.slogdet(evidence.loading_loading)[1]
    return evidence.log_likelihood_on_grid(GRID) - scale


def ours(links: Links, center: np.ndarray, half: np.ndarray, model: SignalModel = MODEL) -> np.ndarray:
    many = links.as_batch()
    bias = np.array([model.nlos_bias_max_db])
    states = LinkStates.of(many, model, bias, doubtful_links(many)[0], GRID)
    return states.log_likelihood(np.zeros(len(center), dtype=int), center, half)[0]


@pytest.mark.parametrize("off_m", [0.0, 3.0])
@pytest.mark.parametrize("p", [[1.0, 1.0, 0.0], [0.0] * 5, [1.0] * 4, [0.0]])
def test_certain_links_weigh_as_in_the_tracker(p: list[float], off_m: float) -> None:
    """The snapshot is the tracker's first update: one likelihood, to the tracker's single precision."""
    links = snapshot(p, 3)
    center, half = boxes(30, 4)
    model = replace(MODEL, vehicle_position_std_m=off_m, vehicle_height_std_m=2.0 * off_m)
    there = tracker_log_likelihood(links, links.los_probability, center, half, model)
    here = ours(links, center, half, model)
    assert np.allclose(here - here[0], there - there[0], atol=1e-4)


@pytest.mark.parametrize("p", [[1.0, 0.0, 0.0], [0.0] * 4])
def test_one_power_may_be_an_outlier(p: list[float]) -> None:
    """None, or each link's in turn with 20 dB more of spread: the tracker's likelihood of each, summed."""
    share = 0.04
    model = replace(MODEL, rss_outlier_probability=share, rss_outlier_std_db=20.0)
    links = snapshot(p, 3)
    center, half = boxes(30, 4)
    terms = [
        math.log1p(-share) * (links.count - found.any())
        + (math.log(share) if found.any() else 0.0)
        + tracker_log_likelihood(links, links.los_probability, center, half, MODEL, 400.0 * found)
        for found in (np.zeros(links.count), *np.eye(links.count))
    ]
    there = np.logaddexp.reduce(terms, axis=0)
    here = ours(links, center, half, model)
    assert np.allclose(here - here[0], there - there[0], atol=1e-4)


def test_doubtful_links_are_the_trackers_likelihood_summed_over_states() -> None:
    """Σ_s P(s) of the tracker's likelihood at certain states s, to 1e-4.

    A bearing of an NLOS link points anywhere, which the tracker leaves out as a constant.
    """
    links = snapshot([0.7, 0.2, 1.0, 0.05], 8)
    center, half = boxes(30, 5)
    p = links.los_probability
    terms = [
        np.log(np.where(np.array(state) == 1.0, p, (1.0 - p) * ANYWHERE)).sum()
        + tracker_log_likelihood(links, np.array(state), center, half, MODEL)
        for state in product([0.0, 1.0], [0.0, 1.0], [1.0], [0.0, 1.0])
    ]
    there = np.logaddexp.reduce(terms, axis=0)
    here = ours(links, center, half)
    assert np.allclose(here - here[0], there - there[0], atol=1e-4)


def test_a_share_of_line_of_sight_is_a_common_prior() -> None:
    """With several equally likely shares π: the mean over π of the sums at that π."""
    model = replace(MODEL, los_shares=(0.1, 0.6))
    links = snapshot([0.7, 0.2, 0.4], 9)
    center, half = boxes(10, 5)
    terms = []
    for share in model.los_shares:
        odds = links.los_probability / (1 - links.los_probability) * share / (1 - share)
        p = odds / (1 + odds)
        weight = 2 * (share * links.los_probability + (1 - share) * (1 - links.los_probability))
        here = Links(links.position_enu_m, links.rss_dbm, links.azimuth_rad, links.elevation_rad, p)
        terms.append(np.log(weight).sum() + ours(here, center, half))
    there = np.logaddexp.reduce(terms, axis=0)
    here = ours(links, center, half, model)
    assert np.allclose(here - here[0], there - there[0], atol=1e-4)


def test_many_doubtful_links_cost_a_bounded_sum() -> None:
    links = snapshot(list(np.linspace(0.05, 0.95, 50)), 2)
    doubtful = doubtful_links(links.as_batch())
    assert doubtful.sum() == MAXIMUM_DOUBTFUL
    center, half = boxes(5, 1)
    assert np.isfinite(ours(links, center, half)).all()
    certain = snapshot([0.0, 1.0, 1e-6, 1.0 - 1e-6], 2)
    assert not doubtful_links(certain.as_batch()).any()


def test_many_problems_side_by_side_are_each_their_own() -> None:
    """Boxes of three problems mixed up: each weighs as alone."""
    singles = [snapshot([0.6, 0.3, 0.9], seed) for seed in (1, 2, 3)]
    together = Links(
        *(np.stack([getattr(one, name) for one in singles]) for name in Links.__dataclass_fields__)
    )
    bias = np.array([6.0, 7.0, 8.0])
    states = LinkStates.of(together, MODEL, bias, np.ones(3, dtype=bool), GRID)
    center, half = boxes(12, 7)
    problem = np.arange(12) % 3
    mixed, _ = states.log_likelihood(problem, center, half)
    for row in range(3):
        mine = problem == row
        alone, _ = states.problem(row).log_likelihood(np.zeros(4, dtype=int), center[mine], half[mine])
        assert np.allclose(mixed[mine], alone, atol=1e-10)
        by_state, _ = states.problem(row).by_combination(np.zeros(4, dtype=int), center[mine], half[mine])
        assert np.allclose(np.logaddexp.reduce(by_state, axis=0), alone, atol=1e-10)


def test_nuisances_are_those_of_clean_links() -> None:
    """Without noise: the transmit power, the exponents and the states that made the powers."""
    model = SignalModel(
        rss_std_db=0.1, nlos_rss_std_db=0.1, nlos_bias_max_db=0.1, transmit_power_min_dbm=0.0,
        transmit_power_max_dbm=40.0,
    )  # fmt: skip
    truth = np.array([12.0, -7.0, 4.0])
    place = np.array([[90.0, 0, 50], [0, 80, 60], [-70, 0, 40], [0, -85, 50], [40, 50, 30]])
    state = np.array([1.0, 0.0, 1.0, 0.0, 1.0])
    distance = np.linalg.norm(place - truth, axis=1)
    rss = 21.0 - 10.0 * np.where(state == 1.0, 2.5, 3.2) * np.log10(distance) - 0.05 * (1 - state)
    none = np.full(5, np.nan)
    links = Links(place, rss, none, none, np.full(5, 0.5)).as_batch()
    grid = ExponentGrid.of(model, 151)
    states = LinkStates.of(links, model, np.array([0.1]), np.ones(5, dtype=bool), grid)
    power, exponent, los = states.nuisances(np.zeros(1, dtype=int), truth[None])
    assert abs(power[0] - 21.0) < 0.3
    assert np.allclose(los[0], state, atol=0.02)
    assert np.allclose(exponent[0], np.where(state == 1.0, 2.5, 3.2), atol=0.03)
