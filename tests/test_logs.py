"""Logs: one line an event, codes for machines."""

from __future__ import annotations

import json
import logging

import pytest

from groundstation.domain.events import Event, Severity
from groundstation.logs import log_event, set_up

EVENT = Event(0, "vehicle.lost", Severity.WARNING, "vehicle 3 was lost", vehicle_id=3, beacon_id=2**63)


@pytest.fixture(autouse=True)
def _restore_root():
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:], root.level = handlers, level
    logging.getLogger("groundstation").setLevel(logging.NOTSET)


def test_json_lines_carry_code_level_and_ids(capsys: pytest.CaptureFixture[str]) -> None:
    set_up(json=True, quiet=False)
    log_event(EVENT)
    line = json.loads(capsys.readouterr().err)
    assert (line["code"], line["level"], line["vehicle_id"]) == ("vehicle.lost", "warning", 3)
    assert line["beacon_id"] == str(2**63)


def test_plain_lines_are_for_people_and_quiet_leaves_warnings(capsys: pytest.CaptureFixture[str]) -> None:
    set_up(json=False, quiet=True)
    log_event(Event(0, "beacon.found", Severity.INFO, "beacon 7 is heard"))
    log_event(EVENT)
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    assert "vehicle.lost" in text
    assert "vehicle 3 was lost" in text
