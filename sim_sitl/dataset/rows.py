"""All rows of one geometry: the paper's fields and the responses.

Two kinds. *Plain* is the paper's: one sounder, NYUSIM's own constants, noise at −174 dBm/Hz
from the link budget, nothing quantised; responses are in √mW, so that the squares of a row add up to
its received power: noise is there before power integration, as the paper has it. *Randomised*
(:mod:`sim_sitl.dataset.randomisation`) is for training what ships; its scale means nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim_sitl.cir_encoding import LOG_STEP_DB, CirEncoding, quantise
from sim_sitl.dataset import varied_channel
from sim_sitl.dataset.blockage import draw_blockage
from sim_sitl.dataset.geometry import FREQUENCY_HZ, LinkGeometry, draw_geometry, reported_angles_deg
from sim_sitl.dataset.options import DatasetOptions
from sim_sitl.dataset.paths import Paths, nyusim_paths
from sim_sitl.dataset.randomisation import (
    VARIED_SHARE,
    draw_domain,
    draw_encoding,
    draw_paths,
    told_index,
    told_spacing_ns,
)
from sim_sitl.dataset.sounding import PULSE_ENERGY, clock_drift, noise, noiseless_response

NOISE_DENSITY_DBM_HZ = -174.0
PROCESSING_GAIN_DB = 30.0
"""Of a sounder that accumulates about a thousand symbols into one response."""
EQUAL_NOISE_SNR_DB = (10.0, 60.0)
"""All paths together over the noise of a tap, where it does not depend on the label."""
ELEVATION_BEAM_DEG = 45.0
"""Half-power elevation beamwidth; the azimuth's is 360°."""
ANTENNA_FLOOR_DB = 20.0
XPD_SIGMA_DB = 1.6
UPRIGHT = float(np.cos(np.pi / 6))
"""Least cosine of a phone's tilt in the plain data: at most 30° off the vehicle's polarisation (NYUSIM's
own data are co-polarised). In the randomised data it lies as it fell, scattered paths arrive about the
horizon, and both weaken the direct path more often than the others."""

COLUMNS: dict[str, str] = {
    "label": "U4",
    "log_id": "i8",
    "packet": "i4",
    "window_taps": "i4",
    "tap_spacing_ns": "f8",
    "bandwidth_hz": "f8",
    "snr_db": "f8",
    "first_path_index": "f8",
    "x_m": "f8",
    "y_m": "f8",
    "z_m": "f8",
    "range_m": "f8",
    "los": "i1",
    "aoa_deg": "f8",
    "zoa_deg": "f8",
    "transmit_power_dbm": "f8",
    "total_received_power_dbm": "f8",
    "link_budget_db": "f8",
    "foliage_db": "f8",
    "penetration_db": "f8",
    "blockage_state": "i1",
    "target_speed_m_s": "f8",
    "vehicle_speed_m_s": "f8",
}
"""Name and type of each array beside ``cir_magnitude``; units in the names."""


@dataclass(frozen=True, slots=True, eq=False)
class LinkRows:
    """One geometry's rows."""

    cir_magnitude: NDArray[np.float32]
    """(captures, taps), zero beyond ``window_taps``."""
    columns: dict[str, NDArray[np.generic]]
    """(captures,) each, by the names of COLUMNS."""


@dataclass(frozen=True, slots=True, eq=False)
class _Sounded:
    """What one link's sensor reports."""

    magnitude: NDArray[np.float64]
    """(captures, window)"""
    first_path_index: NDArray[np.float64]
    """(captures,) taps from the window's start; NaN = not told."""
    bandwidth_hz: float
    tap_spacing_ns: float
    snr_db: NDArray[np.float64] | float
    gain_db: NDArray[np.float64] | float
    """(captures,) received power over the large-scale one: fading, antenna, blocker, noise."""
    blockage_state: NDArray[np.int64] | int


def link_rows(rng: np.random.Generator, log_id: int, options: DatasetOptions) -> LinkRows:
    """Draw one geometry. Labels alternate: balanced for any number of rows."""
    captures, taps = options.packets_per_link, options.sounder.taps
    geometry = draw_geometry(rng, line_of_sight=log_id % 2 == 0, captures=captures)
    if not options.randomise:
        sounded = _plain(rng, geometry, options)
    elif rng.random() < VARIED_SHARE:
        sounded = _varied(rng, geometry, taps)
    else:
        sounded = _randomised(rng, geometry, taps)

    window = sounded.magnitude.shape[1]
    padded = np.zeros((captures, taps), np.float32)
    padded[:, :window] = sounded.magnitude
    azimuth_deg, zenith_deg = reported_angles_deg(geometry)
    budget_db = geometry.large_scale_gain_db + sounded.gain_db
    values = {
        "label": "LOS" if geometry.line_of_sight else "NLOS",
        "log_id": log_id,
        "packet": np.arange(captures),
        "window_taps": window,
        "tap_spacing_ns": told_spacing_ns(rng, sounded.tap_spacing_ns)
        if options.randomise
        else sounded.tap_spacing_ns,
        "bandwidth_hz": sounded.bandwidth_hz,
        "snr_db": sounded.snr_db,
        "first_path_index": sounded.first_path_index,
        "x_m": geometry.position_enu_m[:, 0],
        "y_m": geometry.position_enu_m[:, 1],
        "z_m": geometry.position_enu_m[:, 2],
        "range_m": geometry.range_m,
        "los": geometry.line_of_sight,
        "aoa_deg": azimuth_deg,
        "zoa_deg": zenith_deg,
        "transmit_power_dbm": geometry.transmit_power_dbm,
        "total_received_power_dbm": geometry.transmit_power_dbm + budget_db,
        "link_budget_db": budget_db,
        "foliage_db": geometry.foliage_db,
        "penetration_db": geometry.penetration_db,
        "blockage_state": sounded.blockage_state,
        "target_speed_m_s": geometry.target_speed_m_s,
        "vehicle_speed_m_s": geometry.vehicle_speed_m_s,
    }
    columns = {
        name: np.array(np.broadcast_to(np.asarray(values[name], kind), (captures,)))
        for name, kind in COLUMNS.items()
    }
    return LinkRows(padded, columns)


def antenna_gain_db(elevation_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the vehicle's array: 360° in azimuth, 45° in elevation about the horizon."""
    return -np.minimum(12 * (np.rad2deg(elevation_rad) / ELEVATION_BEAM_DEG) ** 2, ANTENNA_FLOOR_DB)


def _elevation_rad(geometry: LinkGeometry) -> float:
    """Of the beacon, seen from the vehicle: below the horizon."""
    return -float(np.arcsin(geometry.position_enu_m[0, 2] / geometry.range_m[0]))


def _plain(rng: np.random.Generator, geometry: LinkGeometry, options: DatasetOptions) -> _Sounded:
    sounder = options.sounder
    paths = nyusim_paths(rng, geometry)
    state, amplitude = _received(
        rng, geometry, paths, upright=UPRIGHT, mean_elevation_rad=_elevation_rad(geometry)
    )
    captures = len(amplitude)
    first_path = np.full(captures, sounder.first_path_tap)
    clean = noiseless_response(paths.delay_ns, amplitude, sounder, first_path, sounder.taps)
    power = np.sum(np.abs(amplitude) ** 2, axis=1)
    level_dbm = geometry.transmit_power_dbm + geometry.large_scale_gain_db
    floor_dbm = NOISE_DENSITY_DBM_HZ + 10 * np.log10(sounder.bandwidth_hz) - PROCESSING_GAIN_DB
    if options.equal_noise:
        floor_dbm = level_dbm + 10 * np.log10(power.mean()) - float(rng.uniform(*EQUAL_NOISE_SNR_DB))
    noise_over_level = 10 ** ((floor_dbm - level_dbm) / 20)
    response = clean + noise_over_level[:, None] * noise(rng, captures, sounder.taps, sounder)
    # Samples per 1/bandwidth times the pulse's energy: what one path of unit power adds up to.
    path_energy = PULSE_ENERGY / (sounder.tap_spacing_ns * 1e-9 * sounder.bandwidth_hz)
    magnitude = np.abs(response) / np.sqrt(path_energy)
    return _Sounded(
        magnitude=magnitude * 10 ** (level_dbm / 20)[:, None],
        first_path_index=first_path,
        bandwidth_hz=sounder.bandwidth_hz,
        tap_spacing_ns=sounder.tap_spacing_ns,
        snr_db=10 * np.log10(power) + level_dbm - floor_dbm,
        gain_db=10 * np.log10(np.sum(magnitude**2, axis=1)),
        blockage_state=state,
    )


def _randomised(rng: np.random.Generator, geometry: LinkGeometry, taps: int) -> _Sounded:
    domain = draw_domain(rng, taps)
    if domain.static:
        geometry = replace(
            geometry, position_enu_m=np.repeat(geometry.position_enu_m[:1], len(geometry.position_enu_m), 0)
        )
    paths = draw_paths(rng, geometry)
    state, amplitude = _received(rng, geometry, paths, upright=0.0, mean_elevation_rad=0.0)
    captures = len(amplitude)
    first_tap, count = domain.window
    sounder = domain.sounder
    first_path = sounder.first_path_tap - first_tap + domain.jitter_taps * rng.standard_normal(captures)
    response = noiseless_response(paths.delay_ns, amplitude, sounder, first_path, count, domain.pulse)
    if domain.drift:
        response = clock_drift(response, domain.drift)
    if np.isfinite(domain.snr_db):
        strongest = np.sqrt(np.mean(np.max(np.abs(amplitude) ** 2, axis=1)))
        floor = strongest * 10 ** (-domain.snr_db / 20)
        response = response + floor * noise(rng, captures, count, sounder, domain.pulse)
    return _Sounded(
        magnitude=np.array([_as_decoded(values, domain.encoding) for values in response]),
        first_path_index=told_index(rng, domain, first_path),
        bandwidth_hz=sounder.bandwidth_hz,
        tap_spacing_ns=sounder.tap_spacing_ns,
        snr_db=domain.snr_db,
        gain_db=10 * np.log10(np.sum(np.abs(amplitude) ** 2, axis=1)),
        blockage_state=state,
    )


def _varied(rng: np.random.Generator, geometry: LinkGeometry, taps: int) -> _Sounded:
    captures = len(geometry.position_enu_m)
    paths = varied_channel.draw_paths(rng, line_of_sight=geometry.line_of_sight)
    receiver = varied_channel.draw_receiver(rng, taps)
    jitter_taps = float(rng.uniform(0, 1.0)) * rng.standard_normal(captures)
    encoding = draw_encoding(rng)
    if encoding is CirEncoding.I8_IQ:
        encoding = None  # it has magnitudes only
    told = bool(rng.random() < 0.5)
    responses = [varied_channel.capture(paths, receiver, rng, jitter) for jitter in jitter_taps]
    return _Sounded(
        magnitude=np.array([_as_decoded(values, encoding) for values in responses]),
        first_path_index=receiver.first_path_tap + jitter_taps if told else np.full(captures, np.nan),
        bandwidth_hz=receiver.bandwidth_hz,
        tap_spacing_ns=receiver.tap_spacing_ns,
        snr_db=receiver.peak_snr_db,
        gain_db=0.0,
        blockage_state=0,
    )


def _received(
    rng: np.random.Generator,
    geometry: LinkGeometry,
    paths: Paths,
    *,
    upright: float,
    mean_elevation_rad: float,
) -> tuple[NDArray[np.int64], NDArray[np.complex128]]:
    """(blockage state (captures,), amplitudes (captures, paths)) behind blocker, antenna and polarisation.

    The phone's tilt has a cosine of at least ``upright``; scattered paths arrive about
    ``mean_elevation_rad``.
    """
    clusters = int(paths.cluster[-1]) + 1
    departure = rng.uniform(-np.pi, np.pi, clusters)[paths.cluster]
    if geometry.line_of_sight:
        x, y, _ = geometry.position_enu_m[0]
        departure[0] = np.arctan2(y, x)
    blockage = draw_blockage(rng, departure, len(paths.amplitude))
    elevation = np.arcsin(np.clip(paths.direction_enu[:, 2], -1, 1))
    elevation[int(geometry.line_of_sight) :] += mean_elevation_rad
    gain_db = antenna_gain_db(elevation) - blockage.loss_db

    # Of each path the vehicle's antenna gets the part along it, and of the other part what
    # scattering turned (cross-polarisation discrimination).
    along = upright + (1 - upright) * float(rng.uniform(0, 1))
    mean_db = (
        11.5 + 0.10 * FREQUENCY_HZ * 1e-9 if geometry.line_of_sight else 5.5 + 0.13 * FREQUENCY_HZ * 1e-9
    )
    xpd_db = rng.normal(mean_db, XPD_SIGMA_DB, len(paths.delay_ns))
    turned = np.exp(2j * np.pi * rng.random(len(paths.delay_ns))) * 10 ** (-xpd_db / 20)
    polarisation = along + np.sqrt(1 - along * along) * turned
    return blockage.state, paths.amplitude * 10 ** (gain_db / 20) * polarisation


def _as_decoded(
    response: NDArray[np.complex128] | NDArray[np.float64], encoding: CirEncoding | None
) -> NDArray[np.float64]:
    """(taps,) magnitudes of one capture after the wire."""
    if encoding is None:
        return np.abs(response)
    scale, payload = quantise(response, encoding)
    if encoding is CirEncoding.U8_LOG_MAGNITUDE:
        below_db = np.frombuffer(payload, np.uint8) * LOG_STEP_DB
        decoded: NDArray[np.float64] = 10 ** (-below_db / 20)
    elif encoding is CirEncoding.U16_MAGNITUDE:
        decoded = np.frombuffer(payload, "<u2") * scale
    else:
        parts = np.frombuffer(payload, np.int8).reshape(-1, 2) * scale
        decoded = np.hypot(parts[:, 0], parts[:, 1])
    return decoded
