"""GeoJSON (RFC 7946): a point for each beacon, a polygon for each containment region.

Rule: positions have two numbers. The third of RFC 7946 is a height above the ellipsoid, which
we do not have: the altitude above mean sea level is the property ``altitude_amsl_m``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import orjson

from groundstation.domain.target import TargetState
from groundstation.export.regions import Region, regions_of
from groundstation.export.rounding import (
    PROBABILITY_DECIMALS,
    degrees,
    iso_time,
    joined_ids,
    newest,
    number,
)


def encode_geojson(targets: Sequence[TargetState]) -> bytes:
    """FeatureCollection of the newest belief of each beacon, by beacon id."""
    features: list[dict[str, Any]] = []
    for target in newest(targets):
        features.append(point_feature(target))
        features.extend(region_feature(target, region) for region in regions_of(target))
    collection = {"type": "FeatureCollection", "features": features}
    return orjson.dumps(collection, option=orjson.OPT_INDENT_2) + b"\n"


def point_feature(target: TargetState) -> dict[str, Any]:
    """The estimate; ids and ``time_ns`` are decimal text. New properties come last, known ones stay."""
    place = target.position
    return {
        "type": "Feature",
        "id": str(target.beacon_id),
        "geometry": {
            "type": "Point",
            "coordinates": [degrees(place.longitude_deg), degrees(place.latitude_deg)],
        },
        "properties": {
            "beacon_id": str(target.beacon_id),
            "altitude_amsl_m": number(place.altitude_amsl_m),
            "radius_90_m": number(target.radius_90_m),
            "environment": target.environment.name,
            "time_ns": str(target.time_ns),
            "time": iso_time(target.time_ns),
            "last_heard_ns": str(target.last_heard_ns),
            "los_links": target.los_links,
            "links": target.links,
            "windows": target.windows,
            "method": target.method,
            "height_reference": target.height_reference,
            "covariance_enu_m2": [number(value, 4) for value in target.covariance_enu_m2],
            "walking_probability": number(target.walking_probability, PROBABILITY_DECIMALS),
            "joined_beacon_ids": joined_ids(target),
        },
    }


def region_feature(target: TargetState, region: Region) -> dict[str, Any]:
    """One region: Polygon, or MultiPolygon when it has several parts."""
    coordinates: Any = region.polygons[0] if len(region.polygons) == 1 else region.polygons
    kind = "Polygon" if len(region.polygons) == 1 else "MultiPolygon"
    return {
        "type": "Feature",
        "geometry": {"type": kind, "coordinates": coordinates},
        "properties": {
            "beacon_id": str(target.beacon_id),
            "containment": number(region.containment, 4),
            "time_ns": str(target.time_ns),
        },
    }
