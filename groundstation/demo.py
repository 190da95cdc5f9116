"""``groundstation demo``: a simulated swarm, the service and the page; nothing else is needed.

The swarm is another program (``sim-sitl``), reached by UDP on loopback as any vehicle would
be; the station is not told that it is simulated. Only the comparison with the truth, which
the simulator writes into a file, is the demo's own.
"""

from __future__ import annotations

import asyncio
import json
import math
import socket
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from groundstation.config import LoadedConfig
from groundstation.domain.errors import InputError, InternalError, ResourceError
from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.inputs import Decision, OperatorInput
from groundstation.domain.target import TargetState
from groundstation.service import mission_of, stopping_on_signals
from groundstation.station import Station, StationOptions

CONFIRM_EVERY_S = 2.0


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """What the demo was asked for."""

    scenario: str
    vehicles: int
    beacons: int | None
    seed: int
    speedup: float
    headless: bool
    duration_s: float | None
    auto_confirm: bool
    keep_data: bool


async def run_demo(loaded: LoadedConfig, options: DemoOptions) -> None:
    """Run until stopped or ``duration_s`` is over; headless prints estimates beside the truth."""
    with tempfile.TemporaryDirectory(prefix="groundstation-demo-") as folder:
        work = Path(folder)
        await _sim_sitl(
            "scenario", options.scenario, "--area", work / "area.json", "--fence", work / "fence.json"
        )
        config = replace(
            loaded.config,
            area=work / "area.json",
            fence=work / "fence.json",
            data_dir=loaded.config.data_dir if options.keep_data else work / "sessions",
        )
        port = _free_udp_port()
        config = replace(config, links=(f"udpin:127.0.0.1:{port}",))
        if options.headless:
            config = replace(config, server=replace(config.server, port=0))
        station = Station(
            replace(loaded, config=config),
            StationOptions(mission=mission_of(config), source="demo", title=f"demo: {options.scenario}"),
        )
        arguments = ["swarm", "--link", f"udpout:127.0.0.1:{port}", "--vehicles", options.vehicles]
        arguments += ["--scenario", options.scenario, "--seed", options.seed, "--speedup", options.speedup]
        arguments += ["--truth", work / "truth.json", "--quiet", "--end-with-stdin"]
        if options.beacons is not None:
            arguments += ["--beacons", options.beacons]
        with stopping_on_signals(station.stop):
            running = asyncio.create_task(station.run())
            swarm: asyncio.subprocess.Process | None = None
            try:
                await _first(station.ready.wait(), running)
                swarm = await _start_sim_sitl(*arguments)
                if not options.headless:
                    print(f"map page: {station.url}   (Ctrl-C ends the demo)", flush=True)
                await _until_over(station, options, running, swarm)
            finally:
                station.stop.set()
                if swarm is not None and swarm.returncode is None:
                    swarm.terminate()
                    await swarm.wait()
                await running
        if options.headless:
            print(comparison(station, work / "truth.json"))


async def _until_over(
    station: Station, options: DemoOptions, running: asyncio.Task[None], swarm: asyncio.subprocess.Process
) -> None:
    tasks: list[asyncio.Task[Any]] = [
        asyncio.create_task(station.stop.wait()),
        asyncio.create_task(swarm.wait()),
    ]
    if options.auto_confirm:
        tasks.append(asyncio.create_task(_confirm_all(station)))
    try:
        await asyncio.wait([*tasks, running], timeout=options.duration_s, return_when=asyncio.FIRST_COMPLETED)
        if tasks[1].done() and swarm.returncode:
            error = await swarm.stderr.read() if swarm.stderr else b""
            raise InternalError(f"the simulated swarm ended: {error.decode(errors='replace').strip()[-300:]}")
    finally:
        for task in tasks:
            task.cancel()


async def _confirm_all(station: Station) -> None:
    """What an eager operator would do. Only ever here: simulated vehicles hurt nobody."""
    while True:
        await asyncio.sleep(CONFIRM_EVERY_S)
        for proposal in station.desk.plan_request(station.session.clock.time_ns(), ()).outstanding:
            station.take(
                OperatorInput(
                    "demo (automatic)",
                    Decision.CONFIRM,
                    proposal_id=proposal.proposal_id,
                    vehicle_id=proposal.vehicle_id,
                )
            )


async def _first(waited: Any, running: asyncio.Task[None]) -> None:
    """Wait for something of the station's, or for the station's own error."""
    waiting = asyncio.create_task(waited)
    await asyncio.wait([waiting, running], return_when=asyncio.FIRST_COMPLETED)
    waiting.cancel()
    if running.done():
        running.result()


async def _start_sim_sitl(*arguments: object) -> asyncio.subprocess.Process:
    try:
        return await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "sim_sitl.cli",
            *map(str, arguments),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
        )
    except OSError as error:
        raise ResourceError(f"the simulated swarm cannot be started: {error}") from error


async def _sim_sitl(*arguments: object) -> None:
    process = await _start_sim_sitl(*arguments)
    _, error = await process.communicate()
    if process.returncode:
        text = error.decode(errors="replace").strip()
        raise InputError(text.removeprefix("sim-sitl: ") or "the scenario cannot be read")


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def comparison(station: Station, truth_file: Path) -> str:
    """Final estimates beside the simulator's truth, a line a beacon."""
    truth = json.loads(truth_file.read_text())
    lines = [
        f"{'beacon':>20}  {'error':>8}  {'90 % radius':>11}  {'inside':>6}  "
        f"{'environment':11}  {'windows':>7}"
    ]
    for beacon in truth["beacons"]:
        name = str(beacon["id"])
        state = station.display.targets.get(int(name))
        if state is None:
            waiting = station.display.waiting.get(int(name))
            lines.append(f"{name:>20}  {'-':>8}  {waiting.needed if waiting else 'never heard'}")
            continue
        error_m = horizontal_error_m(state, beacon)
        inside = "yes" if error_m <= state.radius_90_m else "no"
        lines.append(
            f"{name:>20}  {error_m:6.1f} m  {state.radius_90_m:9.1f} m  {inside:>6}  "
            f"{state.environment.name:11}  {state.windows:>7}"
        )
    return "\n".join(lines)


def horizontal_error_m(state: TargetState, beacon: dict[str, Any]) -> float:
    """Horizontal distance of an estimate from the truth."""
    place = Geodetic(beacon["lat"], beacon["lon"], beacon["alt_amsl_m"])
    east, north, _ = LocalFrame(place).to_enu(state.position)
    return math.hypot(east, north)
