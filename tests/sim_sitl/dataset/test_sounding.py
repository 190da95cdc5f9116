"""The fast sounding of a link against the one-capture way of the live simulator."""

from __future__ import annotations

import numpy as np
import pytest

from sim_sitl.cir import Sounder, draw_channel
from sim_sitl.dataset.sounding import Pulse, clock_drift, noise, noiseless_response


@pytest.mark.parametrize("sounder", [Sounder(taps=256), Sounder(3e6, 166.0, 64), Sounder(500e6, 0.4, 300)])
def test_responses_are_those_of_the_live_simulator(sounder: Sounder) -> None:
    rng = np.random.default_rng(1)
    channel = draw_channel(rng, line_of_sight=False, frequency_hz=867.5e6)
    first_path = np.array([20.3, 20.3, 41.0])
    turned = [channel.phase_rad + turn for turn in (0.0, 1.0, 2.0)]
    amplitude = np.array([np.sqrt(channel.power) * np.exp(1j * phase) for phase in turned])
    ours = noiseless_response(channel.delay_ns, amplitude, sounder, first_path, sounder.taps)
    for capture, turn in enumerate((0.0, 1.0, 2.0)):
        theirs = channel.impulse_response(
            taps=sounder.taps,
            tap_spacing_ns=sounder.tap_spacing_ns,
            bandwidth_hz=sounder.bandwidth_hz,
            first_path_tap=float(first_path[capture]),
            snr_db=400,
            rng=rng,
        )
        np.testing.assert_allclose(ours[capture], theirs * np.exp(1j * turn), atol=1e-4)


def test_binned_paths_fall_into_their_nearest_taps() -> None:
    sounder = Sounder(500e6, 1.0, 32)
    amplitude = np.array([[1.0, 0.5j, 0.25]])
    response = noiseless_response(
        np.array([0.0, 0.0, 7.4]), amplitude, sounder, np.array([4.0]), 32, Pulse.BINNED
    )
    assert response[0, 4] == 1 + 0.5j
    assert response[0, 11] == 0.25
    assert np.count_nonzero(response) == 2


@pytest.mark.parametrize("pulse", list(Pulse))
def test_noise_has_unit_power(pulse: Pulse) -> None:
    values = noise(np.random.default_rng(2), 40, 1016, Sounder(), pulse)
    assert np.mean(np.abs(values) ** 2) == pytest.approx(1.0, rel=0.03)


def test_a_drifting_clock_smears_and_keeps_the_sum() -> None:
    response = np.zeros((1, 9), complex)
    response[0, 4] = 1.0
    np.testing.assert_allclose(clock_drift(response, 0.4)[0, 3:6], [0.2, 0.6, 0.2])
    np.testing.assert_array_equal(clock_drift(response, 0.0), response)
