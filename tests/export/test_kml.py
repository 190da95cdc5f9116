"""KML, read back by a parser that is not ours."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from lxml import etree

from groundstation.domain.target import TargetState
from groundstation.export.kml import encode_kml

Belief = Callable[..., TargetState]
MakeRing = Callable[[float, float, float], tuple[tuple[float, float], ...]]
KML = {"k": "http://www.opengis.net/kml/2.2"}


def test_places_and_regions(belief: Belief, ring: MakeRing) -> None:
    regions = ((0.5, (ring(1, 2, 0.2), ring(1, 2, 0.1))), (0.9, (ring(1, 2, 0.2), ring(3, 4, 0.1))))
    root = etree.fromstring(encode_kml([belief(regions=regions), belief(beacon_id=4)]))
    assert root.xpath("//k:Folder/k:name/text()", namespaces=KML) == [
        "Beacon 4",
        "Beacon 18446744073709551615",
    ]
    (folder,) = root.xpath("//k:Folder[2]", namespaces=KML)
    point, half, most = folder.findall("k:Placemark", KML)
    assert point.findtext("k:Point/k:coordinates", namespaces=KML) == "149.1654123,-35.3625123,584.26"
    assert point.findtext("k:Point/k:altitudeMode", namespaces=KML) == "absolute"
    assert point.findtext("k:TimeStamp/k:when", namespaces=KML) == "2026-11-22T01:45:00.250Z"
    data = {
        item.get("name"): item.findtext("k:value", namespaces=KML)
        for item in point.iterfind(".//k:Data", KML)
    }
    assert data["radius_90_m"] == "8.46"
    assert data["method"] == "posterior <&>"
    assert (data["walking_probability"], data["joined_beacon_ids"]) == ("", "")
    shares = [
        item.xpath(".//k:Data[@name='containment']/k:value/text()", namespaces=KML) for item in (half, most)
    ]
    assert shares == [["0.500"], ["0.900"]]
    assert len(half.findall("k:Polygon/k:innerBoundaryIs", KML)) == 1
    assert len(most.findall("k:MultiGeometry/k:Polygon", KML)) == 2
    for line in root.iterfind(".//k:LinearRing/k:coordinates", KML):
        corners = line.text.split()
        assert corners[0] == corners[-1]
        assert len(corners) >= 4


def test_every_style_that_is_used_is_there_and_children_stand_in_the_schemas_order(belief: Belief) -> None:
    root = etree.fromstring(encode_kml([belief()]))
    styles = {f"#{item.get('id')}" for item in root.iterfind(".//k:Style", KML)}
    assert {item.text for item in root.iterfind(".//k:styleUrl", KML)} <= styles
    order = [
        "name",
        "description",
        "TimeStamp",
        "styleUrl",
        "ExtendedData",
        "Point",
        "Polygon",
        "MultiGeometry",
    ]
    for placemark in root.iterfind(".//k:Placemark", KML):
        places = [order.index(etree.QName(item).localname) for item in placemark]
        assert places == sorted(places)


def test_joined_ids_and_a_walk_are_told_to_people_and_programs(belief: Belief) -> None:
    told = belief(walking_probability=0.61249, joined_beacon_ids=(2**64 - 2, 5))
    root = etree.fromstring(encode_kml([told]))
    values = {
        name: root.xpath(f"//k:Data[@name='{name}']/k:value/text()", namespaces=KML)
        for name in ("walking_probability", "joined_beacon_ids")
    }
    assert values == {
        "walking_probability": ["0.612"],
        "joined_beacon_ids": ["5 18446744073709551614"],
    }
    lines = root.xpath("//k:description/text()", namespaces=KML)
    assert lines
    for line in lines:
        assert "may be walking (61 %)" in line
        assert "with 5, 18446744073709551614:" in line
    still = etree.fromstring(encode_kml([belief(walking_probability=0.19)]))
    assert not any("walking" in line for line in still.xpath("//k:description/text()", namespaces=KML))


@pytest.mark.parametrize("text", ["<b>&\"'", "bell \x07", "lone \ud800", "漢字 😀"])
def test_any_text_is_well_formed(belief: Belief, text: str) -> None:
    root = etree.fromstring(encode_kml([belief(method=text)]))
    found = root.xpath("//k:Data[@name='method']/k:value/text()", namespaces=KML)
    assert found == [text.replace("\x07", "\ufffd").replace("\ud800", "\ufffd")]


def test_empty_and_repeatable(belief: Belief) -> None:
    assert etree.fromstring(encode_kml([])).findall(".//k:Folder", KML) == []
    assert encode_kml([belief()]) == encode_kml([belief()])
