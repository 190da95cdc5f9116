"""Heights of the ground from a file, cut to the search area.

Rule: a height decides where people are looked for, so nothing is guessed: a file that is not
plainly metres on a known grid is refused with what was seen and what is needed. What the
file does not know stays unknown, but for holes of a few cells, which take their neighbours'.

Read are SRTM tiles (``N47E008.hgt``), ESRI ASCII grids in degrees of WGS84 (``.asc``), and whatever
GDAL reads (GeoTIFF, projected grids) where rasterio is installed: its wheel brings GDAL and PROJ,
36 MB that a station without a GeoTIFF does not need, so it is an extra.
"""

from __future__ import annotations

import importlib
import math
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from groundstation.domain.errors import InputError
from groundstation.domain.mission import Area, Terrain

MARGIN_M = 300.0
"""Kept round the area, metres."""
MAX_NODES = 200
"""Across; a finer grid is averaged: it is journalled with the mission."""
MAX_FILE_BYTES = 2_000_000_000
_FILLED_CELLS = 4.0
_LOWEST_M, _HIGHEST_M = -500.0, 9000.0
_METERS_PER_DEG = 111_320.0
_VOID = -1e6
_HGT_NAME = re.compile(r"([NS])(\d{2})([EW])(\d{3})", re.IGNORECASE)
_HGT_SIDES = (1201, 3601)
_NEEDED = "needed is an SRTM tile (N47E008.hgt), an ESRI ASCII grid (.asc) or a GeoTIFF (.tif)"


@dataclass(frozen=True, slots=True)
class _Grid:
    """Heights at nodes: first row the southernmost, first column the westernmost; NaN where unknown."""

    south_deg: float
    west_deg: float
    latitude_step_deg: float
    longitude_step_deg: float
    altitude_m: NDArray[np.float64]

    def cut(self, box: _Box) -> _Grid | None:
        """The nodes inside ``box`` and one more on each side; None where there are not two by two."""
        rows, columns = self.altitude_m.shape
        first_row = max(math.floor((box.south_deg - self.south_deg) / self.latitude_step_deg), 0)
        last_row = min(math.ceil((box.north_deg - self.south_deg) / self.latitude_step_deg), rows - 1)
        first_column = max(math.floor((box.west_deg - self.west_deg) / self.longitude_step_deg), 0)
        last_column = min(math.ceil((box.east_deg - self.west_deg) / self.longitude_step_deg), columns - 1)
        if last_row - first_row < 1 or last_column - first_column < 1:
            return None
        return _Grid(
            self.south_deg + first_row * self.latitude_step_deg,
            self.west_deg + first_column * self.longitude_step_deg,
            self.latitude_step_deg,
            self.longitude_step_deg,
            self.altitude_m[first_row : last_row + 1, first_column : last_column + 1],
        )

    def thinned(self) -> _Grid:
        """Blocks of cells averaged until at most ``MAX_NODES`` are left across."""
        rows, columns = self.altitude_m.shape
        factor = math.ceil(max(rows, columns) / MAX_NODES)
        if factor == 1:
            return self
        padded = np.pad(
            self.altitude_m, ((0, -rows % factor), (0, -columns % factor)), constant_values=np.nan
        )
        blocks = padded.reshape(padded.shape[0] // factor, factor, padded.shape[1] // factor, factor)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a block of holes is a hole
            altitude = np.nanmean(blocks, axis=(1, 3))
        middle = 0.5 * (factor - 1)
        return _Grid(
            self.south_deg + middle * self.latitude_step_deg,
            self.west_deg + middle * self.longitude_step_deg,
            factor * self.latitude_step_deg,
            factor * self.longitude_step_deg,
            altitude,
        )


@dataclass(frozen=True, slots=True)
class _Box:
    south_deg: float
    north_deg: float
    west_deg: float
    east_deg: float

    @classmethod
    def round(cls, area: Area) -> _Box:
        """The area with its margin."""
        corners = np.array([corner for polygon in area.polygons for ring in polygon for corner in ring])
        margin_deg = MARGIN_M / _METERS_PER_DEG
        (south, west), (north, east) = corners.min(axis=0), corners.max(axis=0)
        wide_deg = margin_deg / max(math.cos(math.radians(0.5 * (south + north))), 0.05)
        return cls(south - margin_deg, north + margin_deg, west - wide_deg, east + wide_deg)

    def __str__(self) -> str:
        return (
            f"latitudes {self.south_deg:.4f} to {self.north_deg:.4f},"
            f" longitudes {self.west_deg:.4f} to {self.east_deg:.4f}"
        )


def read_terrain(path: Path, area: Area | None) -> Terrain:
    """The part of a file round ``area``, at most ``MAX_NODES`` nodes across.

    Raises:
        InputError: no area, not a file of heights, heights that are no metres, or of elsewhere.
    """
    if area is None:
        raise InputError(f"{path}: terrain is cut to the search area; --area with a polygon is needed too")
    try:
        size = path.stat().st_size
        if not path.is_file() or size > MAX_FILE_BYTES:
            raise InputError(f"{path}: not a file of at most {MAX_FILE_BYTES} bytes")
        box, kind = _Box.round(area), path.suffix.lower()
        if kind == ".hgt":
            grid = _read_hgt(path)
        elif kind == ".asc" and (found := _read_ascii(path)) is not None:
            grid = found
        else:
            grid = _read_raster(path, box)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    part = grid.cut(box)
    if part is None or not np.isfinite(part.altitude_m).any():
        rows, columns = grid.altitude_m.shape
        whole = _Box(
            grid.south_deg,
            grid.south_deg + (rows - 1) * grid.latitude_step_deg,
            grid.west_deg,
            grid.west_deg + (columns - 1) * grid.longitude_step_deg,
        )
        raise InputError(f"{path}: knows no height round the search area ({box}); it covers {whole}")
    altitude = _filled(part.altitude_m)
    low, high = float(np.nanmin(altitude)), float(np.nanmax(altitude))
    if low < _LOWEST_M or high > _HIGHEST_M:
        raise InputError(
            f"{path}: has heights from {low:g} to {high:g}; metres above mean sea level are needed"
            " (another unit, or a mark for unknown heights that the file does not declare?)"
        )
    kept = _Grid(
        part.south_deg, part.west_deg, part.latitude_step_deg, part.longitude_step_deg, altitude
    ).thinned()
    return Terrain(
        south_deg=kept.south_deg,
        west_deg=kept.west_deg,
        latitude_step_deg=kept.latitude_step_deg,
        longitude_step_deg=kept.longitude_step_deg,
        columns=kept.altitude_m.shape[1],
        altitude_dm=tuple(
            None if math.isnan(value) else round(10.0 * value) for value in kept.altitude_m.ravel().tolist()
        ),
        source=path.name,
    )


def _filled(altitude_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Small holes (radar shadow) take the nearest height."""
    unknown = ~np.isfinite(altitude_m)
    if not unknown.any():
        return altitude_m
    away, nearest = distance_transform_edt(unknown, return_indices=True)
    return np.where(away <= _FILLED_CELLS, altitude_m[tuple(nearest)], np.nan)


def _read_hgt(path: Path) -> _Grid:
    name = _HGT_NAME.match(path.stem)
    if name is None:
        raise InputError(f"{path}: a tile's name says where it lies; a name like N47E008.hgt is needed")
    data = np.fromfile(path, dtype=">i2")
    side = math.isqrt(data.size)
    if side * side != data.size or side not in _HGT_SIDES:
        needed = " or ".join(str(2 * number * number) for number in _HGT_SIDES)
        raise InputError(f"{path}: {path.stat().st_size} bytes; an SRTM tile of {needed} is needed")
    south = float(name[2]) * (1.0 if name[1].upper() == "N" else -1.0)
    west = float(name[4]) * (1.0 if name[3].upper() == "E" else -1.0)
    altitude = data.reshape(side, side)[::-1].astype(np.float64)
    altitude[altitude == -32768.0] = np.nan
    step = 1.0 / (side - 1)
    return _Grid(south, west, step, step, altitude)


def _read_ascii(path: Path) -> _Grid | None:
    """An ESRI ASCII grid; None where its coordinates are metres of a projection."""
    header: dict[str, float] = {}
    with path.open("r", encoding="ascii", errors="replace") as lines:
        position = 0
        for line in iter(lines.readline, ""):
            words = line.split()
            if not words:
                continue
            if len(words) != 2 or not words[0][0].isalpha():
                break
            try:
                header[words[0].lower()] = float(words[1])
            except ValueError as error:
                raise InputError(f"{path}: {words[0]} is {words[1]!r}; a number is needed") from error
            position = lines.tell()
        lines.seek(position)
        missing = [name for name in ("ncols", "nrows") if name not in header]
        x = header.get("xllcenter", header.get("xllcorner"))
        y = header.get("yllcenter", header.get("yllcorner"))
        step_x = header.get("cellsize", header.get("dx"))
        step_y = header.get("cellsize", header.get("dy"))
        if missing or x is None or y is None or not step_x or not step_y:
            raise InputError(
                f"{path}: an ESRI ASCII grid begins with ncols, nrows, xllcorner, yllcorner and cellsize;"
                f" there were {', '.join(sorted(header)) or 'none of them'}"
            )
        if abs(x) > 360.0 or abs(y) > 90.0 or max(step_x, step_y) >= 1.0:
            return None
        try:
            values = np.array(lines.read().split(), dtype=np.float64)
        except ValueError as error:
            raise InputError(f"{path}: has a height that is no number: {error}") from error
    rows, columns = int(header["nrows"]), int(header["ncols"])
    if rows < 2 or columns < 2 or values.size != rows * columns:
        raise InputError(f"{path}: has {values.size} heights; {rows} rows of {columns} are promised")
    values[values == header.get("nodata_value", -9999.0)] = np.nan
    return _Grid(
        y if "yllcenter" in header else y + 0.5 * step_y,
        x if "xllcenter" in header else x + 0.5 * step_x,
        step_y,
        step_x,
        values.reshape(rows, columns)[::-1],
    )


def _read_raster(path: Path, box: _Box) -> _Grid:
    """Whatever GDAL reads, turned to WGS84."""
    try:
        rasterio: Any = importlib.import_module("rasterio")
    except ImportError as error:
        raise InputError(
            f"{path}: a GeoTIFF or a projected grid needs rasterio, which is not installed"
            " (pip install 'groundstation[terrain]'); or give an SRTM tile or an ASCII grid in degrees"
        ) from error
    vrt: Any = importlib.import_module("rasterio.vrt")
    windows: Any = importlib.import_module("rasterio.windows")
    resampling: Any = importlib.import_module("rasterio.enums").Resampling
    try:
        # "No georeference" is told below, in our words; the rest are rasterio's to other libraries.
        with warnings.catch_warnings(action="ignore"), rasterio.open(path) as source:
            if source.count != 1:
                raise InputError(f"{path}: has {source.count} bands; one band of heights is needed")
            if source.crs is None:
                raise InputError(f"{path}: says no coordinate system; a georeferenced file is needed")
            unit = (source.units[0] or "").lower()
            if unit not in ("", "m", "metre", "meter", "metres", "meters"):
                raise InputError(f"{path}: heights are in {unit!r}; metres are needed")
            with vrt.WarpedVRT(
                source,
                crs="EPSG:4326",
                resampling=resampling.bilinear,
                dtype="float32",
                src_nodata=source.nodata,
                nodata=_VOID,
            ) as turned:
                whole = turned.bounds
                west, east = max(box.west_deg, whole.left), min(box.east_deg, whole.right)
                south, north = max(box.south_deg, whole.bottom), min(box.north_deg, whole.top)
                if west >= east or south >= north:
                    covered = _Box(whole.bottom, whole.top, whole.left, whole.right)
                    raise InputError(
                        f"{path}: knows no height round the search area ({box}); it covers {covered}"
                    )
                window = windows.from_bounds(west, south, east, north, turned.transform)
                # Twice as fine as what is kept: the rest of a fine file need not be read.
                shape = tuple(
                    max(2, min(math.ceil(cells), 2 * MAX_NODES)) for cells in (window.height, window.width)
                )
                data = turned.read(1, window=window, out_shape=shape, resampling=resampling.average)
    except rasterio.errors.RasterioError as error:
        raise InputError(f"{path}: cannot be read as a raster ({error}); {_NEEDED}") from error
    altitude = data[::-1].astype(np.float64)
    altitude[altitude <= 0.5 * _VOID] = np.nan
    step_x, step_y = (east - west) / shape[1], (north - south) / shape[0]
    return _Grid(south + 0.5 * step_y, west + 0.5 * step_x, step_y, step_x, altitude)
