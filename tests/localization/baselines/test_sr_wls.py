from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from groundstation.localization import Links, SearchArea, SignalModel, locate, locate_batch
from groundstation.localization.baselines.sr_wls import constrained

SQUARE = np.diag([1.0, 1.0, 1.0, 0.0])
LINEAR = np.array([0.0, 0.0, 0.0, -0.5])


def systems(size: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((size, 9, 4)), 3.0 * rng.standard_normal((size, 9))


def test_meets_the_conditions_of_a_global_minimum() -> None:
    """Feasible; stationary for one multiplier; the Hessian of the Lagrangian positive semidefinite."""
    matrix, right = systems(300, 1)
    y = constrained(matrix, right)
    assert np.abs((y[:, :3] ** 2).sum(axis=1) - y[:, 3]).max() < 1e-8
    for row in range(300):
        a, b = matrix[row], right[row]
        slope = a.T @ (a @ y[row] - b)
        toward = SQUARE @ y[row] + LINEAR
        multiplier = -(slope @ toward) / (toward @ toward)
        assert np.abs(slope + multiplier * toward).max() < 1e-6 * (1.0 + np.abs(slope).max())
        assert np.linalg.eigvalsh(a.T @ a + multiplier * SQUARE)[0] > -1e-9


def test_no_local_search_finds_less() -> None:
    """Against BFGS from many starts in x, with ‖x‖² put in for y₄."""
    matrix, right = systems(8, 2)
    found = constrained(matrix, right)
    rng = np.random.default_rng(3)
    for row in range(8):

        def cost(x: np.ndarray, row: int = row) -> float:
            y = np.append(x, x @ x)
            return float(np.square(matrix[row] @ y - right[row]).sum())

        best = min(minimize(cost, start, method="BFGS").fun for start in 2.0 * rng.standard_normal((6, 3)))
        assert cost(found[row, :3]) <= best + 1e-7 * (1.0 + best)


def test_hard_case_is_met() -> None:
    """Symmetric data: the multiplier sits at the end of its interval and two answers mirror one another."""
    matrix = np.zeros((1, 4, 4))
    matrix[0, 0, 0], matrix[0, 1, 1], matrix[0, 2, 2], matrix[0, 3, 3] = 0.1, 1.0, 1.0, 1.0
    right = np.array([[0.0, 0.0, 0.0, 9.0]])
    y = constrained(matrix, right)[0]
    assert y[0] ** 2 + y[1] ** 2 + y[2] ** 2 == pytest.approx(y[3])
    x = np.linspace(0.0, 4.0, 100001)
    assert np.square(matrix[0] @ y - right[0]).sum() <= ((0.1 * x) ** 2 + (x**2 - 9.0) ** 2).min() + 1e-6


def test_exact_without_noise(draw) -> None:
    """Unknown power, K = 2 to 7: the truth."""
    for labels in ((1, 1), (1, 1, 1, 1), (1,) * 7):
        drawn = draw(40, labels, 41, rss_std_db=0.0, angle_std_deg=0.0)
        found = locate_batch(drawn.links, drawn.area, "sr-wls", covariance=False)
        error = np.array([e.position_enu_m for e in found]) - drawn.truth_enu_m
        assert np.abs(error).max() < 1e-4


def test_criterion_of_the_last_solve_is_least(draw) -> None:
    """The whole method's last criterion, written out in x and P̂_t, has no smaller value nearby or afar."""
    drawn = draw(4, (1, 1, 1, 1), 42)
    found = locate_batch(drawn.links, drawn.area, "sr-wls", covariance=False)
    rng = np.random.default_rng(4)
    for row, estimate in enumerate(found):
        links = drawn.links.problem(row)
        a, az, el = links.position_enu_m, links.azimuth_rad, links.elevation_rad
        gap = np.linalg.norm(estimate.position_enu_m - a, axis=1)
        level = 10 ** (estimate.transmit_power_dbm / 25.0)
        gain = 10 ** (links.rss_dbm / 25.0)
        weight = 1.0 - (1.0 / gain) / (1.0 / gain).sum()
        c = np.stack([-np.sin(az), np.cos(az), 0 * az], axis=1)
        k = np.stack([np.sin(el) * np.cos(az), np.sin(el) * np.sin(az), -np.cos(el)], axis=1)

        def cost(x: np.ndarray, a=a, c=c, k=k, gain=gain, weight=weight, level=level) -> float:
            gap = x - a
            ranges = (gain**2 * (gap**2).sum(axis=1) - level**2) ** 2
            return float((weight * (ranges + (c * gap).sum(axis=1) ** 2 + (k * gap).sum(axis=1) ** 2)).sum())

        assert np.isfinite(gap).all()
        ours = cost(estimate.position_enu_m)
        starts = estimate.position_enu_m + 60.0 * rng.standard_normal((4, 3))
        best = min(minimize(cost, start, method="BFGS").fun for start in starts)
        assert ours <= best * (1.0 + 1e-6)


def test_equal_powers_leave_the_level_to_the_constraint() -> None:
    """λ equal on all links: ‖x‖² and η² cannot be told apart by the rows alone."""
    turn = np.pi / 2 * np.arange(4)
    place = np.stack([100 * np.cos(turn), 100 * np.sin(turn), np.full(4, 50.0)], axis=1)
    truth = np.array([0.0, 0.0, 10.0])
    gap = truth - place
    azimuth = np.arctan2(gap[:, 1], gap[:, 0])
    elevation = np.arctan2(gap[:, 2], np.hypot(gap[:, 0], gap[:, 1]))
    links = Links(place, np.full(4, -36.0), azimuth, elevation, np.ones(4))
    area = SearchArea(np.zeros(2), 100.0, 1.0, 20.0)
    found = locate(links, area, "sr-wls", covariance=False)
    assert np.allclose(found.position_enu_m, truth, atol=1e-3)


def test_a_known_power_is_used(draw) -> None:
    drawn = draw(5, (1, 1, 1), 43)
    model = SignalModel(known_transmit_power_dbm=15.5)
    found = locate_batch(drawn.links, drawn.area, "sr-wls", model, covariance=False)
    assert {e.transmit_power_dbm for e in found} == {15.5}
    assert {e.iterations for e in found} == {1}
