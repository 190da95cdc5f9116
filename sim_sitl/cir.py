"""The channel between a beacon and a vehicle: clusters of paths, and what a sounder sees of them.

Why: links need impulse responses whose shape depends on the obstruction as it does in the
field, and not on anything that the station's own classifier or solvers assume. The model is
the time-cluster, spatial-lobe model of NYUSIM (Samimi & Rappaport, IEEE Trans. MTT 2016;
Sun, MacCartney & Rappaport, ICC 2017) with its urban-macrocell constants below 28 GHz. Rule
kept here: a channel is a value; all randomness is the caller's generator.

Frame of directions: local east-north-up, pointing from the vehicle to where a path comes
from. Powers are relative (they sum to one): path loss and shadowing belong to propagation.

Bandwidth. The paper sounds 3 MHz: one tap is 333 ns there and nearly all of a channel's
energy falls within one or two taps, so that next to nothing of the first path is left to
see. The simulator's default (:class:`Sounder`) is 500 MHz on a 1.0016 ns raster over 1,016
taps, as the UWB radios in phones and their common receivers sound: the model's 2.5 ns
subpath raster is then resolved, which is where a line of sight shows (the strongest subpath
comes first). Both are arguments everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

SPEED_OF_LIGHT_M_S = 299_792_458.0
VOID_INTERVAL_NS = 25.0
"""Least silence between two time clusters."""
SUBPATH_RASTER_BANDWIDTH_GHZ = 0.8
"""NYUSIM lays subpaths out on 2/B = 2.5 ns."""
ROLL_OFF = 0.25
"""Of the raised-cosine pulse that a sounder's filters make of a path."""
PULSE_REACH = 24.0
"""Where the pulse is cut, in 1/bandwidth: it has fallen below -80 dB there."""
EVOLUTION_DISTANCE_M = 12.0
"""Path powers decorrelate as exp(-distance / this): NYUSIM's spatial-consistency distance, UMa."""


@dataclass(frozen=True, slots=True)
class ClusterTable:
    """Constants of the cluster model for one state of obstruction."""

    excess_exponent_max: float
    """X_max of the intra-cluster delays."""
    inter_cluster_delay_ns: float
    """Mean of the exponential inter-cluster delay."""
    cluster_decay_ns: float
    cluster_sigma_db: float
    subpath_decay_ns: float
    subpath_sigma_db: float
    clusters_max: int = 6
    subpaths_max: int = 30


LOS_TABLE = ClusterTable(0.2, 123.0, 25.9, 1.0, 16.9, 6.0)
NLOS_TABLE = ClusterTable(0.5, 83.0, 51.0, 3.0, 15.5, 6.0)


@dataclass(frozen=True, slots=True)
class Sounder:
    """How a radio sensor samples a channel. See the module's header for the defaults."""

    bandwidth_hz: float = 500e6
    tap_spacing_ns: float = 1.0016
    taps: int = 1016
    """Taps of the full response."""
    first_path_tap: float = 745.0
    """Where the first path falls in the full response (UWB receivers put it late)."""


@dataclass(frozen=True, slots=True, eq=False)
class ClusterChannel:
    """One realisation of the paths of one link."""

    line_of_sight: bool
    frequency_hz: float
    delay_ns: NDArray[np.float64]
    """(paths,) after the first path, which is 0; clusters in order of arrival."""
    cluster: NDArray[np.int64]
    """(paths,) index of each path's time cluster."""
    within_cluster_ns: NDArray[np.float64]
    """(paths,) delay after the cluster's first subpath."""
    cluster_deviate: NDArray[np.float64]
    """(clusters,) standard normal: a cluster's shadowing in units of its sigma."""
    subpath_deviate: NDArray[np.float64]
    """(paths,) the same for subpaths."""
    phase_rad: NDArray[np.float64]
    """(paths,)"""
    direction_enu: NDArray[np.float64]
    """(paths, 3) unit vectors towards where each path comes from."""
    table: ClusterTable
    """The constants it was drawn with."""
    first_path_gain_db: float = 0.0
    """On top of the model: a dominant direct path (> 0) or an absorbed one (< 0)."""

    @property
    def power(self) -> NDArray[np.float64]:
        """(paths,) relative path powers, summing to one.

        P_n ∝ e^(-τ_n/Γ) 10^(Z/10), normalised; Π_mn ∝ e^(-ρ/γ) 10^(U/10), normalised within
        the cluster; with a line of sight the strongest subpath of the first cluster is first.
        """
        table, count = self.table, len(self.cluster_deviate)
        first_of_cluster = np.searchsorted(self.cluster, np.arange(count))
        cluster_power = np.exp(-self.delay_ns[first_of_cluster] / table.cluster_decay_ns)
        cluster_power *= 10 ** (table.cluster_sigma_db * self.cluster_deviate / 10)
        subpath_power = np.exp(-self.within_cluster_ns / table.subpath_decay_ns)
        subpath_power *= 10 ** (table.subpath_sigma_db * self.subpath_deviate / 10)
        if self.line_of_sight:
            strongest = int(np.argmax(subpath_power[self.cluster == 0]))
            subpath_power[[0, strongest]] = subpath_power[[strongest, 0]]
        cluster_sum = np.bincount(self.cluster, weights=subpath_power, minlength=count)
        power: NDArray[np.float64] = (cluster_power / cluster_power.sum() / cluster_sum)[self.cluster]
        power *= subpath_power
        power[0] *= 10 ** (self.first_path_gain_db / 10)
        power /= power.sum()
        return power

    def moved(self, rng: np.random.Generator, displacement_m: NDArray[np.float64]) -> ClusterChannel:
        """The same link after the vehicle moved by ``displacement_m`` (3,), metres, ENU.

        Phases turn by 2πf/c times the displacement along each path's direction; powers
        evolve as a first-order Gauss–Markov process with a distance of 12 m. A displacement
        of zero gives the same channel back. Delays, and with them the clusters, stay: redraw
        the channel when the obstruction changes.
        """
        distance_m = float(np.linalg.norm(displacement_m))
        if distance_m == 0.0:
            return self
        wavenumber_rad_m = 2 * np.pi * self.frequency_hz / SPEED_OF_LIGHT_M_S
        phase_rad = self.phase_rad + wavenumber_rad_m * (self.direction_enu @ displacement_m)
        keep = np.exp(-distance_m / EVOLUTION_DISTANCE_M)
        fresh = np.sqrt(1 - keep * keep)
        return replace(
            self,
            phase_rad=np.mod(phase_rad, 2 * np.pi),
            cluster_deviate=keep * self.cluster_deviate
            + fresh * rng.standard_normal(len(self.cluster_deviate)),
            subpath_deviate=keep * self.subpath_deviate
            + fresh * rng.standard_normal(len(self.subpath_deviate)),
        )

    def impulse_response(
        self,
        *,
        taps: int,
        tap_spacing_ns: float,
        bandwidth_hz: float,
        first_path_tap: float,
        snr_db: float,
        rng: np.random.Generator,
    ) -> NDArray[np.complex128]:
        """What a sounder reports: (taps,) complex, band-limited, with receiver noise.

        Each path becomes a raised-cosine pulse of ``bandwidth_hz``; noise is circular
        Gaussian, white within the same band. ``snr_db`` is the power of all paths (1)
        over the noise power of a tap. ``first_path_tap`` may be fractional and negative.
        """
        amplitude = np.sqrt(self.power) * np.exp(1j * self.phase_rad)
        centre = first_path_tap + self.delay_ns / tap_spacing_ns
        reach = int(np.ceil(PULSE_REACH * 1e9 / bandwidth_hz / tap_spacing_ns))
        if 2 * reach + 1 < taps:
            tap = np.rint(centre).astype(np.int64)[:, None] + np.arange(-reach, reach + 1)
        else:
            tap = np.broadcast_to(np.arange(taps), (len(amplitude), taps))
        pulses = raised_cosine((tap - centre[:, None]) * (tap_spacing_ns * 1e-9 * bandwidth_hz))
        inside = (tap >= 0) & (tap < taps)
        contribution = (pulses * amplitude[:, None])[inside]
        response = np.bincount(tap[inside], weights=contribution.real, minlength=taps) + 1j * np.bincount(
            tap[inside], weights=contribution.imag, minlength=taps
        )
        noise = band_limited_noise(taps, tap_spacing_ns, bandwidth_hz, rng)
        return response + 10 ** (-snr_db / 20) * noise


def draw_channel(
    rng: np.random.Generator,
    *,
    line_of_sight: bool,
    frequency_hz: float,
    first_path_direction_enu: NDArray[np.float64] | None = None,
    table: ClusterTable | None = None,
    first_path_gain_db: float = 0.0,
) -> ClusterChannel:
    """Draw the paths of one link from the urban-macrocell cluster statistics.

    ``first_path_direction_enu`` (3,) is where the first path comes from (the beacon, with a
    line of sight); uniform in azimuth where it is None. ``table`` and ``first_path_gain_db``
    replace the model's own constants, to train on channels unlike it.
    """
    table = table or (LOS_TABLE if line_of_sight else NLOS_TABLE)
    count = int(rng.integers(1, table.clusters_max + 1))
    subpaths = rng.integers(1, table.subpaths_max + 1, size=count)
    cluster = np.repeat(np.arange(count), subpaths)

    excess = 1 + table.excess_exponent_max * rng.random()
    ordinal = np.concatenate([np.arange(n) for n in subpaths])
    within_ns = (ordinal * 2 / SUBPATH_RASTER_BANDWIDTH_GHZ) ** excess
    gap_ns = np.sort(rng.exponential(table.inter_cluster_delay_ns, size=count))
    gap_ns -= gap_ns[0]
    last_within_ns = within_ns[np.cumsum(subpaths) - 1]
    start_ns = np.concatenate([[0.0], np.cumsum(gap_ns[1:] + last_within_ns[:-1] + VOID_INTERVAL_NS)])

    azimuth = rng.uniform(0, 2 * np.pi, size=count)[cluster] + np.deg2rad(8) * rng.standard_normal(
        len(cluster)
    )
    elevation = np.deg2rad(10) * rng.standard_normal(count)[cluster] + np.deg2rad(3) * rng.standard_normal(
        len(cluster)
    )
    direction = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1
    )
    if first_path_direction_enu is not None:
        direction[0] = first_path_direction_enu / np.linalg.norm(first_path_direction_enu)
    return ClusterChannel(
        line_of_sight=line_of_sight,
        frequency_hz=frequency_hz,
        delay_ns=start_ns[cluster] + within_ns,
        cluster=cluster,
        within_cluster_ns=within_ns,
        cluster_deviate=rng.standard_normal(count),
        subpath_deviate=rng.standard_normal(len(cluster)),
        phase_rad=rng.uniform(0, 2 * np.pi, size=len(cluster)),
        direction_enu=direction,
        table=table,
        first_path_gain_db=first_path_gain_db,
    )


def band_limited_noise(
    taps: int, tap_spacing_ns: float, bandwidth_hz: float, rng: np.random.Generator
) -> NDArray[np.complex128]:
    """(taps,) circular Gaussian noise of unit power per tap, confined to the sounder's band."""
    white = rng.standard_normal(taps) + 1j * rng.standard_normal(taps)
    frequency_hz = np.abs(np.fft.fftfreq(taps, tap_spacing_ns * 1e-9))
    edge = (frequency_hz - bandwidth_hz * (1 - ROLL_OFF) / 2) / (bandwidth_hz * ROLL_OFF)
    gain = np.sqrt(0.5 * (1 + np.cos(np.pi * np.clip(edge, 0, 1))))
    gain *= np.sqrt(0.5 / np.mean(gain**2))
    coloured: NDArray[np.complex128] = np.fft.ifft(np.fft.fft(white) * gain)
    return coloured


def raised_cosine(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Raised-cosine pulse, peak 1 at x = 0, x in units of 1/bandwidth (Nyquist's first criterion)."""
    denominator = 1 - (2 * ROLL_OFF * x) ** 2
    singular = np.abs(denominator) < 1e-9
    safe = np.where(singular, 1.0, denominator)
    pulse = np.sinc(x) * np.cos(np.pi * ROLL_OFF * x) / safe
    limit = np.pi / 4 * np.sinc(1 / (2 * ROLL_OFF))
    return np.where(singular, limit, pulse)
