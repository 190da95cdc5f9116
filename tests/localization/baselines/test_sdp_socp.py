from __future__ import annotations

import cvxpy as cp
import numpy as np

from groundstation.localization import Links, SearchArea, SignalModel, locate, locate_batch
from groundstation.localization.baselines.ranges import Ranges
from groundstation.localization.baselines.sdp_socp import sdp_socp
from groundstation.localization.batch import Batch


def full_program(links: Links, model: SignalModel) -> tuple[np.ndarray, float]:
    """The semidefinite program as the literature writes it, nothing reduced."""
    a, p = links.position_enu_m, links.rss_dbm
    az, el = links.azimuth_rad, links.elevation_rad
    gain = 10 ** (p / (10 * model.los_exponent))
    level = 10 ** (model.first_transmit_power_dbm / (10 * model.los_exponent))
    reach = level / gain
    weight = 1.0 - reach / reach.sum()
    c = np.stack([-np.sin(az), np.cos(az), 0 * az], axis=1)
    k = np.stack([np.sin(el) * np.cos(az), np.sin(el) * np.sin(az), -np.cos(el)], axis=1)
    # In units of the mean reach: a conic solver's tolerances are absolute.
    unit = reach.mean()
    a, gain = a / unit, gain * unit
    lifted = cp.Variable((4, 4), symmetric=True)
    x, range_ = lifted[:3, 3], cp.Variable(len(p))
    terms, rules = [], [lifted >> 0, lifted[3, 3] == 1]
    for i in range(len(p)):
        gap = x - a[i]
        terms.append(weight[i] * cp.square(gain[i] * range_[i] / level - 1.0))
        across = cp.square(c[i] @ gap) + cp.square(k[i] @ gap)
        terms.append(weight[i] * (unit / reach[i]) ** 2 * across)
        square = cp.trace(lifted[:3, :3]) - 2 * a[i] @ x + a[i] @ a[i]
        rules += [cp.norm(gap) <= range_[i], cp.square(range_[i]) <= square]
    problem = cp.Problem(cp.Minimize(cp.sum(cp.hstack(terms))), rules)
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    return np.asarray(lifted.value)[:3, 3] * unit, float(problem.value)


def reduced_cost(batch: Batch, at: np.ndarray) -> np.ndarray:
    """Σ w [(d/r̂ − 1)₊² + angle terms / r̂²], written out once more."""
    ranges = Ranges.of(batch)
    reach = ranges.level(batch, batch.first_power_dbm())[:, None] / ranges.gain
    gap = at[:, None] - batch.place
    across = np.square(np.einsum("nski,nki->nsk", ranges.across, gap)).sum(axis=1)
    over = np.maximum(np.linalg.norm(gap, axis=2) / reach - 1.0, 0.0)
    result: np.ndarray = (ranges.weight * (over**2 + across / reach**2)).sum(axis=1)
    return result


def test_equals_the_full_semidefinite_program(draw) -> None:
    """The reduction of the module's header, by its answer and by its value."""
    for seed, labels in ((31, (1, 1, 1, 1)), (32, (1, 1)), (33, (1,) * 7)):
        drawn = draw(2, labels, seed)
        batch = Batch.of(drawn.links, drawn.area, SignalModel())
        ours = sdp_socp(batch)
        assert set(ours.status) == {"ok"}
        cost = reduced_cost(batch, ours.position_enu_m)
        for row in range(2):
            place, value = full_program(drawn.links.problem(row), SignalModel())
            # Both value and place, because a flat optimum would hide a wrong place.
            assert abs(cost[row] - value) < 1e-8 * (1.0 + value)
            assert np.linalg.norm(ours.position_enu_m[row] - place) < 0.01


def test_is_a_minimum(draw) -> None:
    """Convex: no step from the answer lowers the objective."""
    drawn = draw(200, (1, 1, 1), 34)
    batch = Batch.of(drawn.links, drawn.area, SignalModel())
    answer = sdp_socp(batch).position_enu_m
    best = reduced_cost(batch, answer)
    rng = np.random.default_rng(5)
    for size in (1e-2, 1.0, 30.0):
        for _ in range(20):
            assert (reduced_cost(batch, answer + size * rng.standard_normal(answer.shape)) >= best).all()


def test_the_true_power_without_noise_is_exact(draw) -> None:
    drawn = draw(30, (1, 1, 1, 1), 35, rss_std_db=0.0, angle_std_deg=0.0)
    gap = np.linalg.norm(drawn.truth_enu_m[:, None] - drawn.links.position_enu_m, axis=2)
    power = (drawn.links.rss_dbm + 25.0 * np.log10(gap)).mean(axis=1)
    for row in range(30):
        model = SignalModel(known_transmit_power_dbm=float(power[row]))
        found = locate(drawn.links.problem(row), drawn.area, "sdp-socp", model, covariance=False)
        assert np.allclose(found.position_enu_m, drawn.truth_enu_m[row], atol=1e-4)


def test_only_los_links_with_angles_count(draw) -> None:
    drawn = draw(10, (1, 0, 1, 1), 36)
    whole = locate_batch(drawn.links, drawn.area, "sdp-socp", covariance=False)
    for row, estimate in enumerate(whole):
        alone = locate(drawn.links.problem(row).subset([0, 2, 3]), drawn.area, "sdp-socp", covariance=False)
        assert np.allclose(alone.position_enu_m, estimate.position_enu_m, atol=1e-6)


def test_parallel_bearings_stay_by_what_range_says() -> None:
    """Two vehicles and the beacon in one line: no crossing, but a power each."""
    place = np.array([[-100.0, 0.0, 10.0], [-60.0, 0.0, 10.0]])
    rss = 15.0 - 25.0 * np.log10([100.0, 60.0])
    links = Links(place, rss, np.zeros(2), np.zeros(2), np.ones(2))
    area = SearchArea(np.zeros(2), 100.0, 1.0, 20.0)
    found = locate(links, area, "sdp-socp", covariance=False)
    assert np.allclose(found.position_enu_m, [0.0, 0.0, 10.0], atol=1e-6)
