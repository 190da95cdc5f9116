"""KML 2.2: a folder for each beacon with its place and its containment regions.

Altitudes are above mean sea level, which is what KML's ``absolute`` means.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree.ElementTree import Element

from groundstation.domain.target import Environment, TargetState
from groundstation.export.markup import child, document
from groundstation.export.regions import Region, regions_of
from groundstation.export.rounding import (
    METRE_DECIMALS,
    PROBABILITY_DECIMALS,
    degrees,
    describe,
    iso_time,
    joined_ids,
    newest,
    number,
)

_COLOURS = {
    Environment.LOS: "ff50af4c",
    Environment.MIXED: "ff07c1ff",
    Environment.NLOS: "ff3643f4",
    Environment.UNKNOWN: "ff9e9e9e",
}
"""aabbggrr."""


def encode_kml(targets: Sequence[TargetState]) -> bytes:
    """The newest belief of each beacon, by beacon id."""
    root = Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    top = child(root, "Document")
    child(top, "name", "Beacons")
    for environment, colour in _COLOURS.items():
        _style(top, environment, colour)
    for target in newest(targets):
        folder = child(top, "Folder")
        child(folder, "name", f"Beacon {target.beacon_id}")
        _place(folder, target)
        for region in regions_of(target):
            _region(folder, target, region)
    return document(root)


def _style(parent: Element, environment: Environment, colour: str) -> None:
    style = child(parent, "Style", id=environment.name)
    child(child(style, "IconStyle"), "color", colour)
    child(child(style, "LineStyle"), "color", colour)
    child(child(style, "PolyStyle"), "color", "40" + colour[2:])


def _placemark(parent: Element, target: TargetState, name: str) -> Element:
    placemark = child(parent, "Placemark")
    child(placemark, "name", name)
    child(placemark, "description", describe(target))
    if when := iso_time(target.time_ns):
        child(child(placemark, "TimeStamp"), "when", when)
    child(placemark, "styleUrl", f"#{target.environment.name}")
    return placemark


def _place(parent: Element, target: TargetState) -> None:
    placemark = _placemark(parent, target, str(target.beacon_id))
    facts = {
        "beacon_id": str(target.beacon_id),
        "altitude_amsl_m": _text(target.position.altitude_amsl_m),
        "radius_90_m": _text(target.radius_90_m),
        "environment": target.environment.name,
        "time_ns": str(target.time_ns),
        "method": target.method,
        "height_reference": target.height_reference,
        "walking_probability": _text(target.walking_probability, PROBABILITY_DECIMALS),
        "joined_beacon_ids": " ".join(joined_ids(target)),
    }
    _data(placemark, facts)
    point = child(placemark, "Point")
    child(point, "altitudeMode", "absolute")
    place = target.position
    altitude = number(place.altitude_amsl_m) or 0.0
    child(
        point, "coordinates", f"{_degrees(place.longitude_deg)},{_degrees(place.latitude_deg)},{altitude:.2f}"
    )


def _region(parent: Element, target: TargetState, region: Region) -> None:
    placemark = _placemark(parent, target, f"{region.containment * 100:g} % region")
    facts = {
        "beacon_id": str(target.beacon_id),
        "containment": _text(region.containment, PROBABILITY_DECIMALS),
        "time_ns": str(target.time_ns),
    }
    _data(placemark, facts)
    group = placemark if len(region.polygons) == 1 else child(placemark, "MultiGeometry")
    for outer, *holes in region.polygons:
        polygon = child(group, "Polygon")
        for tag, ring in [("outerBoundaryIs", outer), *(("innerBoundaryIs", hole) for hole in holes)]:
            line = child(child(polygon, tag), "LinearRing")
            corners = " ".join(f"{_degrees(longitude)},{_degrees(latitude)}" for longitude, latitude in ring)
            child(line, "coordinates", corners)


def _data(placemark: Element, facts: dict[str, str]) -> None:
    data = child(placemark, "ExtendedData")
    for name, value in facts.items():
        child(child(data, "Data", name=name), "value", value)


def _degrees(value_deg: float) -> str:
    return f"{degrees(value_deg):.7f}"


def _text(value: float | None, decimals: int = METRE_DECIMALS) -> str:
    rounded = number(value, decimals)
    return "" if rounded is None else f"{rounded:.{decimals}f}"
