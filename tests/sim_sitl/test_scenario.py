"""Regions and their GeoJSON."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from shapely.geometry import Point, shape

from sim_sitl.scenario import area_geojson, disc, fence_geojson, polygon, write_geojson
from sim_sitl.scenario_file import SHIPPED, load_scenario


@pytest.mark.parametrize("name", SHIPPED)
def test_geojson_is_valid_counterclockwise_and_holds_what_the_region_holds(name: str) -> None:
    scenario = load_scenario(name)
    for feature, region in (
        (area_geojson(scenario), scenario.area),
        (fence_geojson(scenario), scenario.fence),
    ):
        geometry = shape(feature["geometry"])
        assert geometry.is_valid
        assert geometry.exterior.is_ccw
        for beacon in scenario.beacons:
            place = scenario.frame.to_geodetic(beacon.position_enu_m)
            inside = region.contains(*beacon.position_enu_m[:2])
            assert geometry.contains(Point(place.longitude_deg, place.latitude_deg)) == inside


def test_write_geojson_writes_what_is_asked_for(tmp_path: Path) -> None:
    scenario = load_scenario("rubble")
    write_geojson(scenario, tmp_path / "area.geojson", None)
    assert json.loads((tmp_path / "area.geojson").read_text()) == area_geojson(scenario)
    assert list(tmp_path.iterdir()) == [tmp_path / "area.geojson"]


def test_regions_contain_what_lies_inside() -> None:
    notched = polygon(((0, 0), (10, 0), (10, 10), (5, 5), (0, 10)))
    assert notched.contains(2, 2)
    assert not notched.contains(5, 8)
    assert disc((3, 4), 5).contains(0, 0.1)
    assert not disc((3, 4), 5).contains(9, 4)
