"""Rows into a file as they are made: NPZ, or CSV in the paper's column order.

Rules kept here: memory does not grow with the responses; the bytes depend on the rows alone (no
clock in the archive); the file has its name only once it is whole.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from groundstation.domain.errors import UsageError
from sim_sitl.dataset.rows import COLUMNS

PAPER_FIELDS = ("X", "Y", "Z", "Range", "LOS", "AOA", "ZOA", "TotalReceivedPower", "LinkBudget")
"""The paper's columns before CIR0, CIR1, …"""
_PAPER_COLUMNS = (
    "x_m",
    "y_m",
    "z_m",
    "range_m",
    "los",
    "aoa_deg",
    "zoa_deg",
    "total_received_power_dbm",
    "link_budget_db",
)
FORMAT_VERSION = 2


class Writer(Protocol):
    """Takes rows in order."""

    def write(self, cir_magnitude: NDArray[np.float32], columns: dict[str, NDArray[np.generic]]) -> None:
        """(n, taps) responses with (n,) columns."""

    def finish(self, seed: int) -> None:
        """After the last row."""

    def abandon(self) -> None:
        """After a failure: lets go of what is open."""


class NpzWriter:
    """``cir_magnitude`` (N, taps) float32, then the columns; stored, dated as the format's first day."""

    def __init__(self, file: BinaryIO, rows: int, taps: int) -> None:
        self._archive = zipfile.ZipFile(file, "w", zipfile.ZIP_STORED)
        self._member = self._archive.open(_entry("cir_magnitude"), "w", force_zip64=True)
        np.lib.format.write_array_header_1_0(
            self._member,
            {"descr": "<f4", "fortran_order": False, "shape": (rows, taps)},
        )
        self._columns = {name: np.empty(rows, kind) for name, kind in COLUMNS.items()}
        self._row = 0

    def write(self, cir_magnitude: NDArray[np.float32], columns: dict[str, NDArray[np.generic]]) -> None:
        """See Writer."""
        self._member.write(np.ascontiguousarray(cir_magnitude, "<f4").tobytes())
        for name, values in columns.items():
            self._columns[name][self._row : self._row + len(values)] = values
        self._row += len(cir_magnitude)

    def finish(self, seed: int) -> None:
        """See Writer."""
        self._member.close()
        scalars = {"seed": np.array(seed), "format_version": np.array(FORMAT_VERSION)}
        for name, array in sorted((self._columns | scalars).items()):
            with self._archive.open(_entry(name), "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
        self._archive.close()

    def abandon(self) -> None:
        """See Writer."""
        self._member.close()
        self._archive.close()


class CsvWriter:
    """The paper's row format, with its header; six significant digits."""

    def __init__(self, file: BinaryIO, rows: int, taps: int) -> None:
        del rows
        self._file = file
        self._format = ",".join(["%.6g"] * len(PAPER_FIELDS) + ["%.6g"] * taps) + "\n"
        header = ",".join([*PAPER_FIELDS, *(f"CIR{tap}" for tap in range(taps))])
        file.write(f"{header}\n".encode())

    def write(self, cir_magnitude: NDArray[np.float32], columns: dict[str, NDArray[np.generic]]) -> None:
        """See Writer."""
        front = np.stack([columns[name].astype(np.float64) for name in _PAPER_COLUMNS], axis=1)
        values = np.hstack([front, cir_magnitude.astype(np.float64)])
        self._file.write("".join([self._format % tuple(row) for row in values.tolist()]).encode())

    def finish(self, seed: int) -> None:
        """See Writer; the paper's format has no place for the seed."""

    def abandon(self) -> None:
        """See Writer."""


@contextmanager
def open_writer(out: Path, rows: int, taps: int) -> Iterator[Writer]:
    """A writer by ``out``'s suffix (.npz or .csv); the file appears under its name on success only.

    Raises UsageError on another suffix.
    """
    kinds: dict[str, type[NpzWriter] | type[CsvWriter]] = {".npz": NpzWriter, ".csv": CsvWriter}
    kind = kinds.get(out.suffix.lower())
    if kind is None:
        raise UsageError(f"--out {out.name} ends neither in .npz nor in .csv")
    partial = out.with_name(f".{out.name}.partial")
    try:
        with partial.open("wb") as file:
            writer = kind(file, rows, taps)
            try:
                yield writer
            except BaseException:
                writer.abandon()
                raise
        os.replace(partial, out)
    finally:
        partial.unlink(missing_ok=True)


def _entry(name: str) -> zipfile.ZipInfo:
    return zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
