"""GPX, read back by a parser that is not ours, in the order that its schema demands."""

from __future__ import annotations

from collections.abc import Callable

from lxml import etree

from groundstation.domain.geometry import Geodetic
from groundstation.domain.target import TargetState
from groundstation.export.gpx import encode_gpx

Belief = Callable[..., TargetState]
GPX = {"g": "http://www.topografix.com/GPX/1/1"}


def test_a_waypoint_for_each_beacon(belief: Belief) -> None:
    root = etree.fromstring(encode_gpx([belief(beacon_id=9), belief()]))
    assert (root.get("version"), root.get("creator")) == ("1.1", "groundstation")
    first, second = root.findall("g:wpt", GPX)
    assert first.findtext("g:name", namespaces=GPX) == "9"
    assert (second.get("lat"), second.get("lon")) == ("-35.3625123", "149.1654123")
    # The order of wptType in the GPX 1.1 schema.
    assert [etree.QName(item).localname for item in first] == ["ele", "time", "name", "desc", "sym", "type"]
    assert first.findtext("g:ele", namespaces=GPX) == "584.26"
    assert first.findtext("g:time", namespaces=GPX) == "2026-11-22T01:45:00.250Z"


def test_small_numbers_are_not_written_in_powers(belief: Belief) -> None:
    root = etree.fromstring(encode_gpx([belief(position=Geodetic(0.0000012, -0.0000001, 1.0))]))
    waypoint = root.find("g:wpt", GPX)
    assert (waypoint.get("lat"), waypoint.get("lon")) == ("0.0000012", "-0.0000001")


def test_empty_and_repeatable(belief: Belief) -> None:
    assert etree.fromstring(encode_gpx([])).findall("g:wpt", GPX) == []
    assert encode_gpx([belief()]) == encode_gpx([belief()])
