"""Channels unlike the cluster model: a family with loose constants, sampled in any way.

Why: a classifier trained on one generator learns that generator. These links keep only what
holds in every published model (Saleh & Valenzuela, IEEE JSAC 1987; WINNER; 3GPP TR 38.901):
paths come in clusters whose power falls with delay, a line of sight adds a strong first
path and shortens the spread, an obstruction spreads the energy and may take the direct path
away. Everything else is drawn: scales from a room to a city, how the receiver filters,
where it puts the first path, and its noise. Rule kept here: a draw depends on the label only through the
paths, never through the receiver.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class VariedPaths:
    """The paths of one link; the first is at delay 0 and is the direct one where there is a line of sight."""

    delay_ns: NDArray[np.float64]
    """(paths,) ascending from 0."""
    amplitude: NDArray[np.complex128]
    """(paths,) powers sum to one on average."""
    direct_share: float
    """Power of the direct path over all, 0 without a line of sight."""
    static: bool
    """Whether consecutive captures see the same phases (nothing moves)."""


@dataclass(frozen=True, slots=True, eq=False)
class VariedReceiver:
    """How one receiver samples; the same for all captures of a link."""

    bandwidth_hz: float
    tap_spacing_ns: float
    taps: int
    first_path_tap: float
    pulse: str
    """``tap`` (each path into its nearest tap), ``cosine``, ``sinc`` or ``gauss``."""
    roll_off: float
    ringing: NDArray[np.complex128]
    """(1…8,) response of antenna and filters on the taps' raster, 1 first: it smears every path alike."""
    peak_snr_db: float
    """Strongest tap over the noise of a tap; infinite without noise."""


def draw_paths(rng: np.random.Generator, *, line_of_sight: bool) -> VariedPaths:
    """Draw the paths of one link."""
    # A place has a scale (a room some nanoseconds, a city hundreds); the state stretches it.
    scale_ns = float(10 ** rng.uniform(np.log10(5.0), np.log10(400.0)))
    spread_ns = scale_ns * float(10 ** rng.normal(-0.15 if line_of_sight else 0.25, 0.2))
    clusters = int(rng.integers(2, 24))
    proportion = float(rng.uniform(1.2, 3.5))
    start_ns = rng.exponential(proportion * spread_ns, size=clusters)
    start_ns = np.sort(start_ns - start_ns.min())
    cluster_db = -10 / np.log(10) * start_ns * (proportion - 1) / (proportion * spread_ns)
    cluster_db += rng.normal(0, rng.uniform(1, 6), size=clusters)
    if rng.random() < 0.3:  # clusters that rise before they fall, as behind an obstacle
        rise_ns = spread_ns * rng.uniform(0.1, 0.6 if not line_of_sight else 0.2)
        cluster_db += 10 * np.log10(1 - rng.uniform(0.3, 0.98) * np.exp(-start_ns / rise_ns))
    rays = int(rng.integers(1, 21))
    within_ns = spread_ns * float(10 ** rng.uniform(-2, -0.3))
    offset_ns = rng.exponential(within_ns, size=(clusters, rays)) * (np.arange(rays) > 0)
    power = 10 ** (cluster_db[:, None] / 10) * np.exp(-offset_ns / (within_ns * rng.uniform(0.5, 2)))
    power *= 10 ** (rng.normal(0, rng.uniform(0, 5), size=power.shape) / 10)
    delay_ns = (start_ns[:, None] + offset_ns).ravel()
    power = power.ravel()
    power /= power.sum()
    amplitude = np.sqrt(power / 2) * (rng.standard_normal(len(power)) + 1j * rng.standard_normal(len(power)))
    if rays > 4:  # many rays of one cluster make their own fading
        amplitude = np.sqrt(power) * np.exp(2j * np.pi * rng.random(len(power)))
    direct_share = 0.0
    if line_of_sight:
        factor = 10 ** (float(np.clip(rng.normal(8, 4), 0, 20)) / 10)
        direct_share = factor / (1 + factor)
        amplitude *= np.sqrt(1 - direct_share)
        delay_ns = np.append(delay_ns + rng.exponential(0.1 * spread_ns), 0.0)
        amplitude = np.append(amplitude, np.sqrt(direct_share) * np.exp(2j * np.pi * rng.random()))
    elif rng.random() < 0.5:
        amplitude[delay_ns < 0.1 * spread_ns] *= 10 ** (-rng.uniform(0, 15) / 20)
    order = np.argsort(delay_ns, kind="stable")
    delay_ns = delay_ns[order] - delay_ns[order[0]]
    return VariedPaths(delay_ns, amplitude[order], direct_share, bool(rng.random() < 0.25))


def draw_receiver(rng: np.random.Generator, taps_max: int) -> VariedReceiver:
    """Draw a receiver whose window has at most ``taps_max`` taps."""
    bandwidth_hz = float(10 ** rng.uniform(np.log10(10e6), np.log10(1e9)))
    pulse = ("tap", "cosine", "sinc", "gauss")[int(rng.choice(4, p=(0.3, 0.4, 0.15, 0.15)))]
    oversampling = 1.0 if pulse == "tap" else float(rng.choice([1.0, 1.0, rng.uniform(1, 4)]))
    taps = int(min(taps_max, rng.choice([32, 64, 64, 128, 256, 512, taps_max])))
    ringing = np.ones(1, np.complex128)
    if pulse != "tap" and rng.random() < 0.6:
        length = int(rng.integers(2, 9))
        tail = (rng.standard_normal(length) + 1j * rng.standard_normal(length)) * rng.uniform(0.2, 0.8)
        ringing = np.append(1.0, tail * np.exp(-np.arange(length) / rng.uniform(0.5, 3.0)))
    lead = 0.0 if rng.random() < 0.25 else float(min(rng.exponential(30.0), 0.8 * taps, taps - 24))
    return VariedReceiver(
        bandwidth_hz=bandwidth_hz,
        tap_spacing_ns=1e9 / bandwidth_hz / oversampling,
        taps=taps,
        first_path_tap=float(round(lead)) if rng.random() < 0.5 else lead,
        pulse=pulse,
        roll_off=float(rng.uniform(0.1, 1.0)),
        ringing=ringing,
        peak_snr_db=float("inf") if rng.random() < 0.35 else float(rng.uniform(10, 45)),
    )


def capture(
    paths: VariedPaths, receiver: VariedReceiver, rng: np.random.Generator, jitter_taps: float = 0.0
) -> NDArray[np.float64]:
    """(taps,) magnitudes of one sounding, its strongest tap about 1."""
    amplitude = paths.amplitude
    if not paths.static:
        amplitude = amplitude * np.exp(2j * np.pi * rng.random(len(amplitude)))
    position = receiver.first_path_tap + jitter_taps + paths.delay_ns / receiver.tap_spacing_ns
    grid = np.arange(receiver.taps)
    if receiver.pulse == "tap":
        response = np.zeros(receiver.taps, np.complex128)
        nearest = np.floor(position).astype(np.int64)
        inside = (nearest >= 0) & (nearest < receiver.taps)
        np.add.at(response, nearest[inside], amplitude[inside])
    else:
        inside = position < receiver.taps + 8
        x = (grid - position[inside, None]) * (receiver.tap_spacing_ns * 1e-9 * receiver.bandwidth_hz)
        response = amplitude[inside] @ _pulse(x, receiver)
    response = np.convolve(response, receiver.ringing)[: receiver.taps]
    peak = float(np.abs(response).max())
    if peak > 0:
        response = response / peak
    if np.isfinite(receiver.peak_snr_db):
        noise = rng.standard_normal(receiver.taps) + 1j * rng.standard_normal(receiver.taps)
        response = response + 10 ** (-receiver.peak_snr_db / 20) / np.sqrt(2) * noise
    return np.abs(response)


def _pulse(x: NDArray[np.float64], receiver: VariedReceiver) -> NDArray[np.float64]:
    """The receiver's pulse, peak 1 at x = 0, x in units of 1/bandwidth."""
    if receiver.pulse == "gauss":
        return np.exp(-np.pi * np.square(x))
    pulse = np.sinc(x)
    if receiver.pulse == "cosine":
        denominator = 1 - (2 * receiver.roll_off * x) ** 2
        singular = np.abs(denominator) < 1e-6
        shaped = np.cos(np.pi * receiver.roll_off * x) / np.where(singular, 1.0, denominator)
        pulse = pulse * np.where(singular, np.pi / 4, shaped)
    return pulse
