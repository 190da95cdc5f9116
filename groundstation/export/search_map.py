"""The search map for a GIS: ESRI ASCII grids beside their projection.

Exists because a search team plans on its own maps. ASCII grids, because QGIS, ArcGIS, Global
Mapper and everything built on GDAL open them as they are, a person can read them, and they need
no library; a PNG would carry colours but no numbers. The squares lie in the plane that touches the earth at
the station's origin, so the projection is a transverse Mercator with its origin there, scaled to
the origin's height: within 5 km it agrees with that plane to a centimetre. Rule: the same map
gives the same bytes.
"""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Iterator
from datetime import UTC, datetime

from groundstation.domain.target import SearchMap
from groundstation.export.rounding import iso_time

_EARTH_RADIUS_M = 6_371_008.8
_CONTAINMENT_UNITS = 10_000


def search_map_files(found: SearchMap) -> dict[str, bytes]:
    """Content by file name: two grids (share of the belief in %, containment in %) and their projection."""
    share = [100.0 * value for (value,) in struct.iter_unpack("<f", found.share)]
    containment = [
        100.0 * value / _CONTAINMENT_UNITS for (value,) in struct.iter_unpack("<H", found.containment)
    ]
    projection = _projection(found)
    files: dict[str, bytes] = {}
    for name, values, decimals in (("probability", share, 5), ("containment", containment, 2)):
        stem = f"beacon-{found.beacon_id}-{name}"
        files[f"{stem}.asc"] = _grid(found, values, decimals)
        files[f"{stem}.prj"] = projection
    return files


def search_map_archive(found: SearchMap) -> bytes:
    """The files in one ZIP, dated by the belief, so that no grid is parted from its projection."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in {**search_map_files(found), "about.txt": _about(found)}.items():
            entry = zipfile.ZipInfo(name, _dos_time(found.time_ns))
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, content)
    return packed.getvalue()


def _grid(found: SearchMap, values: list[float], decimals: int) -> bytes:
    south_m = found.north_m - found.rows * found.cell_m
    head = (
        f"ncols {found.columns}\nnrows {found.rows}\nxllcorner {found.west_m:.3f}\nyllcorner {south_m:.3f}\n"
        f"cellsize {found.cell_m:.4f}\nNODATA_value -1\n"
    )
    lines = (" ".join(f"{value:.{decimals}f}" for value in row) for row in _rows(values, found.columns))
    return (head + "\n".join(lines) + "\n").encode()


def _rows(values: list[float], columns: int) -> Iterator[list[float]]:
    for start in range(0, len(values), columns):
        yield values[start : start + columns]


def _projection(found: SearchMap) -> bytes:
    """ESRI's well-known text of the plane."""
    origin = found.origin
    scale = 1.0 + origin.altitude_amsl_m / _EARTH_RADIUS_M
    return (
        'PROJCS["Search_Plane",GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",'
        'SPHEROID["WGS_1984",6378137.0,298.257223563]],PRIMEM["Greenwich",0.0],'
        'UNIT["Degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],'
        'PARAMETER["False_Easting",0.0],PARAMETER["False_Northing",0.0],'
        f'PARAMETER["Central_Meridian",{origin.longitude_deg:.9f}],'
        f'PARAMETER["Scale_Factor",{scale:.10f}],'
        f'PARAMETER["Latitude_Of_Origin",{origin.latitude_deg:.9f}],UNIT["Meter",1.0]]'
    ).encode()


def _about(found: SearchMap) -> bytes:
    return (
        f"Where beacon {found.beacon_id} could be, as believed at {iso_time(found.time_ns)}.\n"
        "probability.asc: share of the belief in each square, percent; all squares add up to 100.\n"
        "containment.asc: share of the belief in the squares that are at least as likely, percent:\n"
        "the squares up to 50 are where to search first, those up to 90 hold nine tenths.\n"
    ).encode()


def _dos_time(time_ns: int) -> tuple[int, int, int, int, int, int]:
    moment = datetime.fromtimestamp(max(time_ns, 0) // 1_000_000_000, UTC)
    if not 1980 <= moment.year < 2108:
        return 1980, 1, 1, 0, 0, 0
    return moment.year, moment.month, moment.day, moment.hour, moment.minute, moment.second
