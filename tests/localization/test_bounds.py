from __future__ import annotations

import numpy as np

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
