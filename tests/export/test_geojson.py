"""GeoJSON: the properties that others build against, valid geometry, same bytes."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import permutations

from shapely.geometry import shape

from groundstation.domain.target import TargetState
from groundstation.export.geojson import encode_geojson

Belief = Callable[..., TargetState]
MakeRing = Callable[[float, float, float], tuple[tuple[float, float], ...]]


def test_the_contract(belief: Belief) -> None:
    document = json.loads(encode_geojson([belief()]))
    assert document["type"] == "FeatureCollection"
    point, circle = document["features"]
    assert point["geometry"] == {"type": "Point", "coordinates": [149.1654123, -35.3625123]}
    properties = point["properties"]
    assert properties["beacon_id"] == "18446744073709551615"
    assert properties["altitude_amsl_m"] == 584.26
    assert properties["radius_90_m"] == 8.46
    assert properties["environment"] == "MIXED"
    assert properties["time_ns"] == "1795311900250000000"
    assert circle["geometry"]["type"] == "Polygon"
    assert circle["properties"]["beacon_id"] == "18446744073709551615"
    assert circle["properties"]["containment"] == 0.9
    assert shape(circle["geometry"]).contains(shape(point["geometry"]))


def test_joined_ids_and_a_walk_come_last_and_disturb_nothing(belief: Belief) -> None:
    plain = json.loads(encode_geojson([belief()]))["features"][0]["properties"]
    assert list(plain)[-2:] == ["walking_probability", "joined_beacon_ids"]
    assert (plain["walking_probability"], plain["joined_beacon_ids"]) == (None, [])
    told = belief(walking_probability=0.61249, joined_beacon_ids=(2**64 - 2, 5))
    point, region = json.loads(encode_geojson([told]))["features"]
    assert point["properties"]["walking_probability"] == 0.612
    assert point["properties"]["joined_beacon_ids"] == ["5", "18446744073709551614"]
    assert {**point["properties"], "walking_probability": None, "joined_beacon_ids": []} == plain
    assert region["properties"]["containment"] == 0.9


def test_regions_of_tracking(belief: Belief, ring: MakeRing) -> None:
    regions = ((0.5, (ring(1, 1, 0.1),)), (0.9, (ring(1, 1, 0.2), ring(3, 3, 0.1))))
    document = json.loads(encode_geojson([belief(regions=regions)]))
    kinds = [
        (item["geometry"]["type"], item["properties"].get("containment")) for item in document["features"]
    ]
    assert kinds == [("Point", None), ("Polygon", 0.5), ("MultiPolygon", 0.9)]
    assert all(shape(item["geometry"]).is_valid for item in document["features"])


def test_same_beliefs_same_bytes(belief: Belief) -> None:
    beliefs = [belief(beacon_id=n) for n in (1, 2, 3)]
    assert len({encode_geojson(list(order)) for order in permutations(beliefs)}) == 1


def test_nothing_heard_is_an_empty_collection() -> None:
    assert json.loads(encode_geojson([])) == {"type": "FeatureCollection", "features": []}


def test_what_is_not_finite_is_null(belief: Belief) -> None:
    document = json.loads(encode_geojson([belief(radius_90_m=float("inf"))]))
    (point,) = document["features"]
    assert point["properties"]["radius_90_m"] is None
