"""Areas from GeoJSON: what is valid is read exactly, what is not is refused in plain words."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.domain.errors import InputError
from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.mission import LastKnownPlace
from groundstation.mission_files import (
    MAX_POINTS,
    area_geojson,
    disc_area,
    distance_warning,
    parse_area,
    parse_search,
    read_area,
)

SQUARE = [[149.16, -35.37], [149.17, -35.37], [149.17, -35.36], [149.16, -35.36], [149.16, -35.37]]
HOLE = [[149.163, -35.367], [149.163, -35.363], [149.167, -35.363], [149.167, -35.367], [149.163, -35.367]]
BESIDE = [[x + 0.02, y] for x, y in SQUARE]
OVERLAP = [[x + 0.005, y] for x, y in SQUARE]


def polygon(*rings: list[list[float]]) -> dict[str, Any]:
    return {"type": "Polygon", "coordinates": list(rings)}


def feature(geometry: Any, name: str | None = None) -> dict[str, Any]:
    return {"type": "Feature", "properties": None if name is None else {"name": name}, "geometry": geometry}


def parse(document: Any, name: str = "file") -> Any:
    return parse_area(json.dumps(document).encode(), "fence.geojson", name)


def ring(points: list[list[float]]) -> tuple[tuple[float, float], ...]:
    return tuple((y, x) for x, y in points)


def test_a_polygon_with_a_hole_is_read_exactly() -> None:
    area = parse(polygon(SQUARE, HOLE))
    assert area.polygons == ((ring(SQUARE), ring(HOLE)),)
    assert area.name == "file"
    assert area_geojson(area) == polygon(SQUARE, HOLE)


def test_every_wrapping() -> None:
    several = {"type": "MultiPolygon", "coordinates": [[SQUARE], [BESIDE]]}
    two = ((ring(SQUARE),), (ring(BESIDE),))
    assert parse(several).polygons == two
    assert area_geojson(parse(several)) == several
    collection = {
        "type": "FeatureCollection",
        "features": [feature(polygon(SQUARE)), feature(polygon(BESIDE))],
    }
    assert parse(collection).polygons == two
    geometries = {"type": "GeometryCollection", "geometries": [polygon(SQUARE), polygon(BESIDE)]}
    assert parse(feature(geometries, "North face")).polygons == two
    assert parse(feature(polygon(SQUARE), "North face")).name == "North face"


def test_a_third_number_is_ignored_and_a_byte_order_mark_too(tmp_path: Path) -> None:
    file = tmp_path / "area.geojson"
    file.write_bytes(b"\xef\xbb\xbf" + json.dumps(polygon([[x, y, 584.0] for x, y in SQUARE])).encode())
    area = read_area(file)
    assert area.polygons == ((ring(SQUARE),),)
    assert area.name == "area"


def test_overlapping_polygons_are_united() -> None:
    collection = {
        "type": "FeatureCollection",
        "features": [feature(polygon(SQUARE)), feature(polygon(OVERLAP))],
    }
    area = parse(collection)
    assert len(area.polygons) == 1
    (outer,) = area.polygons[0]
    assert outer[0] == outer[-1]
    assert (min(x for _, x in outer), max(x for _, x in outer)) == pytest.approx((149.16, 149.175))


def moved(index: int, position: Any) -> dict[str, Any]:
    points: list[Any] = [list(point) for point in SQUARE]
    points[index] = position
    return polygon(points)


@pytest.mark.parametrize(
    ("document", "parts"),
    [
        ([1], ["not GeoJSON (list without a type)"]),
        ({"type": "FeatureCollection"}, ["FeatureCollection without a list of features"]),
        ({"type": "FeatureCollection", "features": []}, ["no polygon in it"]),
        (feature(None), ["not GeoJSON (null without a type)"]),
        ({"type": "Point", "coordinates": [1, 2]}, ["has a Point; only Polygon and MultiPolygon"]),
        ({"type": "LineString", "coordinates": SQUARE}, ["has a LineString"]),
        (polygon(), ["a polygon without rings"]),
        (polygon(SQUARE[:3]), ["the outer ring has 3 positions; at least 4"]),
        (polygon(SQUARE[:4]), ["is not closed: it begins at [149.16, -35.37] and ends at [149.16, -35.36]"]),
        (polygon(SQUARE, HOLE[:4]), ["hole 1 is not closed"]),
        (polygon(SQUARE, BESIDE), ["not valid: Hole lies outside shell near longitude, latitude"]),
        (
            polygon([SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3], SQUARE[0]]),
            ["Self-intersection", "cross itself"],
        ),
        (moved(1, "here"), ["the position here; [longitude, latitude] is needed"]),
        (moved(1, [149.17]), ["[longitude, latitude] is needed"]),
        (moved(1, [True, False]), ["[longitude, latitude] is needed"]),
        (moved(1, [None, 3.0]), ["[longitude, latitude] is needed"]),
        (moved(1, [690000.0, 6085000.0]), ["metres of a projection", "WGS84"]),
        (polygon([[y, x] for x, y in SQUARE]), ["latitude and longitude look swapped"]),
        (moved(1, [190.0, 10.0]), ["within ±180"]),
        (moved(1, [152.0, -35.37]), ["km; at most 200 km across"]),
        (
            polygon([[-179, 0], [179, 0], [179, 1], [-179, 1], [-179, 0]]),
            ["358 degrees of longitude", "±180"],
        ),
        (polygon([[149, -35], [149.000001, -35], [149.000001, -34.99], [149, -35]]), ["at least 1 m across"]),
        (
            {
                **polygon(SQUARE),
                "crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::3857"}},
            },
            ["coordinate system 'urn:ogc:def:crs:EPSG::3857'", "WGS84"],
        ),
    ],
)
def test_what_is_wrong_is_said(document: Any, parts: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        parse(document)
    message = str(caught.value)
    assert message.startswith("fence.geojson: ")
    assert "\n" not in message
    for part in parts:
        assert part in message


def test_the_usual_name_of_wgs84_is_accepted() -> None:
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}}
    assert parse({**polygon(SQUARE), "crs": crs}).polygons == ((ring(SQUARE),),)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read .*absent\.geojson: No such file"):
        read_area(tmp_path / "absent.geojson")
    with pytest.raises(InputError, match=r"cannot read .*: Is a directory"):
        read_area(tmp_path)
    file = tmp_path / "a.geojson"
    for content in (b"", b"{", b"\xff\xfe\x00", b'{"type": NaN}'):
        file.write_bytes(content)
        with pytest.raises(InputError, match=r"a\.geojson: not valid JSON"):
            read_area(file)
    with file.open("wb") as large:
        large.truncate(10_000_001)
    with pytest.raises(InputError, match="10000001 bytes"):
        read_area(file)


def test_too_many_corners_and_too_deep() -> None:
    count = MAX_POINTS + 1
    circle = [[math.cos(2 * math.pi * i / count), math.sin(2 * math.pi * i / count)] for i in range(count)]
    with pytest.raises(InputError, match=f"{count + 1} corners"):
        parse(polygon([*circle, circle[0]]))
    document: Any = polygon(SQUARE)
    for _ in range(100):
        document = {"type": "GeometryCollection", "geometries": [document]}
    with pytest.raises(InputError, match="nested more than"):
        parse(document)


JSON = st.recursive(
    st.none() | st.booleans() | st.floats(-400, 400) | st.sampled_from(["Polygon", "Feature", "x"]),
    lambda inner: (
        st.lists(inner, max_size=5)
        | st.dictionaries(
            st.sampled_from(
                ["type", "coordinates", "geometry", "features", "geometries", "crs", "properties"]
            ),
            inner,
        )
    ),
    max_leaves=30,
)


@given(JSON | st.builds(lambda rings: {"type": "Polygon", "coordinates": rings}, JSON))
def test_whatever_comes_is_an_area_or_an_input_error(document: Any) -> None:
    message = ""
    area = None
    try:
        area = parse(document)
    except InputError as error:
        message = str(error)
    assert "\n" not in message
    assert (area is None) == message.startswith("fence.geojson: ")


@pytest.mark.parametrize("latitude_deg", [-35.3625, 0.0, 69.0])
def test_a_discs_corners_lie_on_the_circle(latitude_deg: float) -> None:
    center = Geodetic(latitude_deg, 149.1654, 0.0)
    area = disc_area(center, 500.0)
    frame = LocalFrame(center)
    ((outer,),) = area.polygons
    assert outer[0] == outer[-1]
    for latitude, longitude in outer:
        east, north, _ = frame.to_enu(Geodetic(latitude, longitude, 0.0))
        assert math.hypot(east, north) == pytest.approx(500.0, abs=0.01)
    assert parse(area_geojson(area)).polygons == area.polygons


@pytest.mark.parametrize("radius_m", [0.0, -1.0, math.nan, math.inf, 1e9])
def test_a_disc_needs_a_radius(radius_m: float) -> None:
    with pytest.raises(InputError, match="a disc of radius"):
        disc_area(Geodetic(1.0, 2.0, 0.0), radius_m)


def test_an_area_far_from_the_vehicles_is_told() -> None:
    vehicle = Geodetic(45.2, 7.9, 300.0)
    near = disc_area(Geodetic(45.3, 7.9, 0.0), 500.0, "slope")
    swapped = disc_area(Geodetic(7.9, 45.2, 0.0), 500.0, "slope")
    far = disc_area(Geodetic(-35.0, 149.0, 0.0), 500.0, "slope")
    assert distance_warning(near, vehicle) is None
    assert "look swapped" in (distance_warning(swapped, vehicle) or "")
    text = distance_warning(far, vehicle)
    assert text is not None
    assert "'slope' is" in text
    assert "swapped" not in text


def point(**properties: Any) -> dict[str, Any]:
    geometry = {"type": "Point", "coordinates": [149.165, -35.364, 600.0]}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def search(document: Any) -> Any:
    return parse_search(json.dumps(document).encode(), "area.geojson", "file")


def test_last_known_places_stand_beside_the_area() -> None:
    collection = {
        "type": "FeatureCollection",
        "features": [
            point(radius_m=80, name="hut", role="last-known"),
            feature(polygon(SQUARE), "slope"),
            point(radius_m=250.5, beacon_id="18446744073709551615"),
        ],
    }
    area, places = search(collection)
    assert area == parse(feature(polygon(SQUARE), "slope"))
    assert places == (
        LastKnownPlace(-35.364, 149.165, 80.0, "hut", None),
        LastKnownPlace(-35.364, 149.165, 250.5, "", 2**64 - 1),
    )
    assert search(polygon(SQUARE, HOLE)) == (parse(polygon(SQUARE, HOLE)), ())
    alone, places = search(point(radius_m=80))
    assert alone is None
    assert len(places) == 1


@pytest.mark.parametrize(
    ("properties", "expected"),
    [
        ({}, "radius_m None"),
        ({"radius_m": "80"}, "radius_m '80'"),
        ({"radius_m": 0.0}, "1 to 50000 metres"),
        ({"radius_m": True}, "radius_m True"),
        ({"radius_m": 80, "role": "launch"}, "'launch'; 'last-known' is needed"),
        ({"radius_m": 80, "beacon_id": 77}, "beacon_id 77; its digits as text"),
    ],
)
def test_a_point_that_is_no_last_known_place_is_refused(properties: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError, match=expected) as caught:
        search({"type": "FeatureCollection", "features": [feature(polygon(SQUARE)), point(**properties)]})
    assert str(caught.value).startswith("area.geojson: ")


def test_a_fence_has_no_last_known_places() -> None:
    with pytest.raises(InputError, match="has a Point; only Polygon"):
        parse(point(radius_m=80))


def test_a_search_file_is_held_to_the_rules_of_areas() -> None:
    swapped = point(radius_m=80)
    swapped["geometry"]["coordinates"] = [-35.364, 149.165]
    with pytest.raises(InputError, match="look swapped"):
        search(swapped)
    with pytest.raises(InputError, match="no polygon in it"):
        search({"type": "FeatureCollection", "features": []})
