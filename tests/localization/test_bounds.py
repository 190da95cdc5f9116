from __future__ import annotations

import numpy as np
import pytest

from groundstation.localization.bounds import crlb, fisher_information
from groundstation.localization.problem import SignalModel


def numerical(target: np.ndarray, vehicles: np.ndarray, model: SignalModel, known: bool) -> np.ndarray:
    """Fisher information by central differences of the measurement model, power as a fourth unknown."""

    def measured(x: np.ndarray) -> np.ndarray:
        offset = x[:3] - vehicles
        distance = np.linalg.norm(offset, axis=1)
        return np.concatenate(
            [
                (x[3] - 10 * model.los_exponent * np.log10(distance)) / model.rss_std_db,
                np.arctan2(offset[:, 1], offset[:, 0]) / model.azimuth_std_rad,
                np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1])) / model.elevation_std_rad,
            ]
        )

    at = np.append(target, 15.0)
    steps = 1e-4 * np.eye(4)
    jacobian = np.stack([(measured(at + s) - measured(at - s)) / 2e-4 for s in steps], axis=1)
    information = jacobian.T @ jacobian
    return information[:3, :3] if known else np.linalg.inv(np.linalg.inv(information)[:3, :3])


def test_information_is_that_of_the_model() -> None:
    rng = np.random.default_rng(5)
    model = SignalModel()
    for known in (False, True):
        vehicles = rng.uniform(-100, 100, (5, 3)) + np.array([0, 0, 150])
        target = rng.uniform(-20, 20, 3)
        ours = fisher_information(target, vehicles, model, known_transmit_power=known)
        assert np.allclose(ours, numerical(target, vehicles, model, known), rtol=1e-5, atol=1e-9)


def test_published_bound_of_the_ring() -> None:
    """K = 4, R₀ = 100 m, 1°, 5 dB: 1.88 m over uniform targets; knowing the power brings nothing."""
    rng = np.random.default_rng(1)
    turn = np.pi / 2 * np.arange(4)
    ring = np.stack([100 * np.cos(turn), 100 * np.sin(turn), np.full(4, 50.0)], axis=1)
    reach, angle = 100 * np.sqrt(rng.random(4000)), 2 * np.pi * rng.random(4000)
    targets = np.stack([reach * np.cos(angle), reach * np.sin(angle), rng.uniform(1, 20, 4000)], axis=1)
    for known in (False, True):
        bound = crlb(targets, ring, SignalModel(), known_transmit_power=known)
        assert abs(np.sqrt(np.trace(bound, axis1=1, axis2=2).mean()) - 1.88) < 0.02


def test_nothing_measured_is_a_wide_bound() -> None:
    bound = crlb(np.zeros(3), np.array([[10.0, 0, 0]]), SignalModel(), has_angle=np.array([False]))
    assert np.trace(bound) > 1e6


def log_likelihood(
    measured: np.ndarray, target: np.ndarray, vehicles: np.ndarray, model: SignalModel, power: float | None
) -> np.ndarray:
    """Of (T, 3, K) measured powers and angles; without ``power`` its best value is put in (profile)."""
    offset = target - vehicles
    path = 10 * model.los_exponent * np.log10(np.linalg.norm(offset, axis=1))
    emitted = measured[:, 0] + path
    level = emitted.mean(axis=1, keepdims=True) if power is None else power
    azimuth = np.arctan2(offset[:, 1], offset[:, 0])
    elevation = np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1]))
    value: np.ndarray = -0.5 * (
        np.square((emitted - level) / model.rss_std_db).sum(axis=1)
        + np.square((measured[:, 1] - azimuth) / model.azimuth_std_rad).sum(axis=1)
        + np.square((measured[:, 2] - elevation) / model.elevation_std_rad).sum(axis=1)
    )
    return value


@pytest.mark.parametrize("known", [False, True])
def test_information_is_the_scores_covariance(known: bool) -> None:
    """Monte Carlo, 20,000 draws: the slope of the log-likelihood at the truth, by central differences."""
    rng, model = np.random.default_rng(7), SignalModel()
    vehicles = rng.uniform(-60, 60, (4, 3)) + np.array([0, 0, 50])
    target, power = np.array([10.0, -20.0, 4.0]), 15.0
    offset = target - vehicles
    mean = np.stack(
        [
            power - 10 * model.los_exponent * np.log10(np.linalg.norm(offset, axis=1)),
            np.arctan2(offset[:, 1], offset[:, 0]),
            np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1])),
        ]
    )
    std = np.array([model.rss_std_db, model.azimuth_std_rad, model.elevation_std_rad])
    measured = mean + std[:, None] * rng.standard_normal((20000, 3, 4))
    score = np.stack(
        [
            (
                log_likelihood(measured, target + step, vehicles, model, power if known else None)
                - log_likelihood(measured, target - step, vehicles, model, power if known else None)
            )
            / 2e-4
            for step in 1e-4 * np.eye(3)
        ],
        axis=1,
    )
    information = fisher_information(target, vehicles, model, known_transmit_power=known)
    scale = np.sqrt(np.diag(information))
    assert np.abs(score.mean(axis=0) / scale).max() < 0.03
    difference = score.T @ score / 20000 - information
    assert np.abs(difference / np.outer(scale, scale)).max() < 0.05


def test_knowing_the_power_never_widens_the_bound_and_the_height_narrows_it() -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        vehicles = rng.uniform(-100, 100, (3, 3)) + np.array([0, 0, 150])
        target = rng.uniform(-20, 20, 3)
        unknown, known, height = (
            crlb(target, vehicles, SignalModel()),
            crlb(target, vehicles, SignalModel(), known_transmit_power=True),
            crlb(target, vehicles, SignalModel(), height_std_m=2.0),
        )
        assert np.linalg.eigvalsh(unknown - known).min() > -1e-9
        assert np.linalg.eigvalsh(unknown - height).min() > -1e-9
        assert height[2, 2] < min(unknown[2, 2], 4.0)


def test_links_that_are_not_used_change_nothing() -> None:
    rng = np.random.default_rng(9)
    vehicles = rng.uniform(-100, 100, (6, 5, 3)) + np.array([0, 0, 150])
    target = rng.uniform(-20, 20, (6, 3))
    used = np.array([True, True, False, True, False])
    few = fisher_information(target, vehicles[:, used], SignalModel())
    masked = fisher_information(target, vehicles, SignalModel(), used=np.broadcast_to(used, (6, 5)))
    assert np.allclose(few, masked, rtol=1e-10, atol=1e-12)


def test_one_link_of_unknown_power_tells_no_range() -> None:
    """Along the bearing nothing is known; with the power known, the range is to ξσ of itself."""
    vehicle, target, model = np.array([[0.0, 0.0, 100.0]]), np.array([60.0, 0.0, 20.0]), SignalModel()
    along = np.array([0.6, 0.0, -0.8])
    unknown = fisher_information(target, vehicle, model)
    assert abs(along @ unknown @ along) < 1e-12
    known = crlb(target, vehicle, model, known_transmit_power=True)
    ratio = np.log(10.0) / 25.0 * 5.0
    assert np.sqrt(along @ known @ along) == pytest.approx(100.0 * ratio, rel=0.01)


def test_spread_widens_the_bound_under_a_vehicle() -> None:
    """Right under a vehicle the azimuth fixes a line exactly; not so for a place known to a metre."""
    vehicles = np.array([[0.0, 0.0, 50.0], [80.0, 0.0, 50.0], [0.0, 80.0, 50.0]])
    at = np.array([0.01, 0.0, 10.0])
    exact = crlb(at, vehicles, SignalModel())
    spread = crlb(at, vehicles, SignalModel(), spread_m2=np.array(1.0))
    assert exact[1, 1] < 1e-6
    assert np.sqrt(spread[1, 1]) == pytest.approx(np.radians(1.0), rel=0.05)
    assert np.linalg.eigvalsh(spread - exact).min() > -1e-9
