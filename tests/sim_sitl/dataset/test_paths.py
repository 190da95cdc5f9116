"""Both path models: powers, K-factors, delay spreads, movement."""

from __future__ import annotations

import numpy as np
import pytest

from sim_sitl.cir import SPEED_OF_LIGHT_M_S
from sim_sitl.dataset.geometry import FREQUENCY_HZ, LinkGeometry
from sim_sitl.dataset.paths import UMA, Paths, nyusim_paths, scenario_paths


def geometry(line_of_sight: bool, step_m: float = 0.0) -> LinkGeometry:
    position = np.array([[100.0, 0.0, 10.0]]) + np.arange(3)[:, None] * np.array([step_m, 0, 0])
    return LinkGeometry(position, line_of_sight, 15.0, np.full(3, -80.0), 0.0, 0.0, 0.0, 0.0)


def scenario(line_of_sight: bool, count: int = 1500) -> list[Paths]:
    rng = np.random.default_rng(3)
    return [scenario_paths(rng, geometry(line_of_sight), UMA[line_of_sight]) for _ in range(count)]


def test_powers_sum_to_one() -> None:
    rng = np.random.default_rng(1)
    for line_of_sight in (True, False):
        for paths in (
            nyusim_paths(rng, geometry(line_of_sight)),
            scenario_paths(rng, geometry(line_of_sight), UMA[line_of_sight]),
        ):
            np.testing.assert_allclose(np.sum(np.abs(paths.amplitude) ** 2, axis=1), 1.0)
            assert paths.delay_ns.min() == 0
            np.testing.assert_allclose(np.linalg.norm(paths.direction_enu, axis=1), 1.0)


def test_k_factor_and_delay_spread_are_the_tables() -> None:
    def spread_ns(paths: Paths) -> float:
        power = np.abs(paths.amplitude[0]) ** 2
        mean = power @ paths.delay_ns
        return float(np.sqrt(power @ (paths.delay_ns - mean) ** 2))

    los = scenario(True)
    k_db = [10 * np.log10(p / (1 - p)) for p in (abs(paths.amplitude[0, 0]) ** 2 for paths in los)]
    # Standard error 0.11; clusters 25 dB under the direct path are dropped, which widens the upper half.
    assert np.median(k_db) == pytest.approx(9.0, abs=0.5)
    assert 9.0 - np.percentile(k_db, 15.9) == pytest.approx(3.5, abs=0.5)
    nlos = np.log10([spread_ns(paths) * 1e-9 for paths in scenario(False)])
    assert np.median(nlos) == pytest.approx(-6.44, abs=0.1)


@pytest.mark.parametrize("model", ["nyusim", "scenario"])
def test_the_direct_path_turns_with_the_movement(model: str) -> None:
    step_m = 0.05
    moved = geometry(True, step_m)
    rng = np.random.default_rng(5)
    paths = nyusim_paths(rng, moved) if model == "nyusim" else scenario_paths(rng, moved, UMA[True])
    towards = -moved.position_enu_m[0] / np.linalg.norm(moved.position_enu_m[0])
    expected = 2 * np.pi * FREQUENCY_HZ / SPEED_OF_LIGHT_M_S * step_m * towards[0]
    turned = np.angle(paths.amplitude[1, 0] / paths.amplitude[0, 0])
    assert turned == pytest.approx(np.angle(np.exp(1j * expected)), abs=1e-6)


def test_first_path_gain_changes_the_first_arrival_alone() -> None:
    plain, weakened = (
        scenario_paths(np.random.default_rng(7), geometry(False), UMA[False], gain_db)
        for gain_db in (0.0, -10.0)
    )
    ratio = np.abs(weakened.amplitude[0] / plain.amplitude[0]) ** 2
    first = plain.cluster == 0
    assert np.ptp(ratio[first]) < 1e-9
    assert np.ptp(ratio[~first]) < 1e-9
    assert ratio[first][0] / ratio[~first][0] == pytest.approx(0.1)
