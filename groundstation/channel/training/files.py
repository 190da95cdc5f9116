"""Labelled responses in a file: NPZ or CSV, ours or a stranger's.

Why: what ``sim-sitl dataset`` writes and what a user measured are read alike. Rules kept
here: liberal in what names and shapes it takes, but everything that can be wrong with the columns is
said, with what was seen and what is needed, before any work is done; an NPZ's responses are
read in blocks.
"""

from __future__ import annotations

import itertools
import re
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from groundstation.domain.errors import InputError

CSV_FIELDS = ("X", "Y", "Z", "Range", "LOS", "AOA", "ZOA", "TotalReceivedPower", "LinkBudget")
"""The paper's columns before CIR0, CIR1, …; a CSV without a header has them in this order."""
UNKNOWN_SPACING_NS = 1.0
"""Where neither the file nor the caller says."""
ROWS_MIN = 20
"""Fewer cannot be split into training, validation and test."""
STEP_MAX_M = 2.0
"""A CSV row of the same label and so close to the row before is the same link, further on."""
CAPTURES_MAX = 8
"""Of one link; a longer run of captures is several links of one geometry."""
_BLOCK_ROWS = 2048
_TAPS_MIN = 16
_OPTIONAL = ("log_id", "packet", "tap_spacing_ns", "window_taps", "first_path_index", "bandwidth_hz")
_LABEL_WORDS = {"los": 1.0, "nlos": 0.0, "true": 1.0, "false": 0.0}


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The columns of a file beside the responses, checked."""

    is_los: NDArray[np.bool_]
    """(rows,)"""
    group: NDArray[np.int64]
    """(rows,) geometry; the row's own number where the file does not say."""
    link: NDArray[np.int64]
    """(rows,) link: consecutive captures of one geometry, at most CAPTURES_MAX."""
    tap_spacing_ns: NDArray[np.float64]
    """(rows,)"""
    window_taps: NDArray[np.int64]
    """(rows,) taps that hold data."""
    first_path_index: NDArray[np.float64]
    """(rows,) NaN = unknown."""
    bandwidth_hz: NDArray[np.float64]
    """(rows,) NaN = unknown; for the card's figures only."""
    grouped: bool
    """Whether the file tells which rows are of one geometry."""


Blocks = Iterator[NDArray[np.float64]]
"""(n, taps) responses in order."""


def open_file(path: Path, tap_spacing_ns: float | None = None) -> tuple[Table, Blocks]:
    """Check a file's columns; its responses come block by block.

    ``tap_spacing_ns`` holds where the file does not say. Raises InputError.
    """
    if not path.is_file():
        raise InputError(f"{path} is not a file; a NPZ or CSV of labelled responses is needed")
    if tap_spacing_ns is not None and not (np.isfinite(tap_spacing_ns) and tap_spacing_ns > 0):
        raise InputError(f"the tap spacing is {tap_spacing_ns} ns; a positive number is needed")
    spacing = UNKNOWN_SPACING_NS if tap_spacing_ns is None else tap_spacing_ns
    if path.suffix.lower() == ".csv":
        return _open_csv(path, spacing)
    return _open_npz(path, spacing)


# ── NPZ ───────────────────────────────────────────────────────────────────────────────────────


def _open_npz(path: Path, spacing_ns: float) -> tuple[Table, Blocks]:
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
            columns = {name: np.asarray(archive[name]) for name in ("label", *_OPTIONAL) if name in names}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} cannot be read as arrays: {error}") from error
    return _table(columns, *shape, path, spacing_ns), _npz_blocks(path)


def _npy_header(member: IO[bytes], path: Path) -> tuple[tuple[int, int], bool, np.dtype[np.generic]]:
    version = np.lib.format.read_magic(member)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, kind = read(member)
    if len(shape) != 2 or shape[1] < _TAPS_MIN:
        raise InputError(
            f"{path}: cir_magnitude has shape {shape}; (N, taps) with at least {_TAPS_MIN} taps is needed"
        )
    if kind.kind not in "fiu":
        raise InputError(f"{path}: cir_magnitude has type {kind}; real numbers (magnitudes) are needed")
    return (shape[0], shape[1]), fortran, kind


def _npz_blocks(path: Path) -> Blocks:
    with zipfile.ZipFile(path) as zipped, zipped.open("cir_magnitude.npy") as member:
        (rows, taps), fortran, kind = _npy_header(member, path)
        if fortran:
            with np.load(path, allow_pickle=False) as archive:
                whole = np.asarray(archive["cir_magnitude"])
            yield from (
                whole[start : start + _BLOCK_ROWS].astype(np.float64) for start in range(0, rows, _BLOCK_ROWS)
            )
            return
        for start in range(0, rows, _BLOCK_ROWS):
            count = min(_BLOCK_ROWS, rows - start)
            try:
                raw = member.read(count * taps * kind.itemsize)
            except (zipfile.BadZipFile, OSError, EOFError) as error:
                raise InputError(f"{path} is damaged: {error}") from error
            if len(raw) != count * taps * kind.itemsize:
                raise InputError(f"{path}: cir_magnitude ends after {start} of {rows} rows")
            yield np.frombuffer(raw, kind).reshape(count, taps).astype(np.float64)


# ── CSV ───────────────────────────────────────────────────────────────────────────────────────


def _open_csv(path: Path, spacing_ns: float) -> tuple[Table, Blocks]:
    if zipfile.is_zipfile(path):
        raise InputError(f"{path} is a zip archive (a NPZ?) and no CSV; name it .npz if it is one")
    try:
        with path.open(encoding="utf-8-sig") as lines:
            first = lines.readline().rstrip("\r\n")
            if not first.strip():
                raise InputError(f"{path} is empty or begins with an empty line; rows of numbers are needed")
            delimiter = next((mark for mark in ",;\t" if mark in first), ",")
            cells = [cell.strip().strip('"').strip() for cell in first.split(delimiter)]
            has_header = not any(_is_number(cell) for cell in cells)
            place, taps_at = _columns_by_name(cells, path) if has_header else _columns_by_order(cells, path)
            if not has_header:
                lines.seek(0)
            blocks = list(_csv_blocks(lines, delimiter, len(cells), place["label"], path, int(has_header)))
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a CSV of numbers: {error}") from error
    if not blocks:
        raise InputError(f"{path} has no rows; at least {ROWS_MIN} are needed")
    columns: dict[str, NDArray[np.generic]] = {
        name: np.concatenate([block[:, at] for block in blocks]) for name, at in place.items()
    }
    label = columns["label"].astype(np.float64)
    strange = np.unique(label[~np.isin(label, (0.0, 1.0))])
    if len(strange):
        raise InputError(
            f"{path}: the LOS column has {', '.join(f'{value:g}' for value in strange[:5])}; 1 or 0 is needed"
        )
    if "log_id" not in columns:
        columns |= _by_position(columns)
    rows = len(label)
    cir = (block[:, taps_at].astype(np.float64) for block in blocks)
    return _table(columns, rows, len(taps_at), path, spacing_ns), cir


def _columns_by_name(cells: list[str], path: Path) -> tuple[dict[str, int], list[int]]:
    """(place of each known column, places of the taps in their order) of a header."""
    plain = [re.sub(r"[^a-z0-9]", "", cell.lower()) for cell in cells]
    taps = sorted(
        (int(match[1]), place)
        for place, name in enumerate(plain)
        if (match := re.fullmatch(r"cir(\d+)", name))
    )
    if "los" not in plain or len(taps) < _TAPS_MIN:
        raise InputError(
            f"{path}: the header begins with {', '.join(cells[:10])} and has {len(taps)} CIR columns; "
            f"needed: {', '.join(CSV_FIELDS)}, CIR0 … with at least {_TAPS_MIN} taps"
        )
    known = {"label": "los", "x": "x", "y": "y", "z": "z"} | {
        name: name.replace("_", "") for name in _OPTIONAL
    }
    place = {name: plain.index(text) for name, text in known.items() if text in plain}
    return place, [at for _, at in taps]


def _columns_by_order(cells: list[str], path: Path) -> tuple[dict[str, int], list[int]]:
    """The paper's order."""
    taps = len(cells) - len(CSV_FIELDS)
    if taps < _TAPS_MIN:
        raise InputError(
            f"{path} has {max(taps, 0)} CIR columns after the paper's {len(CSV_FIELDS)} "
            f"({', '.join(CSV_FIELDS)}); at least {_TAPS_MIN} are needed"
        )
    place = {"label": CSV_FIELDS.index("LOS"), "x": 0, "y": 1, "z": 2}
    return place, list(range(len(CSV_FIELDS), len(cells)))


def _csv_blocks(
    lines: IO[str], delimiter: str, columns: int, label_at: int, path: Path, header_lines: int
) -> Iterator[NDArray[np.float32]]:
    start = header_lines
    while chunk := list(itertools.islice(lines, _BLOCK_ROWS)):
        rows = [line for line in chunk if line.strip()]
        if rows:
            try:
                block = np.loadtxt(
                    rows, np.float64, delimiter=delimiter, ndmin=2, comments=None, quotechar='"',
                    converters={label_at: _label_number},
                )  # fmt: skip
            except ValueError as error:
                raise InputError(f"{path} is not a CSV of numbers: {_told(error, start)}") from error
            if block.shape[1] != columns:
                raise InputError(
                    f"{path}: line {start + 1} has {block.shape[1]} columns, the first line {columns}"
                )
            yield block.astype(np.float32)
        start += len(chunk)


def _told(error: ValueError, lines_before: int) -> str:
    """numpy's words, with the file's line instead of the block's row."""
    text = str(error).split(";")[0]
    # NumPy counts rows from 1 where their width changes, and from 0 elsewhere.
    first = lines_before + ("columns changed" not in text)
    return re.sub(r"at row (\d+)", lambda match: f"in line {int(match[1]) + first}", text)


def _label_number(text: str) -> float:
    word = text.strip().strip('"').lower()
    return _LABEL_WORDS[word] if word in _LABEL_WORDS else float(text)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _by_position(columns: Mapping[str, NDArray[np.generic]]) -> dict[str, NDArray[np.generic]]:
    """``log_id`` and ``packet`` of consecutive rows of one label whose positions follow one another."""
    if not {"x", "y", "z"} <= columns.keys():
        return {}
    position = np.stack([columns[name].astype(np.float64) for name in ("x", "y", "z")], axis=1)
    label = columns["label"].astype(np.float64)
    if not np.all(np.isfinite(position)) or np.all(position == position[0]):
        return {}
    near = np.linalg.norm(np.diff(position, axis=0), axis=1) <= STEP_MAX_M
    follows = near & (np.diff(label) == 0)
    if not np.any(follows):
        return {}
    group = np.concatenate([[0], np.cumsum(~follows)])
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    return {"log_id": group, "packet": np.arange(len(group)) - starts[group]}


# ── both ──────────────────────────────────────────────────────────────────────────────────────


def _table(
    columns: Mapping[str, NDArray[np.generic]], rows: int, taps: int, path: Path, spacing_ns: float
) -> Table:
    def column(name: str, default: float) -> NDArray[np.float64]:
        given = columns.get(name)
        if given is None:
            return np.full(rows, default)
        if given.dtype.kind not in "fiub" or given.shape not in {(), (rows,)}:
            raise InputError(
                f"{path}: {name} has shape {given.shape} and type {given.dtype}; ({rows},) numbers are needed"
            )
        return np.broadcast_to(given.astype(np.float64), (rows,))

    if rows < ROWS_MIN:
        raise InputError(f"{path} has {rows} rows; at least {ROWS_MIN} are needed")
    is_los = _labels(columns["label"], rows, path)
    spacing = column("tap_spacing_ns", spacing_ns)
    if not (np.all(np.isfinite(spacing)) and np.all(spacing > 0)):
        raise InputError(f"{path}: tap_spacing_ns has values that are not positive")
    window = column("window_taps", taps)
    if not (np.all(window >= 1) and np.all(window <= taps)):
        raise InputError(f"{path}: window_taps is outside 1…{taps}")
    grouped = "log_id" in columns
    group = np.arange(rows)
    if grouped:
        log_id = columns["log_id"]
        if log_id.shape != (rows,):
            raise InputError(f"{path}: log_id has shape {log_id.shape}; ({rows},) is needed")
        if log_id.dtype.kind == "f" and not np.all(np.isfinite(log_id.astype(np.float64))):
            raise InputError(f"{path}: log_id has NaN; every row needs its geometry")
        group = np.unique(log_id, return_inverse=True)[1].astype(np.int64)
    link = np.arange(rows)
    if "packet" in columns:
        packet = column("packet", 0)
        follows = (np.diff(packet) == 1) & (np.diff(group) == 0) & (is_los[1:] == is_los[:-1])
        run = np.concatenate([[0], np.cumsum(~follows)])
        within = np.arange(rows) - np.flatnonzero(np.diff(run, prepend=-1))[run]
        begins = (within % CAPTURES_MAX) == 0
        link = np.cumsum(begins) - 1
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


def _labels(label: NDArray[np.generic], rows: int, path: Path) -> NDArray[np.bool_]:
    """(rows,) LOS or 1 against everything else."""
    if label.shape != (rows,):
        raise InputError(f"{path}: label has shape {label.shape}, cir_magnitude {rows} rows; they must agree")
    if label.dtype.kind == "S":
        label = np.char.decode(label.astype(np.bytes_), "utf-8", "replace")
    if label.dtype.kind == "U":
        words = np.char.upper(np.char.strip(label.astype(np.str_)))
        if np.any(words == ""):
            raise InputError(
                f"{path}: label is empty in row {int(np.argmax(words == ''))}; LOS or NLOS is needed"
            )
        # Numbers that were saved as text are numbers.
        is_los = (words == "LOS") | (words == "1") | (words == "TRUE")
    elif label.dtype.kind in "fiub":
        if not np.all(np.isfinite(label.astype(np.float64))):
            raise InputError(f"{path}: label has NaN; LOS or 1 against everything else is needed")
        is_los = label.astype(np.float64) == 1
    else:
        raise InputError(f"{path}: label has type {label.dtype}; text or numbers are needed")
    if np.all(is_los) or not np.any(is_los):
        seen = ", ".join(str(value) for value in np.unique(label)[:5])
        raise InputError(
            f"{path}: all {rows} labels are {'LOS' if is_los[0] else 'NLOS'} (seen: {seen}); both classes "
            "are needed, LOS or 1 against everything else"
        )
    result: NDArray[np.bool_] = is_los
    return result
