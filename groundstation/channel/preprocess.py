"""Any window of a channel response → the network's input, or the reason why not.

Why: sensors send 64 taps round the first path or 1,016 taps of everything, at a nanosecond
or at a microsecond a tap. Rules kept here: training and service run this very code; captures of one
length are prepared together (one by one this took ten times as long as the network), row by row
alike, so that a capture's input does not depend on its company.

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
    told = np.nan if capture.first_path_index is None else capture.first_path_index
    inputs, reasons = network_inputs(
        magnitude[None], np.array([capture.tap_spacing_ns]), np.array([told]), settings
    )
    if reasons[0]:
        raise UnusableCaptureError(reasons[0])
    result: NDArray[np.float32] = inputs[0]
    return result


def network_inputs(
    magnitude: NDArray[np.float64],
    tap_spacing_ns: NDArray[np.float64],
    told: NDArray[np.float64],
    settings: ChannelSettings,
) -> tuple[NDArray[np.float32], list[str]]:
    """(n, INPUT_CHANNELS, INPUT_BINS) of (n, taps) captures, and why one cannot be used ("" = it can).

    ``tap_spacing_ns`` and ``told`` (first-path index, NaN = not told) are (n,). The input of an
    unusable capture is zero.
    """
    count, taps = magnitude.shape
    inputs = np.zeros((count, INPUT_CHANNELS, INPUT_BINS), np.float32)
    reasons = _unusable(magnitude, tap_spacing_ns, settings)
    if any(reasons):
        usable = np.flatnonzero([not reason for reason in reasons])
        magnitude, tap_spacing_ns, told = magnitude[usable], tap_spacing_ns[usable], told[usable]
    else:
        usable = np.arange(count)
    if not len(usable):
        return inputs, reasons
    first_path = leading_edges(magnitude, told)[:, None]
    low, peak = magnitude.min(axis=1, keepdims=True), magnitude.max(axis=1, keepdims=True)

    # Positions in the window of the fine taps; outside there is no data.
    fine = first_path + np.arange(-LEAD_TAPS, FINE_TAPS)
    fine_known = (fine >= 0) & (fine < taps)
    fine_magnitude = np.take_along_axis(magnitude, np.clip(fine, 0, taps - 1), axis=1)
    energy = np.zeros((len(usable), taps + 1))
    np.cumsum(magnitude**2, axis=1, out=energy[:, 1:])
    edges = np.clip(first_path + _TAIL_EDGES, 0, taps)
    tail_taps = np.diff(edges)
    tail_energy = np.diff(np.take_along_axis(energy, edges, axis=1))
    tail_magnitude = np.sqrt(np.maximum(tail_energy, 0.0) / np.maximum(tail_taps, 1))

    known = np.concatenate([fine_known, tail_taps > 0], axis=1)
    binned = np.concatenate([fine_magnitude, tail_magnitude], axis=1)
    below_peak_db = 20 * np.log10(np.maximum(binned / peak, 10 ** (-DYNAMIC_RANGE_DB / 20)))
    channels = np.empty((len(usable), INPUT_CHANNELS, INPUT_BINS))
    channels[:, 0] = np.where(known, np.clip((binned - low) / (peak - low), 0, 1), 0)
    channels[:, 1] = np.where(known, 1 + below_peak_db / DYNAMIC_RANGE_DB, 0)
    channels[:, 2] = time_channel(tap_spacing_ns)
    channels[:, 3] = known
    inputs[usable] = channels
    return inputs, reasons


def time_channel(tap_spacing_ns: NDArray[np.float64]) -> NDArray[np.float32]:
    """(n, INPUT_BINS) channel 2 of (n,) tap spacings."""
    time_ns = _BIN_TAPS * tap_spacing_ns[:, None]
    channel: NDArray[np.float64] = np.sign(time_ns) * np.log10(1 + np.abs(time_ns)) / 4
    return channel.astype(np.float32)


def leading_edges(magnitude: NDArray[np.float64], told: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) taps of the first paths of (n, taps) by their leading edges; near ``told`` where it lies within.

    A sensor's own index is a hint, not the alignment: sensors define it differently (start
    or centre of the pulse), and aligning some links on it and some on the edge blurs the
    input. Where no edge lies within 16 taps of it, the sensor may have seen what we cannot.

    The first tap above both 4.5 σ of the noise (from the lower quartile of the window) and
    15 % of the peak; the threshold never passes 60 % of the peak, for in a short window full of
    paths the quartile is not noise.
    """
    taps = magnitude.shape[1]
    peak = magnitude.max(axis=1)
    sigma = _lower_quartile(magnitude) / _RAYLEIGH_QUARTILE
    threshold = np.minimum(np.maximum(4.5 * sigma, 0.15 * peak), 0.6 * peak)
    above = magnitude >= threshold[:, None]
    edge: NDArray[np.int64] = np.argmax(above, axis=1)
    with np.errstate(invalid="ignore"):
        inside = (told >= 0) & (told <= taps - 1)
    if np.any(inside):
        index = np.rint(told[inside]).astype(np.int64)
        near = above[inside] & (np.abs(np.arange(taps) - index[:, None]) <= HINT_TAPS)
        edge[inside] = np.where(np.any(near, axis=1), np.argmax(near, axis=1), index)
    return edge


def _lower_quartile(magnitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) 25 % quantiles of (n, taps), as np.quantile interpolates, at a fraction of its time."""
    place = 0.25 * (magnitude.shape[1] - 1)
    below = int(place)
    share = place - below
    ordered = np.partition(magnitude, (below, min(below + 1, magnitude.shape[1] - 1)), axis=1)
    low, high = ordered[:, below], ordered[:, min(below + 1, magnitude.shape[1] - 1)]
    quartile: NDArray[np.float64] = (
        low + (high - low) * share if share < 0.5 else high - (high - low) * (1 - share)
    )
    return quartile


def _unusable(
    magnitude: NDArray[np.float64], tap_spacing_ns: NDArray[np.float64], settings: ChannelSettings
) -> list[str]:
    """Why each of (n, taps) captures cannot be used; "" where it can."""
    count, taps = magnitude.shape
    if taps < settings.taps_min:
        return [f"too short: {taps} taps, {settings.taps_min} needed"] * count
    reasons = [""] * count

    def mark(bad: NDArray[np.bool_], reason: str) -> None:
        for row in np.flatnonzero(bad):
            reasons[row] = reasons[row] or reason

    for row in np.flatnonzero(~(np.isfinite(tap_spacing_ns) & (tap_spacing_ns > 0))):
        reasons[row] = f"tap spacing is {tap_spacing_ns[row]} ns; it must be positive"
    peak = magnitude.max(axis=1)
    mark(magnitude.min(axis=1) == peak, "constant: every tap is the same")
    mark(_is_saturated(magnitude, peak), "saturated: too many taps at full scale")
    if settings.reject_noise:
        rayleigh_peak = np.sqrt(2 * np.log(taps / _NOISE_FALSE_ALARM)) / np.sqrt(2 * np.log(2))
        low = np.flatnonzero(peak < rayleigh_peak * np.median(magnitude, axis=1))
        noise = [row for row in low if not reasons[row] and _is_noise(magnitude[row])]
        mark(np.isin(np.arange(count), noise), "all noise: no path stands out")
    return reasons


def _is_saturated(magnitude: NDArray[np.float64], peak: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) whether the top is cut off: several taps at the very peak, apart or most of what is strong.

    A wide pulse in coarse steps has a flat top too, but one, and narrow beside its flanks.
    """
    top = magnitude == peak[:, None]
    taps = np.count_nonzero(top, axis=1)
    runs = top[:, 0] + np.count_nonzero(top[:, 1:] & ~top[:, :-1], axis=1)
    strong = np.count_nonzero(magnitude >= 0.5 * peak[:, None], axis=1)
    saturated: NDArray[np.bool_] = ((taps >= 5) & (runs >= 3)) | ((taps >= 4) & (2 * taps >= strong))
    return saturated


def _is_noise(magnitude: NDArray[np.float64]) -> bool:
    """Whether a window without a high peak is as noise alone would be, by two more marks.

    No more uneven than Rayleigh magnitudes, for which n Σm⁴ / (Σm²)² is 2
    within a few times √(20/n) (a dense response in a short window has a low peak too, but
    its energy falls off with delay); and no tap before which the power differs from that
    after it (likelihood ratio of exponential powers, counted in independent samples).
    """
    taps = len(magnitude)
    power = magnitude**2
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
