"""Sensors on a recording: the original stays, the truth is told, the bytes repeat."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from groundstation.domain.errors import InputError
from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.mavlink.decode import decode
from groundstation.mavlink.framing import frame_of
from groundstation.mavlink.messages import AoaSample, GlobalPosition, RssSample
from groundstation.mavlink.tlog import TlogWriter, read_tlog
from sim_sitl.overlay import overlay
from sim_sitl.radio_sensor import SensorSettings
from sim_sitl.scenario_file import load_scenario

REAL = Path(__file__).parents[1] / "data" / "arducopter-4x.tlog"
SENSOR = SensorSettings(cir_every=8)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """40 s in the air of the recorded real autopilots, with their boot's homes before."""
    path = tmp_path_factory.mktemp("recording") / "real.tlog"
    records = list(read_tlog(REAL))
    start = records[0][0]
    with TlogWriter(path) as writer:
        for unix_us, raw in records:
            if 17e6 < unix_us - start < 20e6 or 100e6 < unix_us - start < 140e6:
                writer.write(unix_us, raw)
    return path


@pytest.fixture(scope="module")
def overlaid(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("overlaid") / "out.tlog"
    overlay(recording, load_scenario("open-field"), 3, out, SENSOR)
    return out


def test_every_original_record_is_kept_in_order_and_times_do_not_run_back(
    recording: Path, overlaid: Path
) -> None:
    original = list(read_tlog(recording))
    result = list(read_tlog(overlaid))
    kept = [record for record in result if frame_of(record[1]).component_id != 191]
    assert kept == original
    assert len(result) > len(original) + 1000
    if all(a[0] <= b[0] for a, b in pairwise(original)):
        assert all(a[0] <= b[0] for a, b in pairwise(result))


def test_the_same_recording_scenario_and_seed_give_the_same_bytes(
    recording: Path, overlaid: Path, tmp_path: Path
) -> None:
    for seed, same in ((3, True), (4, False)):
        out = tmp_path / f"{seed}.tlog"
        overlay(recording, load_scenario("open-field"), seed, out, SENSOR)
        assert (out.read_bytes() == overlaid.read_bytes()) is same


def test_truth_lies_round_the_recordings_home(overlaid: Path) -> None:
    truth = json.loads(overlaid.with_suffix(".truth.json").read_text())
    home = LocalFrame(Geodetic(-35.3625, 149.1654, 584.09))
    east, north, up = home.to_enu(
        Geodetic(truth["beacons"][0]["lat"], truth["beacons"][0]["lon"], truth["beacons"][0]["alt_amsl_m"])
    )
    assert (east, north, up) == pytest.approx((32.0, -41.0, 2.0), abs=0.05)


def test_angles_point_from_the_recorded_vehicle_at_the_truth(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "earth.tlog"
    overlay(recording, load_scenario("open-field"), 3, out, SensorSettings(cir_every=0, angles="earth"))
    truth = {
        int(b["id"]): Geodetic(b["lat"], b["lon"], b["alt_amsl_m"])
        for b in json.loads(out.with_suffix(".truth.json").read_text())["beacons"]
    }
    position: dict[int, Geodetic] = {}
    errors: list[float] = []
    for _, raw in read_tlog(out):
        frame = frame_of(raw)
        message: Any = decode(frame)
        if isinstance(message, GlobalPosition) and message.position is not None:
            position[frame.system_id] = message.position
        elif isinstance(message, AoaSample) and frame.system_id in position:
            east, north, _ = LocalFrame(position[frame.system_id]).to_enu(truth[message.beacon_id])
            error = math.remainder(message.azimuth_rad - math.atan2(east, north), 2 * math.pi)
            errors.append(abs(math.degrees(error)))
    errors.sort()
    assert len(errors) > 500
    assert errors[len(errors) // 2] < 2.5


def test_vehicles_that_have_no_position_yet_hear_nothing(tmp_path: Path) -> None:
    early = tmp_path / "early.tlog"
    records = list(read_tlog(REAL))
    with TlogWriter(early) as writer:
        for unix_us, raw in records:
            if unix_us - records[0][0] < 30e6:
                writer.write(unix_us, raw)
    out = tmp_path / "out.tlog"
    overlay(early, load_scenario("open-field"), 1, out, SensorSettings(cir_every=0))
    first_heard = {}
    for unix_us, raw in read_tlog(out):
        frame = frame_of(raw)
        if isinstance(decode(frame), RssSample):
            first_heard.setdefault(frame.system_id, (unix_us - records[0][0]) * 1e-6)
    assert len(first_heard) == 4
    assert min(first_heard.values()) > 8.0


def test_bad_recordings_cost_one_line(tmp_path: Path, recording: Path) -> None:
    scenario = load_scenario("open-field")
    path = tmp_path / "silent.tlog"
    with TlogWriter(path) as writer:
        writer.write(*next(iter(read_tlog(recording))))
    with pytest.raises(InputError, match="no vehicle in it has a position"):
        overlay(path, scenario, 1, tmp_path / "o.tlog", SENSOR)
    with pytest.raises(InputError, match="cannot read"):
        overlay(tmp_path / "none.tlog", scenario, 1, tmp_path / "o.tlog", SENSOR)
    with pytest.raises(InputError, match="the recording itself"):
        overlay(recording, scenario, 1, recording, SENSOR)
