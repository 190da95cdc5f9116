"""The lone surveyor's recording: frames and an area that say what was flown and heard."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from groundstation.mavlink.decode import decode
from groundstation.mavlink.framing import frame_of
from groundstation.mavlink.messages import GlobalPosition, RssSample
from groundstation.mavlink.tlog import read_tlog
from sim_sitl.surveyor import BEACON_ID, draw, fly, write_area, write_tlog


def test_the_recording_says_what_was_flown_and_heard(tmp_path: Path) -> None:
    survey = replace(draw(6), duration_s=40.0)
    flight = fly(survey)
    write_tlog(flight, tmp_path / "a.tlog")
    write_area(survey, tmp_path / "a.geojson")
    messages = [decode(frame_of(raw)) for _, raw in read_tlog(tmp_path / "a.tlog")]
    heard = [m for m in messages if isinstance(m, RssSample)]
    assert len(heard) == flight.power_db.size
    assert {m.beacon_id for m in heard} == {BEACON_ID}
    assert heard[3].rss_dbm == pytest.approx(float(flight.power_db[3]), abs=0.006)
    places = [m for m in messages if isinstance(m, GlobalPosition)]
    assert len(places) == flight.pose_s.size
    assert places[0].height_above_home_m == pytest.approx(survey.height_m, abs=1.0)
    area = json.loads((tmp_path / "a.geojson").read_text())
    assert len(area["geometry"]["coordinates"][0]) == 5
