"""The real ArduCopter recording with the simulated radio sensor overlaid: the same engines."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

pytestmark = pytest.mark.timeout(240)


def points(path: Path) -> dict[str, dict]:
    features = json.loads(path.read_text())["features"]
    return {f["properties"]["beacon_id"]: f for f in features if f["geometry"]["type"] == "Point"}


@pytest.fixture(scope="module")
def overlaid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording with sensor frames, made once."""
    from sim_sitl.overlay import overlay
    from sim_sitl.radio_sensor import SensorSettings
    from sim_sitl.scenario_file import load_scenario

    folder = tmp_path_factory.mktemp("overlaid")
    recording = Path(__file__).resolve().parents[1] / "data" / "arducopter-4x.tlog"
    out = folder / "out.tlog"
    overlay(recording, load_scenario("open-field"), 3, out, SensorSettings(cir_every=2), None)
    return out


def test_the_overlaid_recording_is_located_and_gives_the_same_bytes_again(
    overlaid: Path, cli, tmp_path
) -> None:
    first = cli("replay", overlaid, "--format", "geojson", "--out", "first.geojson", timeout_s=150)
    assert first.returncode == 0, first.stderr
    again = cli("replay", overlaid, "--format", "geojson", "--out", "again.geojson", timeout_s=150)
    assert again.returncode == 0, again.stderr
    assert (tmp_path / "first.geojson").read_bytes() == (tmp_path / "again.geojson").read_bytes()
    truth = json.loads(overlaid.with_suffix(".truth.json").read_text())["beacons"]
    found = points(tmp_path / "first.geojson")
    for beacon in truth:
        longitude, latitude = found[beacon["id"]]["geometry"]["coordinates"][:2]
        north = (latitude - beacon["lat"]) * 111_320
        east = (longitude - beacon["lon"]) * 111_320 * math.cos(math.radians(latitude))
        assert math.hypot(east, north) < 15, beacon["id"]


def test_a_recording_without_radio_measurements_gives_no_beacon_and_says_nothing_wrong(
    cli, recording
) -> None:
    done = cli("replay", recording, "--format", "json", "--quiet")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == [] or json.loads(done.stdout).get("targets") == []


def test_a_truncated_recording_is_read_to_its_end(overlaid: Path, cli, tmp_path) -> None:
    cut = tmp_path / "cut.tlog"
    cut.write_bytes(overlaid.read_bytes()[:400_001])
    done = cli("replay", cut, "--format", "csv", "--quiet")
    assert done.returncode == 0, done.stderr
    assert "stops within a frame" in done.stderr


@pytest.mark.parametrize("name", ["json", "geojson", "kml", "gpx", "csv"])
def test_every_format_is_written(overlaid: Path, cli, tmp_path, name: str) -> None:
    cut = tmp_path / "cut.tlog"
    cut.write_bytes(overlaid.read_bytes()[:600_000])
    done = cli("replay", cut, "--format", name, "--out", f"out.{name}", "--quiet")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / f"out.{name}").stat().st_size > 40
