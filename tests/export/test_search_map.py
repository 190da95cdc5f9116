"""Search maps for a GIS: read back as another program would."""

from __future__ import annotations

import io
import math
import re
import struct
import zipfile
from dataclasses import replace

import numpy as np
import pymap3d
import pytest

from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.target import SearchMap
from groundstation.export import search_map_archive, search_map_files

ROWS, COLUMNS = 3, 4


def example(altitude_m: float = 0.0) -> SearchMap:
    share = np.arange(ROWS * COLUMNS, dtype=np.float64) / 66.0
    return SearchMap(
        beacon_id=2**64 - 1, time_ns=1_700_000_000_250_000_000, sequence=3,
        origin=Geodetic(47.25, -122.5, altitude_m), west_m=-20.0, north_m=35.5, cell_m=2.5,
        rows=ROWS, columns=COLUMNS, corners=((47.0, -122.0),) * 4,
        share=struct.pack(f"<{ROWS * COLUMNS}f", *share),
        containment=struct.pack(f"<{ROWS * COLUMNS}H", *range(10_000, 10_000 - 12 * 500, -500)),
    )  # fmt: skip


def read_grid(data: bytes) -> tuple[dict[str, float], np.ndarray]:
    """The format as its specification has it: six named numbers, then rows from the north."""
    lines = data.decode("ascii").splitlines()
    head = {name.lower(): float(value) for name, value in (line.split() for line in lines[:6])}
    return head, np.array([[float(value) for value in line.split()] for line in lines[6:]])


def test_the_grids_hold_the_values_where_they_belong() -> None:
    files = search_map_files(example())
    stem = f"beacon-{2**64 - 1}"
    assert sorted(files) == [
        f"{stem}-containment.asc", f"{stem}-containment.prj",
        f"{stem}-probability.asc", f"{stem}-probability.prj",
    ]  # fmt: skip
    head, values = read_grid(files[f"{stem}-probability.asc"])
    assert (head["ncols"], head["nrows"], head["cellsize"]) == (COLUMNS, ROWS, 2.5)
    # The corner is the lower left one; the map tells its northern edge.
    assert (head["xllcorner"], head["yllcorner"]) == (-20.0, 35.5 - 3 * 2.5)
    assert values.shape == (ROWS, COLUMNS)
    assert values.sum() == pytest.approx(100.0, abs=1e-3)
    assert values[0] == pytest.approx([0.0, 100 / 66, 200 / 66, 300 / 66], abs=1e-4)
    _, contained = read_grid(files[f"{stem}-containment.asc"])
    assert contained[0, 0] == 100.0
    assert contained[-1, -1] == 45.0


@pytest.mark.parametrize("altitude_m", [0.0, 3800.0])
def test_the_projection_is_the_plane_of_the_map(altitude_m: float) -> None:
    """Points of the plane, put on the ellipsoid by the series of a transverse Mercator (Snyder, 1987)."""
    found = example(altitude_m)
    text = next(
        content for name, content in search_map_files(found).items() if name.endswith(".prj")
    ).decode()
    names = dict(re.findall(r'PARAMETER\["(\w+)",([-0-9.]+)\]', text))
    assert (float(names["Latitude_Of_Origin"]), float(names["Central_Meridian"])) == (47.25, -122.5)
    scale = float(names["Scale_Factor"])
    frame = LocalFrame(found.origin)
    for east, north in ((2000.0, 0.0), (0.0, -2000.0), (1400.0, 1400.0)):
        place = frame.to_geodetic((east, north, 0.0))
        x, y = _transverse_mercator(place.latitude_deg, place.longitude_deg, 47.25, -122.5, scale)
        assert math.hypot(x - east, y - north) < 0.03


def _transverse_mercator(
    latitude_deg: float, longitude_deg: float, latitude0_deg: float, longitude0_deg: float, scale: float
) -> tuple[float, float]:
    ellipsoid = pymap3d.Ellipsoid.from_name("wgs84")
    e2 = ellipsoid.eccentricity**2
    phi, phi0 = math.radians(latitude_deg), math.radians(latitude0_deg)
    second = e2 / (1 - e2)
    n = ellipsoid.semimajor_axis / math.sqrt(1 - e2 * math.sin(phi) ** 2)
    t, c = math.tan(phi) ** 2, second * math.cos(phi) ** 2
    a = math.radians(longitude_deg - longitude0_deg) * math.cos(phi)

    def arc(angle: float) -> float:
        e4, e6 = e2**2, e2**3
        return ellipsoid.semimajor_axis * (
            (1 - e2 / 4 - 3 * e4 / 64 - 5 * e6 / 256) * angle
            - (3 * e2 / 8 + 3 * e4 / 32 + 45 * e6 / 1024) * math.sin(2 * angle)
            + (15 * e4 / 256 + 45 * e6 / 1024) * math.sin(4 * angle)
            - (35 * e6 / 3072) * math.sin(6 * angle)
        )

    x = scale * n * (a + (1 - t + c) * a**3 / 6)
    y = scale * (
        arc(phi) - arc(phi0) + n * math.tan(phi) * (a**2 / 2 + (5 - t + 9 * c + 4 * c**2) * a**4 / 24)
    )
    return x, y


def test_the_archive_is_the_same_every_time_and_says_what_it_holds() -> None:
    first, second = search_map_archive(example()), search_map_archive(example())
    assert first == second
    with zipfile.ZipFile(io.BytesIO(first)) as archive:
        assert {name.rsplit(".", 1)[1] for name in archive.namelist()} == {"asc", "prj", "txt"}
        assert archive.infolist()[0].date_time == (2023, 11, 14, 22, 13, 20)
        assert b"2023-11-14T22:13:20.250Z" in archive.read("about.txt")


def test_a_time_that_no_archive_can_hold() -> None:
    packed = search_map_archive(replace(example(), time_ns=0))
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        assert archive.infolist()[0].date_time == (1980, 1, 1, 0, 0, 0)
