"""What a vehicle does not hear, through the whole chain: simulator, service, journal, replay."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from groundstation.domain.geometry import Geodetic, LocalFrame

pytestmark = pytest.mark.timeout(240)

SCENARIO = """
version = 1
name = "quiet-corner"
title = "Two vehicles hover far apart; the phone under rubble is near the first, the second cannot hear it"
placement = "absolute"

[origin]
latitude_deg = -35.3625
longitude_deg = 149.1654
altitude_amsl_m = 584.0

[area]
radius_m = 170.0

[fence]
radius_m = 400.0

[target]
height_m = [0.0, 20.0]

[vehicles]
ring_radius_m = 90.0
altitude_m = 50.0
pattern = "hover"

[[beacons]]
id = 7001
position_m = [120.0, 40.0]
height_m = 2.0
transmit_power_dbm = 15.0
packet_interval_s = 0.5
buried_depth_m = 1.5

[[beacons]] # strong, between the two: what proves that the second receiver is alive
id = 7002
position_m = [0.0, 10.0]
height_m = 2.0
transmit_power_dbm = 25.0
packet_interval_s = 0.5
buried_depth_m = 1.5

[propagation] # hardly any chance in it: the first link is 3 dB above the sensitivity, the second 7 dB below
los_shadowing_db = 0.5
los_rician_k_db = 25.0
nlos_exponent = [2.5, 2.5]
nlos_shadowing_db = 0.5
nlos_rician_k_db = 25.0

[receiver]
noise_figure_db = 39.0
sensitivity_dbm = -68.0
"""
FRAME = LocalFrame(Geodetic(-35.3625, 149.1654, 584.0))
BEACON_M = (120.0, 40.0)
SILENT_M = (-90.0, 0.0)
"""Under the second vehicle: it hovers opposite the first."""
NEAR_M = 60.0
FALLEN_PERCENT = 5.0


def east_north_m(latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    east, north, _ = FRAME.to_enu(Geodetic(latitude_deg, longitude_deg, 584.0))
    return east, north


def _share_near(
    share: Any, west_m: float, north_m: float, cell_m: float, middle_m: tuple[float, float]
) -> float:
    """What lies within ``NEAR_M`` of a place, of a raster (rows from the north, columns)."""
    rows, columns = share.shape
    east = west_m + cell_m * (np.arange(columns) + 0.5)
    north = north_m - cell_m * (np.arange(rows) + 0.5)
    near = np.hypot(east[None, :] - middle_m[0], north[:, None] - middle_m[1]) < NEAR_M
    return float(share[near].sum())


def share_near(grid: Path, middle_m: tuple[float, float]) -> float:
    """The same of an ESRI ASCII grid, percent."""
    lines = grid.read_text().splitlines()
    head = {name: float(value) for name, value in (line.split() for line in lines[:6])}
    share = np.array([[float(word) for word in line.split()] for line in lines[6:]])
    north_m = head["yllcorner"] + share.shape[0] * head["cellsize"]
    return _share_near(share, head["xllcorner"], north_m, head["cellsize"], middle_m)


def test_the_belief_falls_where_a_vehicle_listened_and_heard_nothing(
    tmp_path: Path, cli, background, until
) -> None:
    (tmp_path / "quiet.toml").write_text(SCENARIO)
    done = cli("scenario", "quiet.toml", "--area", "area.json", "--fence", "f.json", program="sim_sitl.cli")
    assert done.returncode == 0, done.stderr
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio,
        socket.socket(socket.AF_INET, socket.SOCK_STREAM) as page,
    ):
        for probe in (radio, page):
            probe.bind(("127.0.0.1", 0))
        udp, http = radio.getsockname()[1], page.getsockname()[1]
    station = background(
        "groundstation.cli", "serve", "--link", f"udpin:127.0.0.1:{udp}", "--http", f"127.0.0.1:{http}",
        "--area", "area.json", "--data-dir", "sessions", "--set", "estimator.silence_interval_s=3",
    )  # fmt: skip

    def get(path: str) -> Any:
        answer = httpx.get(f"http://127.0.0.1:{http}/{path}", timeout=10)
        return answer if answer.status_code == 200 else None

    until("the service answers", lambda: get("api/v1/health"))
    background(
        "sim_sitl.cli", "swarm", "--link", f"udpout:127.0.0.1:{udp}", "--vehicles", 2, "--quiet",
        "--scenario", "quiet.toml", "--seed", 3, "--angles", "off",
    )  # fmt: skip

    def answered() -> float:
        """Share of the live belief near the vehicle that hears nothing, percent; all before there is one."""
        found = get("api/v1/targets/7001/search-map")
        if found is None:
            return 100.0
        raster = found.json()
        share = 100.0 * np.array(raster["probability"]).reshape(raster["rows"], raster["columns"])
        return _share_near(share, raster["west_m"], raster["north_m"], raster["cell_size_m"], SILENT_M)

    # Even over the area it were 12 %; by what the first vehicle hears alone it stays there.
    until(
        "the live search map falls where nothing was heard",
        lambda: answered() < FALLEN_PERCENT,
        timeout_s=120,
    )
    links = {
        (row["vehicle_id"], row["beacon_id"]): row["samples_total"]
        for row in get("api/v1/links").json()["links"]
    }
    assert set(links) == {(1, "7001"), (1, "7002"), (2, "7002")}
    assert station.stop() == 0

    # What the service answered, and what it would have answered had silence meant nothing to it.
    (session,) = (tmp_path / "sessions").iterdir()
    silence_off = ("--config", session / "settings.toml", "--set", "estimator.tracking.silence_doubt=1")
    positions, near_silent, near_beacon = {}, {}, {}
    for name, more in (("on", ()), ("off", silence_off)):
        again = cli(
            "replay", session, "--format", "geojson", "--out", f"{name}.json", "--search-maps", name, *more
        )
        assert again.returncode == 0, again.stderr
        features = json.loads((tmp_path / f"{name}.json").read_text())["features"]
        longitude_deg, latitude_deg = next(
            feature["geometry"]["coordinates"] for feature in features if feature.get("id") == "7001"
        )
        grid = tmp_path / name / "beacon-7001-probability.asc"
        positions[name] = east_north_m(latitude_deg, longitude_deg)
        near_silent[name], near_beacon[name] = share_near(grid, SILENT_M), share_near(grid, BEACON_M)
    assert json.loads((tmp_path / "on.json").read_text()) == json.loads(
        (session / "targets.geojson").read_text()
    )
    assert near_silent["off"] > 5.0
    assert near_silent["on"] < 0.6 * near_silent["off"]
    assert near_beacon["on"] > 1.3 * near_beacon["off"]
    # Away from where nothing was heard: the vehicles stand west and east of the middle.
    assert positions["on"][0] > positions["off"][0] + 20.0
