"""Terrain files: what is plainly metres on a known grid is read exactly, the rest is refused."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from groundstation.domain.errors import InputError
from groundstation.domain.geometry import Geodetic
from groundstation.engine.estimator_terrain import altitude_amsl_m
from groundstation.mission_files import disc_area
from groundstation.terrain import MAX_NODES, read_terrain

# rasterio 1.4 multiplies affine's matrices in a way that affine 3 will one day refuse.
pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")

AREA = disc_area(Geodetic(47.25, 8.55, 0.0), 500.0)


def plane(latitude: np.ndarray, longitude: np.ndarray) -> np.ndarray:
    """Metres: rises by 500 m a degree to the north, falls by 300 m to the east."""
    return 600.0 + 500.0 * (latitude - 47.0) - 300.0 * (longitude - 8.0)


def ascii_grid(path: Path, step: float = 0.001, header: str = "", **changed: object) -> Path:
    west, south, size = 8.5, 47.2, 100
    values = {"ncols": size, "nrows": size, "xllcorner": west, "yllcorner": south, "cellsize": step}
    values |= {"nodata_value": -9999} | changed
    along = step * (np.arange(size) + 0.5)
    latitude, longitude = np.meshgrid((south + along)[::-1], west + along, indexing="ij")
    rows = [" ".join(f"{value:.3f}" for value in row) for row in plane(latitude, longitude)]
    lines = [f"{name} {value}" for name, value in values.items() if value is not None]
    path.write_text("\n".join([*lines, *rows]) + "\n")
    return path


def error_m(path: Path) -> float:
    """Largest error of a terrain over the area."""
    terrain = read_terrain(path, AREA)
    latitude, longitude = np.meshgrid(np.linspace(47.246, 47.254, 30), np.linspace(8.544, 8.556, 30))
    altitude, known = altitude_amsl_m(terrain, latitude, longitude)
    assert known.all()
    return float(np.abs(altitude - plane(latitude, longitude)).max())


def hgt(path: Path, hole: bool = False) -> Path:
    along = np.arange(1201) / 1200.0
    latitude, longitude = np.meshgrid(48.0 - along, 8.0 + along, indexing="ij")
    data = np.round(plane(latitude, longitude)).astype(">i2")
    if hole:
        data[899:902, 659:662] = -32768
        data[880:895, 640:655] = -32768
    data.tofile(path)
    return path


def test_an_ascii_grid_in_degrees(tmp_path: Path) -> None:
    assert error_m(ascii_grid(tmp_path / "a.asc")) < 0.06
    centred = {"xllcorner": None, "yllcorner": None, "xllcenter": 8.5005, "yllcenter": 47.2005}
    assert error_m(ascii_grid(tmp_path / "b.asc", **centred)) < 0.06


def test_an_srtm_tile_whose_small_holes_are_filled(tmp_path: Path) -> None:
    assert error_m(hgt(tmp_path / "N47E008.hgt")) < 1.0
    terrain = read_terrain(hgt(tmp_path / "n47e008.HGT", hole=True), AREA)
    # 3 by 3 unknown heights take their neighbours', 15 by 15 stay unknown in the middle.
    places = np.array([48.0 - 900 / 1200, 48.0 - 887 / 1200]), np.array([8.0 + 660 / 1200, 8.0 + 647 / 1200])
    _, known = altitude_amsl_m(terrain, *places)
    assert known.tolist() == [True, False]


def geotiff(path: Path, crs: str | None, **changed: object) -> Path:
    rasterio = pytest.importorskip("rasterio")
    from rasterio.transform import from_bounds
    from rasterio.warp import transform

    bounds = (8.5, 47.2, 8.6, 47.3)
    if crs == "EPSG:32632":
        xs, ys = transform("EPSG:4326", crs, [8.5, 8.6], [47.2, 47.3])
        bounds = (xs[0], ys[0], xs[1], ys[1])
    size = 300
    grid = from_bounds(*bounds, size, size)
    column, row = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    x, y = grid * (column, row)
    if crs == "EPSG:32632":
        flat = transform(crs, "EPSG:4326", x.ravel(), y.ravel())
        x, y = (np.array(values).reshape(size, size) for values in flat)
    profile = {"driver": "GTiff", "width": size, "height": size, "count": 1, "dtype": "float32"}
    profile |= {"crs": crs, "transform": grid, "nodata": -9999.0} | changed
    with rasterio.open(path, "w", **profile) as file:
        for band in range(1, int(profile["count"]) + 1):
            file.write(plane(y, x).astype("float32"), band)
    return path


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:32632"])
def test_a_geotiff_in_degrees_or_projected(tmp_path: Path, crs: str) -> None:
    assert error_m(geotiff(tmp_path / "dem.tif", crs, compress="deflate")) < 0.3


def test_a_fine_file_is_averaged_to_what_a_journal_can_hold(tmp_path: Path) -> None:
    path = tmp_path / "fine.asc"
    size = 450
    along = 4e-5 * np.arange(size)
    latitude, longitude = np.meshgrid((47.241 + along)[::-1], 8.541 + along, indexing="ij")
    rows = [" ".join(f"{v:.2f}" for v in row) for row in plane(latitude, longitude)]
    head = f"ncols {size}\nnrows {size}\nxllcenter 8.541\nyllcenter 47.241\ndx 4e-5\ndy 4e-5\n"
    path.write_text(head + "\n".join(rows))
    terrain = read_terrain(path, AREA)
    assert max(terrain.rows, terrain.columns) <= MAX_NODES
    assert error_m(path) < 0.06


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"cellsize": None}, "begins with ncols"),
        ({"ncols": 99}, "10000 heights; 100 rows of 99"),
        ({"ncols": "many"}, "'many'; a number is needed"),
        ({"xllcorner": 9.5}, "knows no height round the search area"),
    ],
)
def test_a_wrong_ascii_grid_is_refused_in_one_line(tmp_path: Path, changed: dict, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        read_terrain(ascii_grid(tmp_path / "a.asc", **changed), AREA)


def test_what_is_no_terrain_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "N47E008.hgt").write_bytes(bytes(1000))
    (tmp_path / "mine.hgt").write_bytes(bytes(2 * 1201 * 1201))
    for name, expected in {
        "N47E008.hgt": "1000 bytes; an SRTM tile of 2884802 or 25934402",
        "mine.hgt": "a name like N47E008.hgt",
        "absent.asc": "cannot read",
    }.items():
        with pytest.raises(InputError, match=expected) as caught:
            read_terrain(tmp_path / name, AREA)
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="--area"):
        read_terrain(tmp_path / "N47E008.hgt", None)


def test_heights_that_cannot_be_metres_are_refused(tmp_path: Path) -> None:
    path = ascii_grid(tmp_path / "a.asc")
    words = path.read_text().split()
    words[12:] = [str(100.0 * float(word)) for word in words[12:]]
    path.write_text(
        "\n".join(" ".join(words[i : i + 2]) for i in range(0, 12, 2)) + "\n" + " ".join(words[12:])
    )
    with pytest.raises(InputError, match="metres above mean sea level"):
        read_terrain(path, AREA)


def test_a_geotiff_that_is_no_map_of_heights(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="3 bands"):
        read_terrain(geotiff(tmp_path / "rgb.tif", "EPSG:4326", count=3), AREA)
    with pytest.raises(InputError, match="no coordinate system"):
        read_terrain(geotiff(tmp_path / "bare.tif", None), AREA)
    (tmp_path / "text.tif").write_text("not a raster")
    with pytest.raises(InputError, match="cannot be read as a raster"):
        read_terrain(tmp_path / "text.tif", AREA)
    far = disc_area(Geodetic(10.0, 10.0, 0.0), 500.0)
    with pytest.raises(InputError, match="it covers latitudes 47"):
        read_terrain(geotiff(tmp_path / "dem.tif", "EPSG:4326"), far)


def test_without_rasterio_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "dem.tif").write_bytes(b"II*\0")
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(InputError, match=r"groundstation\[terrain\]"):
        read_terrain(tmp_path / "dem.tif", AREA)
