"""The demo as a new user runs it, without a screen."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.timeout(150)


def test_the_headless_demo_finds_its_beacons_and_says_how_well(cli) -> None:
    done = cli("demo", "--headless", "--duration", 25, "--scenario", "open-field", "--vehicles", 4)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    lines = done.stdout.strip().splitlines()
    assert lines[0].split()[:2] == ["beacon", "error"]
    assert len(lines) == 4
    for line in lines[1:]:
        assert float(line.split()[1]) < 20, done.stdout


def test_a_demo_that_is_killed_leaves_no_swarm_behind(background, until) -> None:
    demo = background("groundstation.cli", "demo", "--http", "127.0.0.1:0")

    def children() -> list[int]:
        path = f"/proc/{demo.process.pid}/task/{demo.process.pid}/children"
        with open(path) as file:
            found = [int(word) for word in file.read().split()]
        return [pid for pid in found if b"sim_sitl.cli\0swarm" in _arguments(pid)]

    (swarm,) = until("the swarm flies", children)
    demo.stop(signal.SIGKILL)
    until("the swarm has ended", lambda: b"sim_sitl.cli" not in _arguments(swarm), timeout_s=20)


def _arguments(pid: int) -> bytes:
    try:
        with open(f"/proc/{pid}/cmdline", "rb") as file:
            return file.read()
    except FileNotFoundError:
        return b""


def test_ctrl_c_ends_the_demo_cleanly(background, until) -> None:
    demo = background("groundstation.cli", "demo", "--http", "127.0.0.1:0", "--scenario", "city-block")
    until("the page is told", lambda: "map page: http://127.0.0.1:" in demo.text())
    time.sleep(1)
    assert demo.stop(signal.SIGINT) == 0
    assert "Traceback" not in demo.text()


def test_the_demo_s_swarm_that_cannot_start_is_told(cli) -> None:
    done = cli("demo", "--headless", "--duration", 5, "--vehicles", 51)
    assert done.returncode == 2
    assert "--vehicles" in done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="uses /proc")
def test_version_is_quick_and_needs_no_engine() -> None:
    """Help and errors must not wait for solvers to load."""
    code = (
        "import sys, groundstation.cli; print([m for m in ('scipy', 'numpy', 'fastapi') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
