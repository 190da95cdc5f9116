"""Scenario files: what is shipped is whole, and what is wrong costs one clear line."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.domain.errors import InputError
from sim_sitl.scenario_file import SHIPPED, load_scenario

GOOD = """
version = 1
name = "test"
[origin]
latitude_deg = 47.0
longitude_deg = 8.0
altitude_amsl_m = 400
[area]
radius_m = 100
[fence]
polygon_m = [[-200, -200], [200, -200], [200, 200], [-200, 200]]
[[beacons]]
id = 7
position_m = [1.0, 2.0]
"""


@pytest.fixture
def load(tmp_path: Path) -> object:
    def read(text: str) -> object:
        path = tmp_path / "scenario.toml"
        path.write_text(text, encoding="utf-8")
        return load_scenario(str(path))

    return read


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenarios_hold_beacons_in_their_area_and_the_ring_in_the_fence(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert len(scenario.beacons) >= 3
    for beacon in scenario.beacons:
        east, north, up = beacon.position_enu_m
        assert scenario.area.contains(east, north)
        assert scenario.target_height_min_m <= up <= scenario.target_height_max_m
        assert 13.0 <= beacon.transmit_power_dbm <= 18.0
        assert beacon.frequency_hz == 867_500_000
    radius = scenario.vehicles.ring_radius_m
    for east, north in ((radius, 0), (-radius, 0), (0, radius), (0, -radius)):
        assert scenario.fence.contains(east, north)


def test_a_good_file_is_read(load: object) -> None:
    scenario = load(GOOD)  # type: ignore[operator]
    assert scenario.beacons[0].position_enu_m == (1.0, 2.0, 1.0)
    assert scenario.area.radius_m == 100.0
    assert scenario.propagation.los_exponent == 2.5


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("version = 1", "version = 2", ("version", "2", "from 1 to 1")),
        ("latitude_deg = 47.0", "latitude_deg = 147.0", ("origin.latitude_deg", "147", "from -90 to 90")),
        ("latitude_deg = 47.0", "", ("origin.latitude_deg", "missing", "a number")),
        ("latitude_deg = 47.0", 'latitude_deg = "north"', ("origin.latitude_deg", "'north'", "a number")),
        ("latitude_deg = 47.0", "latitude_deg = true", ("origin.latitude_deg", "True", "a number")),
        ("latitude_deg = 47.0", "latitude_deg = nan", ("origin.latitude_deg", "nan", "a number")),
        ("id = 7", "id = 0", ("beacons[0].id", "0", "whole number")),
        (
            "id = 7",
            "id = 7\nburried_depth_m = 2",
            ("beacons[0].burried_depth_m", "unknown key", "buried_depth_m"),
        ),
        ("position_m = [1.0, 2.0]", "position_m = [1.0]", ("beacons[0].position_m", "[1.0]", "2 numbers")),
        ("radius_m = 100", "polygon_m = [[0, 0], [1, 1]]", ("area.polygon_m", "three")),
        ("[area]", "[areas]", ("area", "missing", "[area]")),
        (
            "[fence]",
            "[propagation]\nnlos_model = 'tunnel'\n[fence]",
            ("propagation.nlos_model", "'tunnel'", '"rubble"'),
        ),
        ("[fence]", "[propagation]\nnlos_exponent = [3, 2]\n[fence]", ("propagation.nlos_exponent", "least")),
        ("[fence]", "[fence", ("not valid TOML", "line")),
        (
            "[[beacons]]",
            "[[beacons]]\nid = 7\nposition_m = [0, 0]\n[[beacons]]",
            ("beacons[1].id", "7", "no other"),
        ),
    ],
)
def test_a_malformed_file_says_file_key_seen_and_needed(
    load: object, old: str, new: str, parts: tuple[str, ...]
) -> None:
    assert old in GOOD
    with pytest.raises(InputError) as error:
        load(GOOD.replace(old, new))  # type: ignore[operator]
    text = str(error.value)
    assert "\n" not in text
    for part in ("scenario.toml", *parts):
        assert part in text


def test_a_missing_scenario_names_what_there_is() -> None:
    with pytest.raises(InputError, match="open-field, rubble, city-block"):
        load_scenario("open-feild")
    with pytest.raises(InputError, match=r"nowhere/x\.toml.*cannot be read"):
        load_scenario("nowhere/x.toml")
