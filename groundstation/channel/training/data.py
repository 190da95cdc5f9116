"""Labelled responses from a file → inputs of the network, by link, split by geometry.

Why: what ``sim-sitl dataset`` writes and what a user measured are read alike. Rules kept
here: everything that can be wrong with a file is said before any work is done; responses
are read in blocks; links are split by ``log_id`` (a geometry), never by row.
"""

from __future__ import annotations

import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from groundstation.channel.capture import ChannelCapture, UnusableCaptureError
from groundstation.channel.preprocess import INPUT_BINS, INPUT_CHANNELS, network_input
from groundstation.channel.settings import ChannelSettings
from groundstation.domain.errors import InputError

CSV_FIELDS = ("X", "Y", "Z", "Range", "LOS", "AOA", "ZOA", "TotalReceivedPower", "LinkBudget")
"""The paper's columns before CIR0, CIR1, …"""
UNKNOWN_SPACING_NS = 1.0
"""Where a file does not say."""
_BLOCK_ROWS = 2048
_MIN_TAPS = 16


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The columns of a file beside the responses, checked."""

    is_los: NDArray[np.bool_]
    """(rows,)"""
    group: NDArray[np.int64]
    """(rows,) geometry; the row's own number where the file has no ``log_id``."""
    link: NDArray[np.int64]
    """(rows,) link: consecutive captures of one geometry."""
    tap_spacing_ns: NDArray[np.float64]
    """(rows,)"""
    window_taps: NDArray[np.int64]
    """(rows,) taps that hold data."""
    first_path_index: NDArray[np.float64]
    """(rows,) NaN = unknown."""
    bandwidth_hz: NDArray[np.float64]
    """(rows,) NaN = unknown; for the card's figures only."""
    grouped: bool
    """Whether the file has ``log_id``."""


@dataclass(frozen=True, slots=True, eq=False)
class LinkData:
    """Inputs of the network by link."""

    inputs: NDArray[np.float32]
    """(captures, channels, bins)"""
    first: NDArray[np.int64]
    """(links,) a link's first capture in ``inputs``."""
    packets: NDArray[np.int64]
    """(links,) its captures, oldest first."""
    is_los: NDArray[np.bool_]
    """(links,)"""
    group: NDArray[np.int64]
    """(links,)"""
    bandwidth_hz: NDArray[np.float64]
    """(links,)"""
    window_taps: NDArray[np.int64]
    """(links,)"""
    left_out: dict[str, int]
    """Captures that cannot be judged, by reason."""
    grouped: bool

    def __len__(self) -> int:
        return len(self.first)

    def batch(self, links: NDArray[np.int64], packets: int, skip: NDArray[np.int64]) -> NDArray[np.float32]:
        """(links, packets, channels, bins): ``packets`` captures of each link after its first ``skip``."""
        rows = (self.first[links] + skip)[:, None] + np.arange(packets)
        inputs: NDArray[np.float32] = self.inputs[rows]
        return inputs


def read_links(path: Path, progress: Callable[[int, int], None] | None = None) -> LinkData:
    """Read a NPZ or CSV of labelled responses. Raises InputError saying what is wrong."""
    if not path.is_file():
        raise InputError(f"{path} is not a file; a NPZ or CSV of labelled responses is needed")
    if path.suffix.lower() == ".csv":
        table, blocks = _open_csv(path)
    else:
        table, blocks = _open_npz(path)
    return _preprocess(table, blocks, progress)


def split_by_group(
    data: LinkData, shares: tuple[float, float, float], seed: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Links for training, validation and test: whole groups, both classes in each.

    Shuffles of the groups are tried in turn until each part has both classes. Raises
    InputError where a hundred do not.
    """
    groups = np.unique(data.group)
    if len(groups) < 3:
        raise InputError(f"the file has {len(groups)} group(s) (log_id); at least 3 are needed to split by")
    for attempt in range(100):
        order = np.random.default_rng([seed, attempt]).permutation(groups)
        cut = np.clip(np.rint(np.cumsum(shares)[:2] * len(groups)).astype(int), 1, len(groups) - 1)
        parts = [np.flatnonzero(np.isin(data.group, part)) for part in np.split(order, cut)]
        if all(len(part) and 0 < np.count_nonzero(data.is_los[part]) < len(part) for part in parts):
            return parts[0], parts[1], parts[2]
    raise InputError(
        f"the {len(groups)} groups (log_id) cannot be split so that training, validation and test "
        "each have both classes; more groups with LOS and with NLOS are needed"
    )


def _open_npz(path: Path) -> tuple[Table, Iterator[NDArray[np.float64]]]:
    if not zipfile.is_zipfile(path):
        raise InputError(f"{path} is not a NPZ file (a zip archive of arrays); a NPZ or CSV is needed")
    try:
        with np.load(path, allow_pickle=False) as archive:
            names = set(archive.files)
            for needed in ("cir_magnitude", "label"):
                if needed not in names:
                    raise InputError(f"{path} has no array '{needed}'; it has {', '.join(sorted(names))}")
            with zipfile.ZipFile(path) as zipped, zipped.open("cir_magnitude.npy") as member:
                shape, _, _ = _npy_header(member, path)
            rows = shape[0]
            columns = {
                name: np.asarray(archive[name])
                for name in (
                    "label",
                    "log_id",
                    "packet",
                    "tap_spacing_ns",
                    "window_taps",
                    "first_path_index",
                    "bandwidth_hz",
                )
                if name in names
            }
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} cannot be read as arrays: {error}") from error
    return _table(columns, rows, shape[1], path), _npz_blocks(path)


def _npy_header(member: IO[bytes], path: Path) -> tuple[tuple[int, int], bool, np.dtype[np.generic]]:
    version = np.lib.format.read_magic(member)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, kind = read(member)
    if len(shape) != 2 or shape[0] < 1 or shape[1] < _MIN_TAPS:
        raise InputError(
            f"{path}: cir_magnitude has shape {shape}; (N, taps) with at least {_MIN_TAPS} taps is needed"
        )
    if kind.kind not in "fiu" or fortran:
        raise InputError(f"{path}: cir_magnitude has type {kind}; real numbers in C order are needed")
    return (shape[0], shape[1]), fortran, kind


def _npz_blocks(path: Path) -> Iterator[NDArray[np.float64]]:
    with zipfile.ZipFile(path) as zipped, zipped.open("cir_magnitude.npy") as member:
        (rows, taps), _, kind = _npy_header(member, path)
        for start in range(0, rows, _BLOCK_ROWS):
            count = min(_BLOCK_ROWS, rows - start)
            raw = member.read(count * taps * kind.itemsize)
            if len(raw) != count * taps * kind.itemsize:
                raise InputError(f"{path}: cir_magnitude ends after {start} of {rows} rows")
            yield np.frombuffer(raw, kind).reshape(count, taps).astype(np.float64)


def _open_csv(path: Path) -> tuple[Table, Iterator[NDArray[np.float64]]]:
    try:
        with path.open(encoding="utf-8") as lines:
            header = lines.readline().strip().split(",")
        has_header = not _is_number(header[0])
        values = np.loadtxt(path, delimiter=",", skiprows=int(has_header), ndmin=2)
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not a CSV of numbers: {error}") from error
    named = [name.strip().strip('"') for name in header[: len(CSV_FIELDS)]]
    if has_header and [name.lower() for name in named] != [name.lower() for name in CSV_FIELDS]:
        raise InputError(
            f"{path}: the columns begin with {', '.join(named)}; needed: {', '.join(CSV_FIELDS)}"
        )
    taps = values.shape[1] - len(CSV_FIELDS)
    if taps < _MIN_TAPS or not len(values):
        raise InputError(
            f"{path} has {max(taps, 0)} CIR columns in {len(values)} rows; at least {_MIN_TAPS} are needed"
        )
    columns = {"label": values[:, CSV_FIELDS.index("LOS")]}
    cir = values[:, len(CSV_FIELDS) :]
    blocks = (cir[start : start + _BLOCK_ROWS] for start in range(0, len(cir), _BLOCK_ROWS))
    return _table(columns, len(cir), taps, path), blocks


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _table(columns: Mapping[str, NDArray[np.generic]], rows: int, taps: int, path: Path) -> Table:
    def column(name: str, default: float) -> NDArray[np.float64]:
        given = columns.get(name)
        if given is None:
            return np.full(rows, default)
        if given.dtype.kind not in "fiub" or given.shape not in {(), (rows,)}:
            raise InputError(
                f"{path}: {name} has shape {given.shape} and type {given.dtype}; ({rows},) numbers are needed"
            )
        return np.broadcast_to(given.astype(np.float64), (rows,))

    label = columns["label"]
    if label.shape != (rows,):
        raise InputError(f"{path}: label has shape {label.shape}, cir_magnitude {rows} rows; they must agree")
    if label.dtype.kind == "U":
        is_los = np.char.upper(np.char.strip(label.astype(np.str_))) == "LOS"
    elif label.dtype.kind in "fiub":
        if not np.all(np.isfinite(label.astype(np.float64))):
            raise InputError(f"{path}: label has NaN; LOS or 1 against everything else is needed")
        is_los = label.astype(np.float64) == 1
    else:
        raise InputError(f"{path}: label has type {label.dtype}; text or numbers are needed")
    los = int(np.count_nonzero(is_los))
    if los in {0, rows}:
        raise InputError(f"{path}: all {rows} labels are {'LOS' if los else 'NLOS'}; both classes are needed")

    spacing = column("tap_spacing_ns", UNKNOWN_SPACING_NS)
    if not (np.all(np.isfinite(spacing)) and np.all(spacing > 0)):
        raise InputError(f"{path}: tap_spacing_ns has values that are not positive")
    window = column("window_taps", taps)
    if not (np.all(window >= 1) and np.all(window <= taps)):
        raise InputError(f"{path}: window_taps is outside 1…{taps}")
    grouped = "log_id" in columns
    if grouped and columns["log_id"].shape == (rows,):
        group = np.unique(columns["log_id"], return_inverse=True)[1].astype(np.int64)
    elif grouped:
        raise InputError(f"{path}: log_id has shape {columns['log_id'].shape}; ({rows},) is needed")
    else:
        group = np.arange(rows)
    link = np.arange(rows)
    if "packet" in columns:
        packet = column("packet", 0)
        follows = (np.diff(packet) == 1) & (np.diff(group) == 0) & (is_los[1:] == is_los[:-1])
        link = np.concatenate([[0], np.cumsum(~follows)])
    return Table(
        is_los=is_los,
        group=group,
        link=link,
        tap_spacing_ns=spacing,
        window_taps=window.astype(np.int64),
        first_path_index=column("first_path_index", np.nan),
        bandwidth_hz=column("bandwidth_hz", np.nan),
        grouped=grouped,
    )


def _preprocess(
    table: Table, blocks: Iterator[NDArray[np.float64]], progress: Callable[[int, int], None] | None
) -> LinkData:
    rows = len(table.is_los)
    settings = ChannelSettings()
    inputs = np.empty((rows, INPUT_CHANNELS, INPUT_BINS), np.float32)
    kept: list[int] = []
    left_out: Counter[str] = Counter()
    row = 0
    for block in blocks:
        if not np.all(np.isfinite(block)):
            bad = row + int(np.argmax(~np.isfinite(block).all(axis=1)))
            raise InputError(
                f"cir_magnitude has NaN or infinity, first in row {bad}; finite magnitudes are needed"
            )
        if np.any(block < 0):
            bad = row + int(np.argmax((block < 0).any(axis=1)))
            raise InputError(f"cir_magnitude is negative, first in row {bad}; magnitudes are needed")
        for values in block:
            told = float(table.first_path_index[row])
            capture = ChannelCapture(
                values[: table.window_taps[row]],
                float(table.tap_spacing_ns[row]),
                told if np.isfinite(told) else None,
            )
            try:
                inputs[len(kept)] = network_input(capture, settings)
            except UnusableCaptureError as error:
                left_out[str(error).split(":")[0]] += 1
            else:
                kept.append(row)
            row += 1
        if progress is not None:
            progress(row, rows)
    usable = np.array(kept, dtype=np.int64)
    if 2 * len(usable) < rows:
        raise InputError(f"{rows - len(usable)} of {rows} responses cannot be used: {dict(left_out)}")
    _, first, packets = np.unique(table.link[usable], return_index=True, return_counts=True)
    rows_of_links = usable[first]
    is_los = table.is_los[rows_of_links]
    if np.all(is_los) or not np.any(is_los):
        raise InputError(f"of the usable responses all are of one class; left out: {dict(left_out)}")
    return LinkData(
        inputs=inputs[: len(usable)],
        first=first.astype(np.int64),
        packets=packets.astype(np.int64),
        is_los=is_los,
        group=table.group[rows_of_links],
        bandwidth_hz=table.bandwidth_hz[rows_of_links],
        window_taps=table.window_taps[rows_of_links],
        left_out=dict(sorted(left_out.items())),
        grouped=table.grouped,
    )
