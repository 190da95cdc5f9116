"""Any window of a channel response → the network's input, or the reason why not.

Why: sensors send 64 taps round the first path or 1,016 taps of everything, at a nanosecond
or at a microsecond a tap. Rule kept here: training and service run this very code.

The input is aligned on the first path and seen as by an eye: 16 taps before it and 80 from
it on at their own resolution, the rest of the response in 32 bins that widen
geometrically up to 1,024 taps behind the first path (root mean square within each). Time is
not resampled to one grid: a 2 ns grid would blur a UWB response and invent detail in a
narrow one. Instead each bin carries its time, so that spacing is a number the network sees:

- channel 0: min–max normalised magnitude (the paper, III-A), 0 where there is no data;
- channel 1: magnitude in dB below the peak, −50…0 dB as 0…1;
- channel 2: time after the first path t, sign(t) log₁₀(1 + |t|/ns) / 4;
- channel 3: 1 where the window had data.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.channel.capture import ChannelCapture, UnusableCaptureError, as_magnitude
from groundstation.channel.settings import ChannelSettings

PREPROCESSING_VERSION = 1
"""A model names the version it was trained with; another one is refused."""
LEAD_TAPS = 16
FINE_TAPS = 80
TAIL_BINS = 32
TAIL_END_TAPS = 1024
INPUT_BINS = LEAD_TAPS + FINE_TAPS + TAIL_BINS
INPUT_CHANNELS = 4
DYNAMIC_RANGE_DB = 50.0
HINT_TAPS = 16
"""How far from a sensor's first-path index the leading edge is looked for."""

_TAIL_EDGES = np.rint(np.geomspace(FINE_TAPS, TAIL_END_TAPS, TAIL_BINS + 1)).astype(np.int64)
TAIL_TAPS = np.diff(_TAIL_EDGES)
"""(TAIL_BINS,) taps of each tail bin."""
_BIN_TAPS = np.concatenate([np.arange(-LEAD_TAPS, FINE_TAPS), 0.5 * (_TAIL_EDGES[:-1] + _TAIL_EDGES[1:] - 1)])
"""(INPUT_BINS,) centre of each bin, taps after the first path."""

_RAYLEIGH_QUARTILE = 0.7585
"""Lower quartile of a Rayleigh variable over its σ."""
_NOISE_FALSE_ALARM = 1e-3
"""Chance that noise alone has a peak which passes for a signal's."""
_NOISE_STEP = 8.0
"""Log likelihood ratio of a step in power that noise alone passes about once in a thousand."""


def network_input(capture: ChannelCapture, settings: ChannelSettings) -> NDArray[np.float32]:
    """(INPUT_CHANNELS, INPUT_BINS) of one capture.

    Raises UnusableCaptureError, with the reason, on a capture that is too short, not finite,
    constant, saturated or all noise, or has no usable tap spacing.
    """
    magnitude = as_magnitude(capture)
    _check(magnitude, capture.tap_spacing_ns, settings)
    first_path = leading_edge(magnitude, capture.first_path_index)
    low, peak = float(magnitude.min()), float(magnitude.max())

    # Positions in the window of the fine taps; outside there is no data.
    fine = first_path + np.arange(-LEAD_TAPS, FINE_TAPS)
    fine_known = (fine >= 0) & (fine < len(magnitude))
    fine_magnitude = magnitude[np.clip(fine, 0, len(magnitude) - 1)]
    energy = np.concatenate([[0.0], np.cumsum(magnitude**2)])
    edges = np.clip(first_path + _TAIL_EDGES, 0, len(magnitude))
    tail_taps = np.diff(edges)
    tail_magnitude = np.sqrt(np.maximum(np.diff(energy[edges]), 0.0) / np.maximum(tail_taps, 1))

    known = np.concatenate([fine_known, tail_taps > 0])
    binned = np.concatenate([fine_magnitude, tail_magnitude])
    time_ns = _BIN_TAPS * capture.tap_spacing_ns
    below_peak_db = 20 * np.log10(np.maximum(binned / peak, 10 ** (-DYNAMIC_RANGE_DB / 20)))
    channels = np.stack(
        [
            np.where(known, np.clip((binned - low) / (peak - low), 0, 1), 0),
            np.where(known, 1 + below_peak_db / DYNAMIC_RANGE_DB, 0),
            np.sign(time_ns) * np.log10(1 + np.abs(time_ns)) / 4,
            known,
        ]
    )
    return channels.astype(np.float32)


def leading_edge(magnitude: NDArray[np.float64], told: float | None = None) -> int:
    """Tap of the first path by its leading edge; near ``told`` where that lies in the window.

    A sensor's own index is a hint, not the alignment: sensors define it differently (start
    or centre of the pulse), and aligning some links on it and some on the edge blurs the
    input. Where no edge lies within 16 taps of it, the sensor may have seen what we cannot.

    The first tap above both 4.5 σ of the noise (from the lower quartile of the window) and
    15 % of the peak; the threshold never passes 60 % of the peak, for in a short window full of
    paths the quartile is not noise.
    """
    peak = float(magnitude.max())
    sigma = float(np.quantile(magnitude, 0.25)) / _RAYLEIGH_QUARTILE
    threshold = min(max(4.5 * sigma, 0.15 * peak), 0.6 * peak)
    above = magnitude >= threshold
    if told is None or not np.isfinite(told) or not 0 <= told <= len(magnitude) - 1:
        return int(np.argmax(above))
    start = max(round(told) - HINT_TAPS, 0)
    near = above[start : round(told) + HINT_TAPS + 1]
    return start + int(np.argmax(near)) if np.any(near) else round(told)


def _check(magnitude: NDArray[np.float64], tap_spacing_ns: float, settings: ChannelSettings) -> None:
    taps = len(magnitude)
    if taps < settings.taps_min:
        raise UnusableCaptureError(f"too short: {taps} taps, {settings.taps_min} needed")
    if not (np.isfinite(tap_spacing_ns) and tap_spacing_ns > 0):
        raise UnusableCaptureError(f"tap spacing is {tap_spacing_ns} ns; it must be positive")
    peak = float(magnitude.max())
    if float(magnitude.min()) == peak:
        raise UnusableCaptureError("constant: every tap is the same")
    if _is_saturated(magnitude, peak):
        raise UnusableCaptureError("saturated: too many taps at full scale")
    if settings.reject_noise and _is_noise(magnitude):
        raise UnusableCaptureError("all noise: no path stands out")


def _is_saturated(magnitude: NDArray[np.float64], peak: float) -> bool:
    """Whether the top is cut off: several taps at the very peak, apart or most of what is strong.

    A wide pulse in coarse steps has a flat top too, but one, and narrow beside its flanks.
    """
    top = magnitude == peak
    taps = int(np.count_nonzero(top))
    runs = int(np.count_nonzero(np.diff(top.astype(np.int8), prepend=0) == 1))
    strong = int(np.count_nonzero(magnitude >= 0.5 * peak))
    return (taps >= 5 and runs >= 3) or (taps >= 4 and 2 * taps >= strong)


def _is_noise(magnitude: NDArray[np.float64]) -> bool:
    """Whether a window is as noise alone would be, by three marks that must agree.

    No high peak; no more uneven than Rayleigh magnitudes, for which n Σm⁴ / (Σm²)² is 2
    within a few times √(20/n) (a dense response in a short window has a low peak too, but
    its energy falls off with delay); and no tap before which the power differs from that
    after it (likelihood ratio of exponential powers, counted in independent samples).
    """
    taps = len(magnitude)
    power = magnitude**2
    rayleigh_peak = np.sqrt(2 * np.log(taps / _NOISE_FALSE_ALARM)) / np.sqrt(2 * np.log(2))
    if float(magnitude.max()) >= rayleigh_peak * float(np.median(magnitude)):
        return False
    total = float(power.sum())
    if taps * float(np.sum(power**2)) / total**2 >= 2 + 2 * np.sqrt(20 / taps):
        return False
    before = np.arange(3, taps - 2)
    energy = np.maximum(np.cumsum(power)[before - 1], 1e-12 * total)
    rest = np.maximum(total - energy, 1e-12 * total)
    ratio = -before * np.log(energy / total * taps / before)
    ratio -= (taps - before) * np.log(rest / total * taps / (taps - before))
    deviation = power - total / taps
    correlation = float(deviation[1:] @ deviation[:-1]) / float(deviation @ deviation)
    correlation = min(max(correlation, 0.0), 0.95)
    return float(ratio.max()) < _NOISE_STEP * (1 + correlation) / (1 - correlation)
