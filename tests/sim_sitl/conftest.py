"""Fixtures of the simulator's tests: scenarios, vehicles in the air, a talker to them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest

from groundstation.domain.geometry import Geodetic
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.framing import frame_of
from sim_sitl.modes import Flavour
from sim_sitl.radio_sensor import SensorSettings
from sim_sitl.scenario import Scenario
from sim_sitl.scenario_file import load_scenario
from sim_sitl.simulation import Simulation, SimulationSettings


class Talker:
    """A ground station in a test: sends dialect messages to vehicle 1 and decodes its answers."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self._encoder = Encoder(255, 190)
        self._decoder = dialect.MAVLink(None)
        self._time_s = simulation.time_s
        self.heard: list[Any] = []

    def run(self, seconds: float) -> list[Any]:
        """Let time pass; every message that vehicle 1 sent meanwhile."""
        self._time_s += seconds
        frames = self.simulation.step(self._time_s)[1]
        messages = [self._decoder.decode(bytearray(frame)) for frame in frames]
        self.heard += messages
        return messages

    def send(self, message: Any) -> None:
        """A message to vehicle 1."""
        self.simulation.receive(1, self._encoder.pack(message))

    def ask(self, message: Any) -> int:
        """Send a command and return the MAV_RESULT of its acknowledgement."""
        self.send(message)
        acks = [m for m in self.run(0.1) if m.get_type() == "COMMAND_ACK" and m.command == message.command]
        assert len(acks) == 1, acks
        assert (acks[0].target_system, acks[0].target_component) == (255, 190)
        return int(acks[0].result)

    def long(self, command: int, *params: float) -> int:
        """COMMAND_LONG."""
        values = [*params, *[0.0] * (7 - len(params))]
        return self.ask(dialect.MAVLink_command_long_message(1, 1, command, 0, *values))

    def reposition(self, place: Geodetic, frame: int = 0, flags: int = 0) -> int:
        """DO_REPOSITION as COMMAND_INT."""
        return self.ask(
            dialect.MAVLink_command_int_message(
                1, 1, frame, 192, 0, 0, -1, flags, 0, float("nan"),
                round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7), place.altitude_amsl_m,
            )
        )  # fmt: skip

    def last(self, kind: str) -> Any:
        """The newest message of a type from the autopilot."""
        return next(m for m in reversed(self.heard) if m.get_type() == kind and m.get_srcComponent() == 1)


@pytest.fixture
def field() -> Scenario:
    """The shipped open field."""
    return load_scenario("open-field")


@pytest.fixture
def talk(field: Scenario) -> Callable[..., Talker]:
    """Builds a talker to a fresh one-vehicle simulation."""

    def build(scenario: Scenario = field, *, sensor: SensorSettings | None = None, **settings: Any) -> Talker:
        chosen = SimulationSettings(sensor=sensor or SensorSettings(cir_every=0), **settings)
        return Talker(Simulation(scenario, 1, None, 5, chosen))

    return build


@pytest.fixture
def airborne(talk: Callable[..., Talker]) -> Talker:
    """An ArduPilot in the air, orbiting in GUIDED."""
    return talk()


@pytest.fixture
def px4(talk: Callable[..., Talker]) -> Talker:
    """A PX4 in the air, its pattern under way."""
    return talk(flavour=Flavour.PX4)


@pytest.fixture
def quiet(field: Scenario) -> Scenario:
    """The open field without obstacles, shadowing, fading to speak of, or noise."""
    return replace(
        field,
        obstacles=(),
        propagation=replace(
            field.propagation,
            los_shadowing_db=0.0,
            nlos_shadowing_db=0.0,
            los_rician_k_db=40.0,
            fading_averages=10_000,
        ),
        receiver=replace(field.receiver, level_noise_db=0.0, angle_noise_deg=0.0, angle_bias_deg=0.0),
    )


@pytest.fixture
def frames_by_id() -> Callable[[list[bytes]], dict[int, int]]:
    """Counts frames by message id."""

    def count(frames: list[bytes]) -> dict[int, int]:
        counts: dict[int, int] = {}
        for raw in frames:
            message_id = frame_of(raw).message_id
            counts[message_id] = counts.get(message_id, 0) + 1
        return counts

    return count


async def _eventually(condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
    async with asyncio.timeout(timeout_s):
        while not condition():  # noqa: ASYNC110 - sockets and other programs give no event to wait for
            await asyncio.sleep(0.02)


@pytest.fixture
def eventually() -> Callable[..., Awaitable[None]]:
    """Waits until a condition holds; fails with TimeoutError."""
    return _eventually
