"""Labelled channel data: rows in the paper's format, one file others can read.

Why: the classifier is trained on what this project can make anew from a seed. Rules kept
here: the same seed gives the same bytes (the archive carries no clock); rows are written as
they are made, so that memory does not grow with their number; a geometry (``log_id``) is a
link of consecutive captures, and data are split by it, never by row.

Two kinds. *Plain*: one sounder (:class:`sim_sitl.cir.Sounder` unless told), the cluster
model's own constants, noise from the link budget. *Randomised*: what the shipped classifier
is trained on: bandwidth, tap spacing, first-path offset, noise, delay scale, strength of the
direct path, cropped windows and the quantisation of SAR_CIR vary by link, independent of
the label, so that none of them gives it away.
"""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.domain.errors import InputError
from sim_sitl.cir import LOS_TABLE, NLOS_TABLE, ClusterChannel, ClusterTable, Sounder, draw_channel
from sim_sitl.cir_encoding import LOG_STEP_DB, CirEncoding, quantise, window_round_first_path

FREQUENCY_HZ = 867.5e6
DISTANCE_BANDS_M = ((10.0, 100.0, 0.5), (100.0, 150.0, 0.3), (150.0, 200.0, 0.2))
"""(from, to, share) of the paper's distance mix."""
NOISE_DENSITY_DBM_HZ = -174.0
PROCESSING_GAIN_DB = 30.0
"""Of a sounder that accumulates about a thousand symbols into one response."""
ELEVATION_BEAM_DEG = 45.0
SPEED_M_S = 8.0
CAPTURE_INTERVAL_S = 0.1
FORMAT_VERSION = 1


@dataclass(frozen=True, slots=True)
class DatasetOptions:
    """What kind of data to make."""

    sounder: Sounder = field(default_factory=Sounder)
    """Bandwidth, tap spacing and taps of the plain kind; ``taps`` of both."""
    packets_per_link: int = 4
    """Consecutive captures of one geometry."""
    randomise: bool = False
    """Domain randomisation, see the module's header."""


@dataclass(frozen=True, slots=True)
class _Geometry:
    """One link of the paper's rows: where the vehicle is, seen from the beacon at the origin."""

    position_enu_m: NDArray[np.float64]
    line_of_sight: bool
    transmit_power_dbm: float
    link_budget_db: float
    velocity_m_s: NDArray[np.float64]


def write_dataset(
    rows: int,
    seed: int,
    out: Path,
    progress: Callable[[int, int], None] | None = None,
    options: DatasetOptions | None = None,
) -> None:
    """Write ``rows`` labelled captures to ``out`` (NPZ). ``progress(done, rows)`` is called as it goes.

    Arrays: ``cir_magnitude`` (N, taps) float32, zero beyond ``window_taps`` (N,); ``label``
    (N,) ``LOS``/``NLOS``; ``tap_spacing_ns``, ``bandwidth_hz``, ``snr_db``,
    ``first_path_index`` (N,; NaN = not told); ``log_id`` and ``packet`` (N,); the paper's row fields
    ``x_m y_m z_m range_m los aoa_deg zoa_deg total_received_power_dbm link_budget_db``;
    scalars ``seed``, ``format_version``. Raises InputError for rows < 1 or a bad folder.
    """
    options = options or DatasetOptions()
    if rows < 1:
        raise InputError(f"--rows is {rows}; at least 1 is needed")
    if not out.parent.is_dir():
        raise InputError(f"the folder {out.parent} of --out does not exist; create it first")
    taps = options.sounder.taps
    columns = {name: np.empty(rows, kind) for name, kind in _COLUMNS.items()}
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".dataset-") as folder:
        cir_path = Path(folder) / "cir_magnitude.npy"
        cir = np.lib.format.open_memmap(cir_path, mode="w+", dtype=np.float32, shape=(rows, taps))
        row = 0
        for log_id in range((rows + options.packets_per_link - 1) // options.packets_per_link):
            # One stream of numbers per geometry: more rows leave the earlier ones as they were.
            rng = np.random.default_rng([seed, log_id])
            for packet, values in enumerate(_link_rows(rng, log_id, options)):
                if row == rows:
                    break
                magnitude = values.pop("cir_magnitude")
                cir[row] = magnitude
                for name, value in values.items():
                    columns[name][row] = value
                columns["packet"][row] = packet
                row += 1
            if progress is not None:
                progress(row, rows)
        cir.flush()
        del cir
        partial = Path(folder) / "partial.npz"
        columns |= {"seed": np.array(seed), "format_version": np.array(FORMAT_VERSION)}
        _write_npz(partial, cir_path, columns)
        partial.replace(out)


_COLUMNS: dict[str, str] = {
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
    "total_received_power_dbm": "f8",
    "link_budget_db": "f8",
}


def _link_rows(
    rng: np.random.Generator, log_id: int, options: DatasetOptions
) -> list[dict[str, NDArray[np.float32] | float | str]]:
    """All rows of one geometry."""
    # Labels alternate: balanced for any number of rows, and known before anything is drawn.
    geometry = _draw_geometry(rng, line_of_sight=log_id % 2 == 0)
    towards_beacon = -geometry.position_enu_m
    if options.randomise:
        sounder, table, gain_db = _random_domain(rng, options.sounder.taps, geometry.line_of_sight)
    else:
        sounder, table, gain_db = options.sounder, None, 0.0
    channel = draw_channel(
        rng,
        line_of_sight=geometry.line_of_sight,
        frequency_hz=FREQUENCY_HZ,
        first_path_direction_enu=towards_beacon,
        table=table,
        first_path_gain_db=gain_db,
    )
    if options.randomise:
        # Over the strongest path, as receivers are triggered: the same for either label.
        snr_db = float(rng.uniform(12, 40) - 10 * np.log10(channel.power.max()))
    else:
        noise_dbm = NOISE_DENSITY_DBM_HZ + 10 * np.log10(sounder.bandwidth_hz)
        snr_db = geometry.transmit_power_dbm + geometry.link_budget_db - noise_dbm + PROCESSING_GAIN_DB
    window = _random_window(rng, sounder) if options.randomise else (0, sounder.taps)
    encoding = CirEncoding(int(rng.integers(3))) if options.randomise else None
    first_path_told = not options.randomise or bool(rng.random() < 0.5)

    rows: list[dict[str, NDArray[np.float32] | float | str]] = []
    for packet in range(options.packets_per_link):
        if packet:
            channel = channel.moved(rng, geometry.velocity_m_s * CAPTURE_INTERVAL_S)
        position = geometry.position_enu_m + packet * CAPTURE_INTERVAL_S * geometry.velocity_m_s
        jitter = rng.normal(0, 0.5) if options.randomise else 0.0
        magnitude, first_path_index = _capture(channel, sounder, snr_db, window, encoding, jitter, rng)
        padded = np.zeros(options.sounder.taps, dtype=np.float32)
        padded[: len(magnitude)] = magnitude
        rows.append(
            {
                "cir_magnitude": padded,
                "label": "LOS" if geometry.line_of_sight else "NLOS",
                "log_id": log_id,
                "window_taps": len(magnitude),
                "tap_spacing_ns": sounder.tap_spacing_ns,
                "bandwidth_hz": sounder.bandwidth_hz,
                "snr_db": snr_db,
                "first_path_index": first_path_index if first_path_told else float("nan"),
                **_paper_fields(position, geometry),
            }
        )
    return rows


def _capture(
    channel: ClusterChannel,
    sounder: Sounder,
    snr_db: float,
    window: tuple[int, int],
    encoding: CirEncoding | None,
    jitter_taps: float,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], float]:
    """(magnitudes of the window, first path in taps from its start)."""
    first_tap, count = window
    first_path = sounder.first_path_tap - first_tap + jitter_taps
    response = channel.impulse_response(
        taps=count,
        tap_spacing_ns=sounder.tap_spacing_ns,
        bandwidth_hz=sounder.bandwidth_hz,
        first_path_tap=first_path,
        snr_db=snr_db,
        rng=rng,
    )
    if encoding is None:
        return np.abs(response), first_path
    scale, payload = quantise(response, encoding)
    if encoding is CirEncoding.U8_LOG_MAGNITUDE:
        return 10 ** (-np.frombuffer(payload, np.uint8) * LOG_STEP_DB / 20), first_path
    if encoding is CirEncoding.U16_MAGNITUDE:
        return np.frombuffer(payload, "<u2") * scale, first_path
    parts = np.frombuffer(payload, np.int8).reshape(-1, 2) * scale
    return np.hypot(parts[:, 0], parts[:, 1]), first_path


def _random_domain(
    rng: np.random.Generator, taps: int, line_of_sight: bool
) -> tuple[Sounder, ClusterTable, float]:
    """A sounder, the model's constants loosened, and the direct path's gain."""
    # Half of the links at the UWB default, which is what the simulator and phones sound with.
    if rng.random() < 0.5:
        bandwidth_hz, spacing_ns = 500e6, 1.0016
    else:
        bandwidth_hz = float(10 ** rng.uniform(np.log10(20e6), np.log10(900e6)))
        spacing_ns = 1e9 / bandwidth_hz / float(rng.uniform(1.0, 3.0))
    sounder = Sounder(bandwidth_hz, spacing_ns, taps, first_path_tap=float(rng.uniform(20, 0.8 * taps)))
    base = LOS_TABLE if line_of_sight else NLOS_TABLE
    if rng.random() < 0.5:
        return sounder, base, 0.0
    # Rooms scatter within tens of nanoseconds, cities within microseconds.
    scale = float(10 ** rng.uniform(np.log10(0.3), np.log10(3.0)))
    table = replace(
        base,
        inter_cluster_delay_ns=base.inter_cluster_delay_ns * scale,
        cluster_decay_ns=base.cluster_decay_ns * scale * float(rng.uniform(0.7, 1.4)),
        subpath_decay_ns=base.subpath_decay_ns * scale * float(rng.uniform(0.7, 1.4)),
        subpath_sigma_db=float(rng.uniform(3, 7)),
    )
    gain_db = float(rng.uniform(0, 10)) if line_of_sight else float(rng.uniform(-20, 0))
    return sounder, table, gain_db


def _random_window(rng: np.random.Generator, sounder: Sounder) -> tuple[int, int]:
    """The full response (one time in four), or a window round the first path."""
    if rng.random() < 0.25:
        return 0, sounder.taps
    taps = int(rng.choice([64, 64, 128, 256]))
    lead = int(rng.integers(4, 16))
    return window_round_first_path(sounder.taps, sounder.first_path_tap, taps, lead)


def _draw_geometry(rng: np.random.Generator, *, line_of_sight: bool) -> _Geometry:
    """Distance, height, losses and power as the paper draws them; loss values are ours."""
    band = DISTANCE_BANDS_M[int(rng.choice(3, p=[share for _, _, share in DISTANCE_BANDS_M]))]
    range_m = float(rng.uniform(band[0], band[1]))
    height_m = float(rng.uniform(0, min(20.0, 0.95 * range_m)))
    azimuth_rad = float(rng.uniform(0, 2 * np.pi))
    horizontal_m = float(np.sqrt(range_m**2 - height_m**2))
    position = np.array([horizontal_m * np.cos(azimuth_rad), horizontal_m * np.sin(azimuth_rad), height_m])

    free_space_1m_db = 20 * np.log10(4 * np.pi * FREQUENCY_HZ / 299_792_458.0)
    exponent, shadow_db = (2.0, 4.0) if line_of_sight else (2.9, 7.0)
    loss_db = free_space_1m_db + 10 * exponent * np.log10(range_m) + rng.normal(0, shadow_db)
    if not line_of_sight:
        foliage_db = 0.4 * rng.uniform(0, 10)
        penetration_db = rng.uniform(5, 20)
        loss_db += foliage_db + penetration_db
    elevation_deg = np.rad2deg(np.arcsin(height_m / range_m))
    antenna_db = -min(12 * (elevation_deg / ELEVATION_BEAM_DEG) ** 2, 20.0)

    moving = rng.random() < 0.5
    heading_rad = rng.uniform(0, 2 * np.pi)
    # A hovering vehicle still drifts by centimetres between captures.
    speed_m_s = SPEED_M_S if moving else 0.3
    velocity = speed_m_s * np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    return _Geometry(
        position, line_of_sight, float(rng.uniform(13, 18)), float(antenna_db - loss_db), velocity
    )


def _paper_fields(position_enu_m: NDArray[np.float64], geometry: _Geometry) -> dict[str, float]:
    """The paper's row without the response: LOS angles rounded to a degree, NLOS angles zero."""
    x, y, z = (float(value) for value in position_enu_m)
    range_m = float(np.linalg.norm(position_enu_m))
    azimuth_deg = zenith_deg = 0.0
    if geometry.line_of_sight:
        azimuth_deg = float(np.rint(np.rad2deg(np.arctan2(-y, -x)) % 360)) % 360
        zenith_deg = float(np.rint(np.rad2deg(np.arccos(-z / range_m))))
    return {
        "x_m": x,
        "y_m": y,
        "z_m": z,
        "range_m": range_m,
        "los": float(geometry.line_of_sight),
        "aoa_deg": azimuth_deg,
        "zoa_deg": zenith_deg,
        "total_received_power_dbm": geometry.transmit_power_dbm + geometry.link_budget_db,
        "link_budget_db": geometry.link_budget_db,
    }


def _write_npz(out: Path, cir_path: Path, columns: dict[str, NDArray[np.float64]]) -> None:
    """An NPZ whose bytes depend on the arrays alone: stored, with the archive format's first date."""
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as archive:
        with (
            archive.open(_entry("cir_magnitude"), "w", force_zip64=True) as target,
            cir_path.open("rb") as source,
        ):
            while block := source.read(1 << 20):
                target.write(block)
        for name in sorted(columns):
            with archive.open(_entry(name), "w", force_zip64=True) as target:
                np.lib.format.write_array(target, columns[name], allow_pickle=False)


def _entry(name: str) -> zipfile.ZipInfo:
    return zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
