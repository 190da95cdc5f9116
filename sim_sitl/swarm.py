"""Paces a simulation by the wall clock and puts its frames on sockets: ``sim-sitl swarm``.

Keeps the rule that everything that decides anything is in simulation.py; here are only time,
sockets and lines for people.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from groundstation.mavlink.framing import Framer
from sim_sitl.endpoints import Endpoint, LinkUrl, open_endpoint
from sim_sitl.lossy_link import LinkQuality, LossyLink
from sim_sitl.scenario import Scenario
from sim_sitl.simulation import Simulation, SimulationSettings, write_truth

PACE_S = 0.02
"""Wall time between two steps."""
MAX_CATCH_UP_S = 1.0
"""Simulated time made up for in one step when the machine was busy; more is let go."""
REPORT_INTERVAL_S = 5.0


@dataclass(frozen=True, slots=True)
class SwarmOptions:
    """A run of the swarm."""

    scenario: Scenario
    link: LinkUrl
    vehicles: int = 4
    beacons: int | None = None
    seed: int = 1
    speedup: float = 1.0
    duration_s: float | None = None
    """Simulated seconds; None: until stopped."""
    truth: Path | None = None
    quality: LinkQuality = field(default_factory=LinkQuality)
    simulation: SimulationSettings = field(default_factory=SimulationSettings)


class Swarm:
    """A simulation with its sockets."""

    def __init__(self, options: SwarmOptions, report: Callable[[str], None] | None = None) -> None:
        self._options = options
        self._report = report
        settings = replace(options.simulation, start_unix_usec=time.time_ns() // 1000)
        self.simulation = Simulation(
            options.scenario, options.vehicles, options.beacons, options.seed, settings
        )
        ids = list(self.simulation.vehicles)
        self._down = {vehicle: LossyLink(options.quality, options.seed, vehicle, 0) for vehicle in ids}
        self._up = {vehicle: LossyLink(options.quality, options.seed, vehicle, 1) for vehicle in ids}
        self._framers = {vehicle: Framer() for vehicle in ids}
        self._endpoints: dict[int, Endpoint] = {}
        self._stopping = asyncio.Event()

    def stop(self) -> None:
        """End the run soon."""
        self._stopping.set()

    async def run(self) -> None:
        """Fly until the duration is over or somebody stops it; raises ResourceError."""
        options = self._options
        if options.truth is not None:
            write_truth(options.truth, self.simulation.truth())
        try:
            for vehicle in self.simulation.vehicles:
                self._endpoints[vehicle] = await open_endpoint(
                    options.link, partial(self._from_station, vehicle)
                )
            await self._pace()
        finally:
            for endpoint in self._endpoints.values():
                endpoint.close()

    async def _pace(self) -> None:
        options = self._options
        simulated_s = 0.0
        before = time.monotonic()
        report_at = before + REPORT_INTERVAL_S
        while not self._stopping.is_set() and (
            options.duration_s is None or simulated_s < options.duration_s
        ):
            now = time.monotonic()
            simulated_s += min(
                (now - before) * options.speedup, max(MAX_CATCH_UP_S, PACE_S * options.speedup)
            )
            before = now
            for vehicle, up in self._up.items():
                for frame in up.due(simulated_s):
                    self.simulation.receive(vehicle, frame)
            for vehicle, frames in self.simulation.step(simulated_s).items():
                down, endpoint = self._down[vehicle], self._endpoints[vehicle]
                for frame in frames:
                    down.offer(simulated_s, frame)
                for frame in down.due(simulated_s):
                    endpoint.send(frame)
            if self._report is not None and now >= report_at:
                report_at = now + REPORT_INTERVAL_S
                self._report(self.simulation.describe())
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stopping.wait(), max(0.001, PACE_S - (time.monotonic() - now)))

    def _from_station(self, vehicle: int, data: bytes) -> None:
        for frame in self._framers[vehicle].feed(data):
            self._up[vehicle].offer(self.simulation.time_s, frame.raw)


def run_swarm(
    options: SwarmOptions, report: Callable[[str], None] | None, *, end_with_stdin: bool = False
) -> None:
    """``sim-sitl swarm``: blocks until the end, or until SIGINT or SIGTERM.

    ``end_with_stdin``: also when standard input closes, as it does when the program that
    started this one is gone, however it went.
    """

    async def main() -> None:
        swarm = Swarm(options, report)
        stop_on_signals(swarm.stop)
        if end_with_stdin:
            stop_at_end_of_stdin(swarm.stop)
        await swarm.run()

    asyncio.run(main())


def stop_at_end_of_stdin(stop: Callable[[], None]) -> None:
    """Calls ``stop`` once standard input is at its end."""
    loop = asyncio.get_running_loop()
    stdin = sys.stdin.fileno()

    def read() -> None:
        if not os.read(stdin, 4096):
            loop.remove_reader(stdin)
            stop()

    loop.add_reader(stdin, read)


def stop_on_signals(stop: Callable[[], None]) -> None:
    """SIGINT and SIGTERM end a run as its duration would."""
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop)
