"""Search area, last known places and fence from GeoJSON files, and back.

Rule: a fence decides where an aircraft may go, so nothing is guessed and nothing repaired:
what is not plainly a valid polygon on WGS84 is refused with the file, what was seen and what
is needed. RFC 7946: positions are longitude, latitude; a third number is ignored.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import orjson
import pymap3d
import shapely
from shapely.geometry import MultiPolygon, Polygon
from shapely.validation import explain_validity

from groundstation.domain.errors import InputError
from groundstation.domain.geometry import Geodetic
from groundstation.domain.mission import Area, LastKnownPlace, Ring

MAX_FILE_BYTES = 10_000_000
MAX_POINTS = 10_000
"""Corners of all rings together."""
MAX_EXTENT_M = 200_000.0
"""Across: a wider area does not fit one local frame, and is more likely a mistake."""
DISC_CORNERS = 64
MAX_RADIUS_M = 50_000.0
"""Of a last known place."""
LAST_KNOWN = "last-known"
"""What a Point may say of itself in its property ``role``."""
_METERS_PER_DEG = 111_320.0
_FAR_M = 100_000.0
_MAX_DEPTH = 5


def read_area(path: Path) -> Area:
    """The area in a GeoJSON file: Polygon, MultiPolygon, Feature or FeatureCollection of these.

    Polygons of several features that overlap are united.

    Raises:
        InputError: file, what was seen, what is needed.
    """
    return parse_area(_read(path), str(path), path.stem)


def read_search(path: Path) -> tuple[Area | None, tuple[LastKnownPlace, ...]]:
    """The search area in a GeoJSON file, and the last known places in it.

    A last known place is a Feature with a Point and the property ``radius_m``: of the circle
    that is trusted to hold the person nine times in ten; ``name`` and ``beacon_id`` (decimal
    text) are optional. A file of such points alone gives no area.

    Raises:
        InputError: file, what was seen, what is needed.
    """
    return parse_search(_read(path), str(path), path.stem)


def parse_search(data: bytes, source: str, name: str = "") -> tuple[Area | None, tuple[LastKnownPlace, ...]]:
    """The same from GeoJSON text; ``source`` begins the error's text. Raises InputError."""
    document = _document(data, source)
    places: list[LastKnownPlace] = []
    rest = _without_points(document, source, places)
    if rest is None and places:
        return None, tuple(places)
    return _area(rest if places else document, source, name), tuple(places)


def parse_area(data: bytes, source: str, name: str = "") -> Area:
    """The area in GeoJSON text; ``source`` begins the error's text. Raises InputError."""
    return _area(_document(data, source), source, name)


def _read(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise InputError(f"{path}: {size} bytes; a GeoJSON file of at most {MAX_FILE_BYTES} is needed")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error


def _document(data: bytes, source: str) -> Any:
    try:
        document = orjson.loads(data.removeprefix(b"\xef\xbb\xbf"))
    except orjson.JSONDecodeError as error:
        raise InputError(f"{source}: not valid JSON: {error}") from error
    if isinstance(document, dict):
        _check_crs(document, source)
    return document


def _without_points(document: Any, source: str, places: list[LastKnownPlace], depth: int = 0) -> Any:
    """``document`` without its last known places, which are appended to ``places``; None: nothing is left."""
    if not isinstance(document, dict) or depth > _MAX_DEPTH:
        return document
    if document.get("type") == "FeatureCollection":
        parts = [
            _without_points(feature, source, places, depth + 1)
            for feature in _list(document, "features", source)
        ]
        kept = [part for part in parts if part is not None]
        return {**document, "features": kept} if kept or not parts else None
    geometry = document.get("geometry") if document.get("type") == "Feature" else document
    if not isinstance(geometry, dict) or geometry.get("type") != "Point":
        return document
    properties = document.get("properties")
    places.append(_last_known(geometry, properties if isinstance(properties, dict) else {}, source))
    return None


def _last_known(point: dict[str, Any], properties: dict[str, Any], source: str) -> LastKnownPlace:
    latitude, longitude = _corner(point.get("coordinates"), "a last known place", source)
    radius = properties.get("radius_m")
    if isinstance(radius, bool) or not isinstance(radius, int | float) or not 1.0 <= radius <= MAX_RADIUS_M:
        raise InputError(
            f"{source}: the Point [{longitude:g}, {latitude:g}] has the radius_m {radius!r}; a last known"
            f" place needs the property radius_m, 1 to {MAX_RADIUS_M:g} metres, of a circle that is right"
            " nine times in ten"
        )
    role, beacon = properties.get("role", LAST_KNOWN), properties.get("beacon_id")
    if role != LAST_KNOWN:
        raise InputError(f"{source}: a Point has the role {str(role)[:40]!r}; {LAST_KNOWN!r} is needed")
    if beacon is not None and not (isinstance(beacon, str) and beacon.isdecimal() and int(beacon) < 2**64):
        raise InputError(f"{source}: a Point has the beacon_id {beacon!r}; its digits as text are needed")
    name = properties.get("name")
    return LastKnownPlace(
        latitude,
        longitude,
        float(radius),
        name if isinstance(name, str) else "",
        None if beacon is None else int(beacon),
    )


def _area(document: Any, source: str, name: str) -> Area:
    names: list[str] = []
    polygons = [_polygon(rings, source) for rings in _polygons(document, source, names)]
    if not polygons:
        raise InputError(f"{source}: no polygon in it; a Polygon or MultiPolygon is needed")
    count = sum(len(ring) for rings in polygons for ring in rings)
    if count > MAX_POINTS:
        raise InputError(f"{source}: {count} corners; at most {MAX_POINTS} are allowed: simplify the outline")
    area = Area(tuple(polygons), names[0] if len(names) == 1 else name)
    _check_shape(area, source)
    _check_extent(area, source)
    return _without_overlap(area)


def disc_area(center: Geodetic, radius_m: float, name: str = "disc") -> Area:
    """A disc as a polygon whose corners lie on it. Raises InputError for a radius that is not positive."""
    if not (math.isfinite(radius_m) and 0.0 < radius_m <= MAX_EXTENT_M / 2):
        raise InputError(
            f"a disc of radius {radius_m:g} m; more than 0 and at most {MAX_EXTENT_M / 2:g} is needed"
        )
    corners: list[tuple[float, float]] = []
    for index in range(DISC_CORNERS):
        angle_rad = 2.0 * math.pi * index / DISC_CORNERS
        latitude, longitude, _ = pymap3d.enu2geodetic(
            radius_m * math.cos(angle_rad),
            radius_m * math.sin(angle_rad),
            0.0,
            center.latitude_deg,
            center.longitude_deg,
            0.0,
        )
        corners.append((float(latitude), float(longitude)))
    return Area((((*corners, corners[0]),),), name)


def area_geojson(area: Area) -> dict[str, Any]:
    """The area as a GeoJSON geometry (Polygon, or MultiPolygon for several)."""
    coordinates = [
        [[[longitude, latitude] for latitude, longitude in ring] for ring in rings] for rings in area.polygons
    ]
    if len(coordinates) == 1:
        return {"type": "Polygon", "coordinates": coordinates[0]}
    return {"type": "MultiPolygon", "coordinates": coordinates}


def distance_warning(area: Area, place: Geodetic) -> str | None:
    """What to tell the operator when a vehicle at ``place`` is implausibly far from the area.

    Latitude and longitude in the wrong order are still a valid file in most of the world;
    they show only against a vehicle.
    """
    box = shapely.box(*_shape(area).bounds)
    away_m = _distance_m(box, place.longitude_deg, place.latitude_deg)
    if away_m < _FAR_M:
        return None
    text = f"The area {area.name!r} is {away_m / 1000.0:.0f} km away from the vehicles"
    if _distance_m(box, place.latitude_deg, place.longitude_deg) < _FAR_M:
        text += "; its latitudes and longitudes look swapped (GeoJSON has longitude first)"
    return text


def _polygons(document: Any, source: str, names: list[str], depth: int = 0) -> Iterator[Any]:
    """Coordinates of each polygon in a GeoJSON object."""
    if depth > _MAX_DEPTH:
        raise InputError(f"{source}: collections nested more than {_MAX_DEPTH} deep")
    kind = document.get("type") if isinstance(document, dict) else None
    match kind:
        case "FeatureCollection":
            for feature in _list(document, "features", source):
                yield from _polygons(feature, source, names, depth + 1)
        case "Feature":
            properties = document.get("properties")
            if isinstance(properties, dict) and isinstance(properties.get("name"), str):
                names.append(properties["name"])
            yield from _polygons(document.get("geometry"), source, names, depth + 1)
        case "Polygon":
            yield _list(document, "coordinates", source)
        case "MultiPolygon":
            yield from _list(document, "coordinates", source)
        case "GeometryCollection":
            for geometry in _list(document, "geometries", source):
                yield from _polygons(geometry, source, names, depth + 1)
        case str():
            raise InputError(f"{source}: has a {kind[:40]}; only Polygon and MultiPolygon describe an area")
        case _:
            seen = "null" if document is None else type(document).__name__
            raise InputError(
                f"{source}: not GeoJSON ({seen} without a type); a Polygon or MultiPolygon is needed"
            )


def _list(document: dict[str, Any], key: str, source: str) -> list[Any]:
    value = document.get(key)
    if not isinstance(value, list):
        raise InputError(f"{source}: {document['type']} without a list of {key}")
    return value


def _polygon(rings: Any, source: str) -> tuple[Ring, ...]:
    if not isinstance(rings, list) or not rings:
        raise InputError(f"{source}: a polygon without rings; a list of rings is needed")
    return tuple(_ring(ring, index, source) for index, ring in enumerate(rings))


def _ring(ring: Any, index: int, source: str) -> Ring:
    which = "the outer ring" if index == 0 else f"hole {index}"
    if not isinstance(ring, list) or len(ring) < 4:
        count = len(ring) if isinstance(ring, list) else 0
        raise InputError(
            f"{source}: {which} has {count} positions; at least 4 are needed, the last as the first"
        )
    corners = tuple(_corner(position, which, source) for position in ring)
    if corners[0] != corners[-1]:
        raise InputError(
            f"{source}: {which} is not closed: it begins at {_show(corners[0])} "
            f"and ends at {_show(corners[-1])}"
        )
    return corners


def _corner(position: Any, which: str, source: str) -> tuple[float, float]:
    if (
        not isinstance(position, list)
        or len(position) < 2
        or any(isinstance(item, bool) or not isinstance(item, int | float) for item in position[:2])
    ):
        raise InputError(
            f"{source}: {which} has the position {str(position)[:60]}; [longitude, latitude] is needed"
        )
    longitude, latitude = float(position[0]), float(position[1])
    if abs(longitude) > 360.0 or abs(latitude) > 360.0:
        raise InputError(
            f"{source}: {which} has the position [{longitude:g}, {latitude:g}]: "
            "looks like metres of a projection; degrees of WGS84 are needed"
        )
    if abs(latitude) > 90.0 and abs(longitude) <= 90.0:
        raise InputError(
            f"{source}: {which} has the position [{longitude:g}, {latitude:g}]: latitude and longitude look "
            "swapped; GeoJSON has longitude first"
        )
    if abs(latitude) > 90.0 or abs(longitude) > 180.0:
        raise InputError(
            f"{source}: {which} has the position [{longitude:g}, {latitude:g}]; "
            "longitude within ±180 and latitude within ±90 degrees are needed"
        )
    return latitude, longitude


def _check_crs(document: dict[str, Any], source: str) -> None:
    crs = document.get("crs")
    if crs is None:
        return
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = str(properties.get("name", "") if isinstance(properties, dict) else crs)
    if not name.upper().endswith(("CRS84", "EPSG::4326", "EPSG:4326")):
        raise InputError(
            f"{source}: coordinate system {name[:60]!r}; WGS84 longitude and latitude are needed"
        )


def _check_shape(area: Area, source: str) -> None:
    for number, rings in enumerate(area.polygons, start=1):
        polygon = _one_shape(rings)
        if not polygon.is_valid:
            which = f"polygon {number} of {len(area.polygons)}" if len(area.polygons) > 1 else "the polygon"
            reason = explain_validity(polygon).replace("[", " near longitude, latitude [")
            raise InputError(
                f"{source}: {which} is not valid: {reason}; an outline that does not cross itself is needed"
            )


def _check_extent(area: Area, source: str) -> None:
    west, south, east, north = _shape(area).bounds
    if east - west > 180.0:
        raise InputError(
            f"{source}: the area spans {east - west:g} degrees of longitude; across ±180 is not supported"
        )
    shrink = math.cos(math.radians((south + north) / 2))
    width_m, height_m = (east - west) * _METERS_PER_DEG * shrink, (north - south) * _METERS_PER_DEG
    if max(width_m, height_m) > MAX_EXTENT_M:
        raise InputError(
            f"{source}: the area is {width_m / 1000:.0f} by {height_m / 1000:.0f} km; "
            f"at most {MAX_EXTENT_M / 1000:g} km across is supported"
        )
    if min(width_m, height_m) < 1.0:
        raise InputError(
            f"{source}: the area is {width_m:.2g} by {height_m:.2g} m; at least 1 m across is needed"
        )


def _without_overlap(area: Area) -> Area:
    shape = _shape(area)
    if shape.is_valid:
        return area
    union = shapely.union_all([_one_shape(rings) for rings in area.polygons])
    parts = list(union.geoms) if isinstance(union, MultiPolygon) else [union]
    return Area(tuple(_rings(part) for part in parts if isinstance(part, Polygon)), area.name)


def _rings(polygon: Polygon) -> tuple[Ring, ...]:
    rings = [polygon.exterior, *polygon.interiors]
    return tuple(tuple((float(y), float(x)) for x, y, *_ in ring.coords) for ring in rings)


def _one_shape(rings: tuple[Ring, ...]) -> Polygon:
    outer, *holes = [[(longitude, latitude) for latitude, longitude in ring] for ring in rings]
    return Polygon(outer, holes)


def _shape(area: Area) -> MultiPolygon:
    return MultiPolygon([_one_shape(rings) for rings in area.polygons])


def _distance_m(box: Polygon, longitude_deg: float, latitude_deg: float) -> float:
    """Roughly, from the nearest place of ``box``: enough to tell kilometres from continents."""
    if abs(latitude_deg) > 90.0:
        return math.inf
    west, south, east, north = box.bounds
    nearest_longitude = min(max(longitude_deg, west), east)
    nearest_latitude = min(max(latitude_deg, south), north)
    shrink = math.cos(math.radians(latitude_deg))
    return _METERS_PER_DEG * math.hypot(
        (longitude_deg - nearest_longitude) * shrink, latitude_deg - nearest_latitude
    )


def _show(corner: tuple[float, float]) -> str:
    return f"[{corner[1]:g}, {corner[0]:g}]"
