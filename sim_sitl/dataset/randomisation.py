"""What varies from link to link in the data that the shipped classifier is trained on.

Why: it meets receivers and places that no one generator has. Rule kept here: nothing but
the channel depends on the label, so that no property of a sounder gives it away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim_sitl.cir import LOS_TABLE, NLOS_TABLE, Sounder
from sim_sitl.cir_encoding import CirEncoding, window_round_first_path
from sim_sitl.dataset.geometry import LinkGeometry
from sim_sitl.dataset.paths import INDOOR_OFFICE, UMA, UMI, Paths, nyusim_paths, scenario_paths
from sim_sitl.dataset.sounding import Pulse

SNR_DB = (8.0, 45.0)
"""Strongest path over the noise of a tap: receivers are triggered by it, whatever the label."""
NOISELESS_SHARE = 0.2
"""Of the links: others' generators often write responses without noise."""
STATIC_SHARE = 0.25
"""Of the links: nothing moves, and captures differ by their noise alone."""
SPACING_NOT_TOLD_SHARE = 0.2
"""Of the links: the file says 1 ns, as one does who does not know."""
VARIED_SHARE = 0.3
"""Of the links: :mod:`sim_sitl.dataset.varied_channel`."""


@dataclass(frozen=True, slots=True)
class Domain:
    """One link's sounder, and what it does to a response."""

    sounder: Sounder
    pulse: Pulse
    snr_db: float
    """Strongest path over noise."""
    drift: float
    """Clock drift while summing, in taps."""
    jitter_taps: float
    """σ of the first path's place from capture to capture (the clock's jitter)."""
    window: tuple[int, int]
    """(first tap, tap count) of the full response that is sent."""
    encoding: CirEncoding | None
    """None: not sent over MAVLink."""
    static: bool
    index_bias_taps: float | None
    """Of the sensor's own first-path index, which may mean a pulse's start or centre; None: not told."""
    index_sigma_taps: float


def draw_domain(rng: np.random.Generator, taps: int) -> Domain:
    """Bandwidth, tap spacing, first-path offset, noise floor, clock, window, encoding."""
    sounder = _sounder(rng, taps)
    return Domain(
        sounder=sounder,
        pulse=Pulse.BINNED if rng.random() < 0.15 else Pulse.RAISED_COSINE,
        snr_db=np.inf if rng.random() < NOISELESS_SHARE else float(rng.uniform(*SNR_DB)),
        drift=float(rng.uniform(0, 0.4)) if rng.random() < 0.3 else 0.0,
        jitter_taps=float(rng.uniform(0, 1.0)),
        window=_window(rng, sounder),
        encoding=draw_encoding(rng),
        static=bool(rng.random() < STATIC_SHARE),
        index_bias_taps=float(rng.uniform(-3, 3)) if rng.random() < 0.5 else None,
        index_sigma_taps=float(rng.uniform(0.1, 1.0)),
    )


def draw_encoding(rng: np.random.Generator) -> CirEncoding | None:
    """One of SAR_CIR's three, or none."""
    number = int(rng.integers(4))
    return CirEncoding(number) if number < 3 else None


def told_spacing_ns(rng: np.random.Generator, tap_spacing_ns: float) -> float:
    """The spacing that the file gives."""
    return 1.0 if rng.random() < SPACING_NOT_TOLD_SHARE else tap_spacing_ns


def draw_paths(rng: np.random.Generator, geometry: LinkGeometry) -> Paths:
    """Of 18 links five have NYUSIM's constants, five the same loosened, eight are 3GPP's."""
    kind = rng.random()
    if kind < 5 / 18:
        return nyusim_paths(rng, geometry)
    # A direct path may be stronger than the model has it, and an obstructed one may be absorbed.
    gain_db = float(rng.uniform(0, 10) if geometry.line_of_sight else rng.uniform(-20, 0))
    if kind < 5 / 9:
        return _loosened(rng, geometry, gain_db)
    table = (UMA, UMI, INDOOR_OFFICE)[int(rng.integers(3))][geometry.line_of_sight]
    return scenario_paths(rng, geometry, table, 0.0 if rng.random() < 0.5 else gain_db)


def _loosened(rng: np.random.Generator, geometry: LinkGeometry, gain_db: float) -> Paths:
    base = LOS_TABLE if geometry.line_of_sight else NLOS_TABLE
    # Rooms scatter within tens of nanoseconds, cities within microseconds.
    scale = float(10 ** rng.uniform(np.log10(0.3), np.log10(3.0)))
    table = replace(
        base,
        inter_cluster_delay_ns=base.inter_cluster_delay_ns * scale,
        cluster_decay_ns=base.cluster_decay_ns * scale * float(rng.uniform(0.7, 1.4)),
        subpath_decay_ns=base.subpath_decay_ns * scale * float(rng.uniform(0.7, 1.4)),
        subpath_sigma_db=float(rng.uniform(3, 7)),
    )
    return nyusim_paths(rng, geometry, table, gain_db)


def _sounder(rng: np.random.Generator, taps: int) -> Sounder:
    # Half of the links at the UWB default, which is what the simulator and phones sound with.
    if rng.random() < 0.5:
        bandwidth_hz, spacing_ns = 500e6, 1.0016
    else:
        bandwidth_hz = float(10 ** rng.uniform(np.log10(20e6), np.log10(900e6)))
        spacing_ns = 1e9 / bandwidth_hz / float(rng.uniform(1.0, 3.0))
    return Sounder(bandwidth_hz, spacing_ns, taps, first_path_tap=float(rng.uniform(0, 0.8 * taps)))


def _window(rng: np.random.Generator, sounder: Sounder) -> tuple[int, int]:
    """The full response (one time in four), or a window round the first path."""
    if rng.random() < 0.25:
        return 0, sounder.taps
    taps = int(rng.choice([32, 64, 64, 128, 256]))
    lead = int(rng.integers(0, 16))
    return window_round_first_path(sounder.taps, sounder.first_path_tap, taps, lead)


def told_index(
    rng: np.random.Generator, domain: Domain, first_path: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(captures,) the sensor's first-path index, taps from the window's start; NaN where it tells none."""
    if domain.index_bias_taps is None:
        return np.full(len(first_path), np.nan)
    error = domain.index_bias_taps + domain.index_sigma_taps * rng.standard_normal(len(first_path))
    return first_path + error
