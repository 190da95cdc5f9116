"""Real processes on loopback: the simulated swarm, the station, the command lines."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

ROOT = Path(__file__).resolve().parents[2]
RECORDING = ROOT / "tests" / "data" / "arducopter-4x.tlog"


@pytest.fixture
def recording() -> Path:
    """275 s of four real ArduCopter autopilots."""
    return RECORDING


Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def cli(tmp_path: Path) -> Run:
    """Runs ``groundstation ARGS`` to its end; ``program="sim_sitl.cli"`` the simulator."""

    def run(
        *arguments: object, program: str = "groundstation.cli", timeout_s: float = 90, **environment: str
    ) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", program, *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=timeout_s,
            cwd=tmp_path,
            env={**os.environ, **environment},
            check=False,
        )

    return run


class Background:
    """A program in the background, and what it prints on stderr."""

    def __init__(self, arguments: list[str], cwd: Path, log: Path) -> None:
        self.log = log
        with log.open("w") as out:
            self.process = subprocess.Popen(
                [sys.executable, "-m", *arguments], cwd=cwd, stdout=out, stderr=subprocess.STDOUT
            )

    def text(self) -> str:
        return self.log.read_text()

    def stop(self, number: int = signal.SIGTERM, timeout_s: float = 40) -> int:
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.process.wait(timeout_s)


@pytest.fixture
def background(tmp_path: Path) -> Iterator[Callable[..., Background]]:
    """Starts ``python -m PROGRAM ARGS`` and ends it with the test."""
    started: list[Background] = []

    def start(program: str, *arguments: object) -> Background:
        log = tmp_path / f"{program}-{len(started)}.log"
        started.append(Background([program, *map(str, arguments)], tmp_path, log))
        return started[-1]

    yield start
    for one in started:
        if one.process.poll() is None:
            one.process.kill()
            one.process.wait(10)


@pytest.fixture
def until() -> Callable[..., object]:
    """Waits until a function gives something true, else fails with what was awaited."""

    def wait(what: str, question: Callable[[], object], timeout_s: float = 60) -> object:
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            try:
                answer = question()
            except (httpx.TransportError, OSError):
                answer = None
            if answer:
                return answer
            time.sleep(0.2)
        raise AssertionError(f"not within {timeout_s} s: {what}")

    return wait
