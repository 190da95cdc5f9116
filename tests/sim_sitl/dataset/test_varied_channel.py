"""Varied channels keep what every model has, and nothing of the receiver tells the label."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_sitl.dataset.varied_channel import VariedPaths, capture, draw_paths, draw_receiver


def test_paths_are_ordered_and_of_unit_power_on_average() -> None:
    rng = np.random.default_rng(0)
    for line_of_sight in (True, False):
        drawn = [draw_paths(rng, line_of_sight=line_of_sight) for _ in range(400)]
        for paths in drawn:
            assert paths.delay_ns[0] == 0
            assert np.all(np.diff(paths.delay_ns) >= 0)
            assert (paths.direct_share > 0) == line_of_sight
        power = np.mean([np.sum(np.abs(paths.amplitude) ** 2) for paths in drawn])
        # Without a line of sight early paths may be absorbed.
        assert power == pytest.approx(1.0, abs=0.1) if line_of_sight else 0.7 < power < 1.05


def test_an_obstruction_spreads_the_energy() -> None:
    rng = np.random.default_rng(1)

    def spread(paths: VariedPaths) -> float:
        power = np.abs(paths.amplitude) ** 2
        mean = power @ paths.delay_ns / power.sum()
        return float(np.sqrt(power @ (paths.delay_ns - mean) ** 2 / power.sum()))

    seen = {
        state: np.median([spread(draw_paths(rng, line_of_sight=state)) for _ in range(400)])
        for state in (True, False)
    }
    assert seen[False] > 2 * seen[True]


def test_a_capture_is_what_its_paths_say() -> None:
    paths = VariedPaths(np.array([0.0, 30.0]), np.array([1.0 + 0j, 0.5j]), 0.8, static=True)
    receiver = replace(
        draw_receiver(np.random.default_rng(2), 1016),
        bandwidth_hz=1e8,
        tap_spacing_ns=10.0,
        taps=64,
        first_path_tap=5.0,
        pulse="sinc",
        ringing=np.ones(1, np.complex128),
        peak_snr_db=float("inf"),
    )
    for pulse in ("tap", "cosine", "sinc", "gauss"):
        magnitude = capture(paths, replace(receiver, pulse=pulse), np.random.default_rng(0))
        assert magnitude.shape == (64,)
        assert magnitude[5] == pytest.approx(1.0, abs=0.02)
        assert magnitude[8] == pytest.approx(0.5, abs=0.02)
        assert np.argmax(magnitude) == 5
    clean = capture(paths, receiver, np.random.default_rng(0))
    noisy = capture(paths, replace(receiver, peak_snr_db=20.0), np.random.default_rng(0))
    assert np.sqrt(np.mean((noisy - clean) ** 2)) == pytest.approx(0.1, rel=0.4)


def test_the_same_generator_gives_the_same_capture() -> None:
    def one() -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        rng = np.random.default_rng(7)
        paths, receiver = draw_paths(rng, line_of_sight=False), draw_receiver(rng, 256)
        return capture(paths, receiver, rng, 0.3)

    np.testing.assert_array_equal(one(), one())


def test_receivers_vary_and_stay_within_what_is_asked() -> None:
    rng = np.random.default_rng(3)
    receivers = [draw_receiver(rng, 1016) for _ in range(300)]
    assert {receiver.pulse for receiver in receivers} == {"tap", "cosine", "sinc", "gauss"}
    assert min(receiver.taps for receiver in receivers) == 32
    assert max(receiver.taps for receiver in receivers) == 1016
    assert all(0 <= receiver.first_path_tap < receiver.taps - 20 for receiver in receivers)
    assert any(np.isinf(receiver.peak_snr_db) for receiver in receivers)
    assert all(receiver.tap_spacing_ns * receiver.bandwidth_hz <= 1e9 * 1.0001 for receiver in receivers)
