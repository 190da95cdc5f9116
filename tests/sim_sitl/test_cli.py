"""The command line: what it writes, and one clear line for what is wrong."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from sim_sitl.cli import main


@dataclass(frozen=True)
class Done:
    """How a command ended."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def sim_sitl(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., Done]:
    """Runs the console script's function in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> Done:
        monkeypatch.setattr(sys, "argv", ["sim-sitl", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        out, error = capfd.readouterr()
        return Done(int(ended.value.code or 0), out, error)

    return run


def test_scenario_writes_area_and_fence(tmp_path: Path, sim_sitl: Callable[..., Done]) -> None:
    done = sim_sitl("scenario", "rubble", "--area", "a.geojson", "--fence", "f.geojson")
    assert done.returncode == 0, done.stderr
    for name in ("a.geojson", "f.geojson"):
        assert json.loads((tmp_path / name).read_text())["geometry"]["type"] == "Polygon"
    assert "3 beacons" in done.stdout


def test_a_short_swarm_ends_writes_truth_and_can_be_quiet(
    tmp_path: Path, sim_sitl: Callable[..., Done]
) -> None:
    arguments = (
        "swarm",
        "--link",
        "udpout:127.0.0.1:9",
        "--vehicles",
        "2",
        "--beacons",
        "4",
        "--duration",
        "5",
    )
    done = sim_sitl(*arguments, "--speedup", "10", "--truth", "t.json", "--quiet")
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    truth = json.loads((tmp_path / "t.json").read_text())
    assert len(truth["beacons"]) == 4
    assert set(truth["beacons"][3]) == {"id", "lat", "lon", "alt_amsl_m", "transmit_power_dbm"}


@pytest.mark.parametrize(
    ("arguments", "code", "parts"),
    [
        (("swarm", "--link", "udp14550"), 2, ("udp14550", "needed: udpout:HOST:PORT")),
        (("swarm", "--scenario", "moon"), 1, ("moon", "open-field")),
        (("swarm", "--attach", "tcp:localhost:5760"), 2, ("tcp:localhost:5760", "udpin:HOST:PORT")),
        (("swarm", "--angles", "sideways", "--duration", "0"), 2, ("sideways", "body, earth or off")),
        (("swarm", "--truth", "no/such/folder.json", "--duration", "0"), 1, ("no/such/folder.json",)),
        (("overlay", "none.tlog", "--out", "o.tlog"), 1, ("none.tlog",)),
        (("dataset", "--rows", "0", "--out", "d.npz"), 1, ("--rows is 0",)),
        (("dataset", "--rows", "8", "--out", "d.xlsx"), 2, ("d.xlsx", ".npz", ".csv")),
        (("dataset", "--rows", "8", "--out", "none/d.npz"), 1, ("none", "does not exist")),
        (("dataset", "--rows", "8", "--out", "d.npz", "--randomise", "--bandwidth-mhz", "3"), 2, ("leave",)),
        (("scenario", "bad.toml"), 1, ("bad.toml", "version", "missing")),
    ],
)
def test_mistakes_cost_one_line_and_no_traceback(
    tmp_path: Path,
    sim_sitl: Callable[..., Done],
    arguments: tuple[str, ...],
    code: int,
    parts: tuple[str, ...],
) -> None:
    (tmp_path / "bad.toml").write_text("name = 'x'\n")
    done = sim_sitl(*arguments)
    assert done.returncode == code
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    for part in parts:
        assert part in done.stderr


def test_dataset_runs(tmp_path: Path, sim_sitl: Callable[..., Done]) -> None:
    done = sim_sitl("dataset", "--rows", "8", "--out", "d.npz", "--seed", "2")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "d.npz").exists()
    paper = ("--bandwidth-mhz", "3", "--tap-spacing-ns", "333", "--taps", "32", "--packets", "1")
    done = sim_sitl("dataset", "--rows", "8", "--out", "d.csv", *paper)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "d.csv: 8 rows, seed 1\n"
    assert len((tmp_path / "d.csv").read_text().splitlines()) == 9
