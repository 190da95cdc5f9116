"""From paths to what a sensor's sounder makes of them: all captures of a link at once.

Why: this is where a data set's time goes: pulses are computed once for all captures whose
first path falls on the same place, and paths of one delay are one pulse. Rule kept here: with the same
arguments the responses are those of :meth:`sim_sitl.cir.ClusterChannel.impulse_response`.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import NDArray

from sim_sitl.cir import PULSE_REACH, ROLL_OFF, Sounder, raised_cosine

PULSE_ENERGY = 1 - ROLL_OFF / 4
"""∫ of the squared raised cosine, in 1/bandwidth."""


class Pulse(Enum):
    """What a path becomes."""

    RAISED_COSINE = "raised cosine"
    """Band-limited, as any receiver's filters leave it; noise within the same band."""
    BINNED = "binned"
    """All of it in the nearest tap, white noise: what simple channel generators write."""


def noiseless_response(
    delay_ns: NDArray[np.float64],
    amplitude: NDArray[np.complex128],
    sounder: Sounder,
    first_path_tap: NDArray[np.float64],
    taps: int,
    pulse: Pulse = Pulse.RAISED_COSINE,
) -> NDArray[np.complex128]:
    """(captures, taps) of (captures, paths) amplitudes; ``first_path_tap`` (captures,) may be fractional."""
    starts = np.flatnonzero(np.diff(delay_ns, prepend=-np.inf))
    delay_ns, amplitude = delay_ns[starts], np.add.reduceat(amplitude, starts, axis=1)
    response = np.zeros((len(amplitude), taps), np.complex128)
    for first in np.unique(first_path_tap):
        members = np.flatnonzero(first_path_tap == first)
        centre = first + delay_ns / sounder.tap_spacing_ns
        if pulse is Pulse.BINNED:
            tap, weight = np.rint(centre).astype(np.int64)[:, None], np.ones((len(centre), 1))
        else:
            per_pulse = sounder.tap_spacing_ns * 1e-9 * sounder.bandwidth_hz
            reach = int(np.ceil(PULSE_REACH / per_pulse))
            near = (centre > -reach) & (centre < taps + reach)
            centre, seen = centre[near], amplitude[:, near]
            if 2 * reach + 1 < taps:
                tap = np.rint(centre).astype(np.int64)[:, None] + np.arange(-reach, reach + 1)
            else:
                tap = np.broadcast_to(np.arange(taps), (len(centre), taps))
            weight = raised_cosine((tap - centre[:, None]) * per_pulse)
        inside = (tap >= 0) & (tap < taps)
        place = tap[inside]
        for member in members:
            values = amplitude[member] if pulse is Pulse.BINNED else seen[member]
            parts = (weight * values[:, None])[inside]
            response[member].real = np.bincount(place, weights=parts.real, minlength=taps)
            response[member].imag = np.bincount(place, weights=parts.imag, minlength=taps)
    return response


def noise(
    rng: np.random.Generator, captures: int, taps: int, sounder: Sounder, pulse: Pulse = Pulse.RAISED_COSINE
) -> NDArray[np.complex128]:
    """(captures, taps) circular Gaussian noise of unit power per tap, within the band."""
    white: NDArray[np.complex128] = rng.standard_normal((captures, taps, 2)).view(np.complex128)[..., 0]
    if pulse is Pulse.BINNED:
        scaled: NDArray[np.complex128] = white * np.sqrt(0.5)
        return scaled
    frequency_hz = np.abs(np.fft.fftfreq(taps, sounder.tap_spacing_ns * 1e-9))
    edge = (frequency_hz - sounder.bandwidth_hz * (1 - ROLL_OFF) / 2) / (sounder.bandwidth_hz * ROLL_OFF)
    gain = np.sqrt(0.5 * (1 + np.cos(np.pi * np.clip(edge, 0, 1))))
    gain *= np.sqrt(0.5 / np.mean(gain**2))
    coloured: NDArray[np.complex128] = np.fft.ifft(np.fft.fft(white, axis=1) * gain, axis=1)
    return coloured


def clock_drift(response: NDArray[np.complex128], share: float) -> NDArray[np.complex128]:
    """Smear (captures, taps) as a clock does that drifts by ±``share`` of a tap while symbols are summed."""
    smeared = (1 - share) * response
    smeared[:, 1:] += 0.5 * share * response[:, :-1]
    smeared[:, :-1] += 0.5 * share * response[:, 1:]
    return smeared
