"""One vehicle, received power only, no calibration: from the recording to an honest region."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from groundstation.domain.geometry import Geodetic, LocalFrame
from sim_sitl.surveyor import ORIGIN, Survey, draw, fly, write_area, write_tlog

pytestmark = pytest.mark.timeout(240)

SURVEY = replace(draw(8), sample_hz=1.0, duration_s=400.0)


def record(survey: Survey, folder: Path, name: str) -> Path:
    write_tlog(fly(survey), folder / f"{name}.tlog")
    write_area(survey, folder / "area.geojson")
    return folder / f"{name}.tlog"


def located(cli, recording: Path) -> tuple[float, float, float]:
    """East, north (metres from the area's middle) and radius of the one beacon."""
    area = recording.with_name("area.geojson")
    done = cli("replay", recording, "--area", area, "--format", "json", "--quiet", timeout_s=150)
    assert done.returncode == 0, done.stderr
    (target,) = json.loads(done.stdout)["targets"]
    east, north, _ = LocalFrame(ORIGIN).to_enu(
        Geodetic(target["latitude_deg"], target["longitude_deg"], ORIGIN.altitude_amsl_m)
    )
    return east, north, target["radius_90_m"]


def test_a_transmitter_is_found_by_power_alone_whatever_the_decibels_zero(cli, tmp_path: Path) -> None:
    """Stops over 208 m: within 30 m and its own radius, with levels round −60 dB and round +60 dB."""
    places = []
    for name, offset_db in (("low", -60.0), ("high", 60.0)):
        recording = record(replace(SURVEY, unit_offset_db=offset_db), tmp_path, name)
        east, north, radius_m = located(cli, recording)
        error_m = math.hypot(east - SURVEY.target_enu_m[0], north - SURVEY.target_enu_m[1])
        assert error_m < 30.0
        assert error_m < 1.5 * radius_m
        assert radius_m < 60.0
        places.append((east, north))
    assert math.dist(*places) < 15.0
