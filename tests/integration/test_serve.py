"""The whole station against the whole simulator, over real sockets, as an operator has it."""

from __future__ import annotations

import contextlib
import json
import math
import random
import re
import signal
import socket
import sqlite3
from pathlib import Path

import httpx
import pytest
from websockets.sync.client import connect

pytestmark = pytest.mark.timeout(240)


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Rig:
    """Scenario files, a station and a swarm on free ports."""

    def __init__(self, tmp_path: Path, cli, background, until) -> None:
        self.tmp, self.cli, self.background, self.until = tmp_path, cli, background, until
        self.udp, self.http = free_port(), free_port(socket.SOCK_STREAM)
        self.api = f"http://127.0.0.1:{self.http}/api/v1"
        done = cli(
            "scenario", "open-field", "--area", "area.json", "--fence", "fence.json", program="sim_sitl.cli"
        )
        assert done.returncode == 0, done.stderr
        self.station = None

    def serve(self, *more: object):
        self.station = self.background(
            "groundstation.cli", "serve", "--link", f"udpin:127.0.0.1:{self.udp}",
            "--http", f"127.0.0.1:{self.http}", "--area", "area.json", "--fence", "fence.json",
            "--data-dir", "sessions", "--set", "store.snapshot_interval_s=3", *more,
        )  # fmt: skip
        self.until("the service answers", lambda: self.get("health"))
        return self.station

    def swarm(self, *more: object):
        return self.background(
            "sim_sitl.cli", "swarm", "--link", f"udpout:127.0.0.1:{self.udp}", "--vehicles", 4,
            "--scenario", "open-field", "--seed", 5, "--truth", "truth.json", *more,
        )  # fmt: skip

    def get(self, path: str):
        answer = httpx.get(f"{self.api}/{path}", timeout=10)
        return answer.json() if answer.status_code == 200 else None

    def post(self, path: str, body: dict | None = None) -> httpx.Response:
        return httpx.post(f"{self.api}/{path}", json=body or {}, timeout=10)

    def located(self) -> dict[str, dict]:
        rows = self.get("targets")["targets"]
        return {row["beacon_id"]: row for row in rows if row.get("radius_90_m") is not None}

    def truth(self) -> dict[str, dict]:
        return {b["id"]: b for b in json.loads((self.tmp / "truth.json").read_text())["beacons"]}


@pytest.fixture
def rig(tmp_path: Path, cli, background, until) -> Rig:
    return Rig(tmp_path, cli, background, until)


def horizontal_m(place: dict, truth: dict) -> float:
    north = (place["latitude_deg"] - truth["lat"]) * 111_320
    east = (place["longitude_deg"] - truth["lon"]) * 111_320 * math.cos(math.radians(truth["lat"]))
    return math.hypot(east, north)


@pytest.mark.parametrize(
    "use_mavsdk", [False, pytest.param(True, marks=pytest.mark.peer)], ids=["own protocol", "MAVSDK"]
)
def test_beacons_are_found_a_confirmed_waypoint_is_flown_and_hold_stops_it(
    rig: Rig, use_mavsdk: bool
) -> None:
    rig.serve("--set", f"command.command.use_mavsdk={str(use_mavsdk).lower()}")
    rig.swarm()
    found = rig.until("three beacons are located", lambda: len(rig.located()) == 3 and rig.located())
    rig.until(
        "radii are small",
        lambda: all(row["radius_90_m"] < 15 for row in rig.located().values()),
        timeout_s=60,
    )
    for beacon_id, truth in rig.truth().items():
        row = rig.located()[beacon_id]
        assert horizontal_m(row["position"], truth) < 15, row
    assert set(found) == set(rig.truth())

    # A beacon is located before the last vehicle's first window of it is complete.
    def judged() -> list[dict]:
        return [link for link in rig.get("links")["links"] if link["los_source"] is not None]

    links = rig.until("every link is judged", lambda: len(judged()) >= 12 and judged())
    assert len(links) == 12
    assert {link["los_source"] for link in links} == {"classifier"}

    proposal = rig.until("a proposal", lambda: (rig.get("proposals") or {}).get("proposals"))[0]
    vehicle = proposal["vehicle_id"]
    wrong = rig.post(f"proposals/{proposal['proposal_id']}/confirm", {"vehicle_id": vehicle + 1})
    assert wrong.status_code == 409
    right = rig.post(f"proposals/{proposal['proposal_id']}/confirm", {"vehicle_id": vehicle})
    assert right.status_code == 202, right.text

    def phase() -> str | None:
        rows = [c for c in rig.get("commands")["commands"] if c["vehicle_id"] == vehicle]
        return rows[-1]["phase"] if rows else None

    rig.until("the vehicle flies there", lambda: phase() in ("flying", "arrived"), timeout_s=30)

    held = rig.post("hold-all")
    assert held.status_code == 202, held.text
    rig.until(
        "every vehicle holds",
        lambda: all(v["mode"] in ("BRAKE", "LOITER") for v in rig.get("vehicles")["vehicles"]),
        timeout_s=30,
    )
    metrics = httpx.get(f"http://127.0.0.1:{rig.http}/metrics", timeout=10).text
    left = {
        source: f'guard_frames_total{{reason="grant",source="{source}",verdict="admitted"}}' in metrics
        for source in ("station", "mavsdk")
    }
    assert left["mavsdk"] == use_mavsdk, metrics
    assert rig.station.stop() == 0
    assert "Traceback" not in rig.station.text()


def test_a_session_replays_to_what_the_live_run_gave(rig: Rig, cli) -> None:
    station = rig.serve()
    swarm = rig.swarm("--duration", 12)
    swarm.process.wait(60)
    rig.until("three beacons are located", lambda: len(rig.located()) == 3)
    assert station.stop() == 0
    (session,) = (rig.tmp / "sessions").iterdir()
    live = json.loads((session / "targets.geojson").read_text())
    again = cli("replay", session, "--format", "geojson", "--out", "again.geojson")
    assert again.returncode == 0, again.stderr
    assert json.loads((rig.tmp / "again.geojson").read_text()) == live
    assert len([f for f in live["features"] if f["geometry"]["type"] == "Point"]) == 3
    # The derived recording holds the same frames, for other tools.
    tlog = cli(
        "replay", session / "frames.tlog", "--area", "area.json", "--format", "json", "--out", "t.json"
    )
    assert tlog.returncode == 0, tlog.stderr


@pytest.mark.parametrize("snapshot_s", [2, 600], ids=["from a snapshot", "from the journal alone"])
def test_a_killed_station_goes_on_where_it_was_and_resumes_no_grant(rig: Rig, cli, snapshot_s: int) -> None:
    station = rig.serve("--set", f"store.snapshot_interval_s={snapshot_s}")
    rig.swarm()
    rig.until("three beacons are located", lambda: len(rig.located()) == 3)
    before = rig.until(
        "some evidence is in",
        lambda: min((row["windows"] for row in rig.located().values()), default=0) > 20 and rig.located(),
    )
    station.stop(signal.SIGKILL)
    again = rig.serve()
    after = rig.until("the beliefs are back", lambda: len(rig.located()) == 3 and rig.located())
    assert "going on with" in again.text()
    for beacon_id, row in before.items():
        assert after[beacon_id]["windows"] >= row["windows"] - 8
    assert rig.get("commands")["commands"] == [] or all(
        c["phase"] not in ("sent", "accepted", "flying") for c in rig.get("commands")["commands"]
    )
    rig.until("it hears the swarm again", lambda: rig.located()[next(iter(before))]["windows"] > 30)
    assert again.stop() == 0
    (session,) = (rig.tmp / "sessions").iterdir()
    live = json.loads((session / "targets.geojson").read_text())
    replayed = cli("replay", session, "--format", "geojson", "--out", "again.geojson")
    assert replayed.returncode == 0, replayed.stderr
    assert json.loads((rig.tmp / "again.geojson").read_text()) == live
    # What was handled again after the restart is not in the log or the history twice.
    with contextlib.closing(sqlite3.connect(session / "session.sqlite")) as database:
        for columns, table in (("time_ns, code, text", "events"), ("beacon_id, sequence", "targets")):
            twice = f"SELECT {columns} FROM {table} GROUP BY {columns} HAVING count(*) > 1"
            assert database.execute(twice).fetchall() == []
            assert database.execute(f"SELECT count(*) FROM {table}").fetchone()[0] > 3


def test_an_area_far_from_the_vehicles_is_told_once_one_is_there(rig: Rig) -> None:
    ring = [[0.0, 10.0], [0.01, 10.0], [0.01, 10.01], [0.0, 10.01], [0.0, 10.0]]
    (rig.tmp / "area.json").write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    rig.serve()
    rig.swarm()
    rig.until("the area is said to be far away", lambda: "km away from the vehicles" in rig.station.text())


def test_a_bad_radio_garbage_and_twenty_pages_do_not_stop_it(rig: Rig) -> None:
    rig.serve("--quiet")
    rig.swarm("--loss", 0.1, "--corrupt", 0.05, "--duplicate", 0.05, "--jitter-ms", 60)
    noise = random.Random(1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as liar, contextlib.ExitStack() as pages:
        opened = [
            pages.enter_context(
                connect(f"ws://127.0.0.1:{rig.http}/api/v1/stream", max_size=None, close_timeout=0.2)
            )
            for _ in range(20)
        ]
        for _ in range(2000):
            liar.sendto(noise.randbytes(noise.randrange(1, 300)), ("127.0.0.1", rig.udp))
        rig.until("three beacons are located", lambda: len(rig.located()) == 3)
        rig.until(
            "radii are small",
            lambda: all(row["radius_90_m"] < 15 for row in rig.located().values()),
            timeout_s=60,
        )
        for page in opened:
            assert json.loads(page.recv(timeout=10))["type"] == "snapshot"
    metrics = httpx.get(f"http://127.0.0.1:{rig.http}/metrics", timeout=10).text
    assert re.search(r"^groundstation_mavlink_crc_failures_total\{.*\} [1-9]", metrics, re.MULTILINE)
    assert rig.station.stop() == 0
    assert "Traceback" not in rig.station.text()
    assert "internal error" not in rig.station.text()
