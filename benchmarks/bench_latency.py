"""From a beacon's last sample to the page: 20 vehicles, 5 beacons, all over real sockets.

The station, the simulated swarm and a websocket client run as they would in the field, on
this machine. Measured is, for each change of a target on the stream, the age of the newest
sample in it when it arrived (station time against the same machine's clock). The named
alternative in the same run is the raw sample itself: the age of each link's newest sample
when its row arrived, which passes ingest and the stream but no window, classifier or solver.
"""

from __future__ import annotations

import asyncio
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from reporting import environment, give
from websockets.asyncio.client import connect

VEHICLES, BEACONS, WARM_UP_S, MEASURE_S = 20, 5, 15.0, 45.0


def free_port(kind: socket.SocketKind) -> int:
    """A port nobody has."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


async def listen(url: str, until_s: float, ages: dict[str, list[float]]) -> int:
    """Collect ages, ms, of targets and links; returns the bytes received."""
    seen: dict[tuple[str, str], str] = {}
    received = 0
    begin = time.monotonic() + WARM_UP_S
    async with connect(url, max_size=None) as stream:
        while time.monotonic() < until_s:
            text = await asyncio.wait_for(stream.recv(), 10)
            now_ns = time.time_ns()
            received += len(text)
            message: dict[str, Any] = json.loads(text)
            for kind, name in (("targets", "beacon_id"), ("links", "vehicle_id")):
                for row in message.get("rows", {}).get(kind) or []:
                    key = (kind, f"{row[name]}:{row['beacon_id']}")
                    heard = row["last_heard_ns"]
                    if seen.get(key) != heard and time.monotonic() > begin:
                        ages[kind].append((now_ns - int(heard)) / 1e6)
                    seen[key] = heard
    return received


def cpu_s(pid: int) -> float:
    """CPU seconds of a process and its living children."""
    total = 0.0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(stat.parent.name) == pid or int(fields[1]) == pid:
            total += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return total


def main() -> None:
    """Run it all and print one JSON object."""
    udp, http = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
    with tempfile.TemporaryDirectory() as folder:
        run = [sys.executable, "-m"]
        area = ["--area", f"{folder}/area.json", "--fence", f"{folder}/fence.json"]
        subprocess.run(
            [*run, "sim_sitl.cli", "scenario", "open-field", *area], check=True, capture_output=True
        )
        station = subprocess.Popen(
            [*run, "groundstation.cli", "serve", "--link", f"udpin:127.0.0.1:{udp}", "--quiet",
             "--http", f"127.0.0.1:{http}", *area, "--data-dir", f"{folder}/sessions"],
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        swarm = subprocess.Popen(
            [*run, "sim_sitl.cli", "swarm", "--link", f"udpout:127.0.0.1:{udp}", "--vehicles", str(VEHICLES),
             "--beacons", str(BEACONS), "--scenario", "open-field", "--seed", "1", "--quiet"],
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        ages: dict[str, list[float]] = {"targets": [], "links": []}
        try:
            url = f"ws://127.0.0.1:{http}/api/v1/stream"
            for _ in range(100):
                with socket.socket() as probe:
                    if probe.connect_ex(("127.0.0.1", http)) == 0:
                        break
                time.sleep(0.3)
            began = time.monotonic()
            received = asyncio.run(listen(url, began + WARM_UP_S + MEASURE_S, ages))
            used_s = cpu_s(station.pid)
        finally:
            swarm.terminate()
            station.terminate()
            swarm.wait(20)
            station.wait(60)
    figures: dict[str, Any] = {
        "vehicles": VEHICLES,
        "beacons": BEACONS,
        "measured_s": MEASURE_S,
        "station_cpu_cores": round(used_s / (WARM_UP_S + MEASURE_S), 2),
        "stream_kB_s": round(received / (WARM_UP_S + MEASURE_S) / 1e3, 1),
    }
    for kind, values in ages.items():
        figures[f"{kind}_changes"] = len(values)
        for share in (50, 99):
            figures[f"{kind}_p{share}_ms"] = round(float(np.percentile(values, share)), 1)
    ratio = figures["targets_p99_ms"] / figures["links_p99_ms"]
    give(
        {
            "name": "last sample to websocket",
            "figures": figures,
            "ratios": {"target p99 / raw sample p99": round(ratio, 2)},
            "environment": environment(),
        }
    )


if __name__ == "__main__":
    main()
