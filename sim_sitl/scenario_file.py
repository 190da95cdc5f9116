"""Scenario files: TOML to :class:`Scenario`, shipped ones by name.

Keeps the rule that every number is checked where it is read; docs/scenarios.md is the page
for people who write such files.
"""

from __future__ import annotations

import math
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from groundstation.domain.errors import InputError
from groundstation.domain.geometry import Geodetic
from sim_sitl.checked_toml import Table, read_toml, read_toml_file
from sim_sitl.scenario import (
    BeaconSpec,
    Obstacle,
    PropagationSpec,
    ReceiverSpec,
    Region,
    Ring2d,
    Scenario,
    VehicleSpec,
    disc,
    polygon,
)

VERSION = 1
SHIPPED = ("open-field", "rubble", "city-block", "deep-rubble")
"""Names that ``load_scenario`` knows without a file."""


def load_scenario(name_or_file: str) -> Scenario:
    """A shipped scenario by name, or any other from its file.

    Raises:
        InputError: no such scenario or file, or something in it cannot be used.
    """
    if name_or_file in SHIPPED:
        text = (resources.files("sim_sitl") / "scenarios" / f"{name_or_file}.toml").read_text(
            encoding="utf-8"
        )
        return parse_scenario(read_toml(text, f"{name_or_file}.toml"))
    path = Path(name_or_file)
    if not path.exists() and path.suffix == "" and path.parent == Path():
        raise InputError(
            f"scenario {name_or_file!r}: no shipped scenario or file of that name; "
            f"needed: {', '.join(SHIPPED)} or a TOML file"
        )
    return parse_scenario(read_toml_file(path))


def parse_scenario(top: Table) -> Scenario:
    """A scenario from its file's top table; raises InputError."""
    top.integer("version", low=VERSION, high=VERSION)
    origin = top.table("origin", required=True)
    target = top.table("target")
    height_min, height_max = target.interval("height_m", (0.0, 20.0), low=-100, high=500)
    scenario = Scenario(
        name=top.text("name"),
        title=top.text("title", ""),
        origin=Geodetic(
            origin.number("latitude_deg", low=-90, high=90),
            origin.number("longitude_deg", low=-180, high=180),
            origin.number("altitude_amsl_m", low=-500, high=9000),
        ),
        relative=top.text("placement", "relative", choices=("relative", "absolute")) == "relative",
        area=_region(top.table("area", required=True)),
        fence=_region(top.table("fence", required=True)),
        target_height_min_m=height_min,
        target_height_max_m=height_max,
        beacons=tuple(_beacon(table) for table in top.tables("beacons")),
        obstacles=tuple(_obstacle(table, i) for i, table in enumerate(top.tables("obstacles"))),
        vehicles=_vehicles(top.table("vehicles")),
        propagation=_propagation(top.table("propagation")),
        receiver=_receiver(top.table("receiver")),
    )
    origin.finish()
    target.finish()
    top.finish()
    ids = [beacon.beacon_id for beacon in scenario.beacons]
    for i, beacon_id in enumerate(ids):
        if beacon_id in ids[:i]:
            raise top.wrong(f"beacons[{i}].id", beacon_id, "an id that no other beacon of the file has")
    return scenario


def _region(table: Table) -> Region:
    if "polygon_m" in table:
        region = polygon(table.corners("polygon_m"))
    else:
        center = table.numbers("center_m", 2, (0.0, 0.0), low=-1e5, high=1e5)
        region = disc((center[0], center[1]), table.number("radius_m", low=1, high=1e5))
    table.finish()
    return region


def _beacon(table: Table) -> BeaconSpec:
    east, north = table.numbers("position_m", 2, low=-1e5, high=1e5)
    beacon = BeaconSpec(
        beacon_id=table.integer("id", low=1, high=2**64 - 1),
        position_enu_m=(east, north, table.number("height_m", 1.0, low=-100, high=500)),
        transmit_power_dbm=table.number("transmit_power_dbm", 15.0, low=-40, high=40),
        packet_interval_s=table.number("packet_interval_s", 1.0, low=0.02, high=3600),
        frequency_hz=table.integer("frequency_hz", 867_500_000, low=1_000_000, high=4_000_000_000),
        buried_depth_m=table.number("buried_depth_m", 0.0, low=0, high=100),
    )
    table.finish()
    return beacon


def _obstacle(table: Table, index: int) -> Obstacle:
    if "polygon_m" in table:
        corners: Ring2d = table.corners("polygon_m")
    else:
        east, north = table.numbers("center_m", 2, low=-1e5, high=1e5)
        width, depth = table.numbers("size_m", 2, low=0.01, high=1e5)
        corners = _box(east, north, width, depth, table.number("rotation_deg", 0.0, low=-360, high=360))
    base = table.number("base_m", 0.0, low=-100, high=1000)
    obstacle = Obstacle(
        name=table.text("name", f"obstacle {index + 1}"),
        corners_m=corners,
        base_m=base,
        top_m=table.number("top_m", low=base, high=1000),
        attenuation_db_per_m=table.number("attenuation_db_per_m", 1.0, low=0, high=1000),
        entry_loss_db=table.number("entry_loss_db", 3.0, low=0, high=200),
    )
    table.finish()
    return obstacle


def _box(east_m: float, north_m: float, width_m: float, depth_m: float, rotation_deg: float) -> Ring2d:
    """Corners of a box, turned counter-clockwise about its centre."""
    cosine, sine = math.cos(math.radians(rotation_deg)), math.sin(math.radians(rotation_deg))
    halves = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    return tuple(
        (
            east_m + a * width_m * cosine - b * depth_m * sine,
            north_m + a * width_m * sine + b * depth_m * cosine,
        )
        for a, b in halves
    )


def _vehicles(table: Table) -> VehicleSpec:
    default = VehicleSpec()
    center = table.numbers("ring_center_m", 2, default.ring_center_m, low=-1e5, high=1e5)
    home = table.numbers("home_m", 2, default.home_m, low=-1e5, high=1e5)
    spec = VehicleSpec(
        ring_radius_m=table.number("ring_radius_m", default.ring_radius_m, low=5, high=1e5),
        ring_center_m=(center[0], center[1]),
        altitude_m=table.number("altitude_m", default.altitude_m, low=1, high=1000),
        speed_m_s=table.number("speed_m_s", default.speed_m_s, low=0.1, high=30),
        pattern=table.text("pattern", default.pattern, choices=("orbit", "hover")),
        home_m=(home[0], home[1]),
    )
    table.finish()
    return spec


def _propagation(table: Table) -> PropagationSpec:
    spec = PropagationSpec()
    numbers = {
        "reference_loss_db": (0, 100),
        "report_offset_db": (-200, 200),
        "los_exponent": (1, 6),
        "los_shadowing_db": (0, 30),
        "nlos_bias_max_db": (0, 100),
        "nlos_shadowing_db": (0, 30),
        "shadowing_distance_m": (0.1, 1000),
        "rubble_attenuation_db_per_m": (0, 1000),
        "los_rician_k_db": (-40, 40),
        "nlos_rician_k_db": (-40, 40),
    }
    intervals = {
        "nlos_exponent": (1, 8),
        "rubble_exponent": (1, 8),
        "rubble_excess_db": (0, 100),
        "rubble_shadowing_db": (0, 30),
    }
    values: dict[str, Any] = {}
    for key, (low, high) in numbers.items():
        values[key] = table.number(key, getattr(spec, key), low=low, high=high)
    for key, (low, high) in intervals.items():
        values[key] = table.interval(key, getattr(spec, key), low=low, high=high)
    spec = replace(
        spec,
        **values,
        nlos_model=table.text("nlos_model", spec.nlos_model, choices=("log-distance", "rubble")),
        fading_averages=table.integer("fading_averages", spec.fading_averages, low=1, high=10_000),
    )
    table.finish()
    return spec


def _receiver(table: Table) -> ReceiverSpec:
    spec = ReceiverSpec()
    limits = {
        "bandwidth_hz": (1, 1e10),
        "noise_figure_db": (0, 60),
        "sensitivity_dbm": (-200, 50),
        "level_noise_db": (0, 30),
        "angle_noise_deg": (0, 90),
        "angle_bias_deg": (0, 90),
        "reflection_spread_deg": (0, 180),
        "antenna_beamwidth_deg": (0, 180),
        "antenna_downtilt_deg": (-90, 90),
    }
    values: dict[str, Any] = {
        key: table.number(key, getattr(spec, key), low=low, high=high) for key, (low, high) in limits.items()
    }
    table.finish()
    return replace(spec, **values)
