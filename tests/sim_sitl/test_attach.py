"""The sensor on autopilots that are not ours: here our own vehicles play them, over UDP."""

from __future__ import annotations

import asyncio
import json
import socket
from pathlib import Path
from typing import Any

import pytest

from groundstation.domain.geometry import Geodetic
from groundstation.mavlink.decode import decode
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.framing import Frame, Framer, frame_of
from groundstation.mavlink.messages import CommandAck, RssSample
from sim_sitl.attach import AttachedSensors, AttachedSwarm, AttachOptions
from sim_sitl.endpoints import LinkUrl, UdpIn
from sim_sitl.radio_sensor import SensorSettings
from sim_sitl.scenario import Scenario
from sim_sitl.scenario_file import load_scenario
from sim_sitl.simulation import Simulation
from sim_sitl.swarm import Swarm, SwarmOptions

SENSOR = SensorSettings(cir_every=4)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.fixture
def silent() -> Scenario:
    """A place elsewhere, whose vehicles hear no beacon of their own: component 1 is what counts."""
    return load_scenario("open-field").at(Geodetic(47.0, 8.0, 400.0))


def autopilot_frames(simulation: Simulation, time_s: float) -> list[Frame]:
    frames = [frame_of(raw) for sent in simulation.step(time_s).values() for raw in sent]
    return [frame for frame in frames if frame.component_id == 1]


def test_asks_for_streams_anchors_on_the_vehicle_and_hears_beacons(silent: Scenario, field: Scenario) -> None:
    autopilots = Simulation(silent, 2, None, 1)
    sensors = AttachedSensors(field, None, 7, SENSOR)
    to_station: list[Frame] = []
    for step in range(1, 500):
        time_s = step * 0.02
        for frame in autopilot_frames(autopilots, time_s):
            to_station += map(frame_of, sensors.from_autopilot(frame, time_s).to_station)
        for vehicle_id, out in sensors.step(time_s).items():
            to_station += map(frame_of, out.to_station)
            for raw in out.to_autopilot:
                autopilots.receive(vehicle_id, raw)
    assert sensors.anchored
    assert sensors.scenario.origin.latitude_deg == pytest.approx(47.0, abs=1e-4)
    assert sensors.scenario.origin.altitude_amsl_m == pytest.approx(400.0, abs=1.5)
    heard = [(f.system_id, decode(f)) for f in to_station if f.component_id == 191]
    levels = [(system_id, m) for system_id, m in heard if isinstance(m, RssSample)]
    assert {system_id for system_id, _ in levels} == {1, 2}
    assert {m.beacon_id for _, m in levels} == {b.beacon_id for b in field.beacons}
    assert len(levels) > 60
    acks = [decode(f) for f in to_station if f.message_id == 77]
    assert not [a for a in acks if isinstance(a, CommandAck) and a.target_component == 191], (
        "ours, not the station's"
    )
    assert {33, 30} <= {f.message_id for f in to_station if f.component_id == 1}


def test_without_a_position_nothing_is_heard(silent: Scenario, field: Scenario) -> None:
    from sim_sitl.simulation import SimulationSettings

    autopilots = Simulation(silent, 1, None, 1, SimulationSettings(airborne=False))
    sensors = AttachedSensors(field, None, 7, SENSOR)
    for step in range(1, 300):
        time_s = step * 0.02
        for frame in autopilot_frames(autopilots, time_s):
            sensors.from_autopilot(frame, time_s)
        out = sensors.step(time_s)
        assert all(not o.to_station for o in out.values())
    assert not sensors.anchored
    assert sensors.describe() == "attached: 1 no position yet"


async def test_over_udp_the_station_sees_sensors_and_its_commands_reach_the_autopilot(
    silent: Scenario, field: Scenario, tmp_path: Path, eventually: Any
) -> None:
    attach_port, station_port = free_port(), free_port()
    frames: list[Frame] = []
    addresses: dict[int, Any] = {}
    framers: dict[Any, Framer] = {}

    def heard(data: bytes, address: Any) -> None:
        for frame in framers.setdefault(address, Framer()).feed(data):
            frames.append(frame)
            addresses[frame.system_id] = address

    station = UdpIn(heard)
    await station.open(LinkUrl("udpin", "127.0.0.1", station_port))
    truth = tmp_path / "truth.json"
    attached = AttachedSwarm(
        AttachOptions(
            field,
            LinkUrl("udpin", "127.0.0.1", attach_port),
            LinkUrl("udpout", "127.0.0.1", station_port),
            truth=truth,
            sensor=SENSOR,
        )
    )
    autopilots = Swarm(SwarmOptions(silent, LinkUrl("udpout", "127.0.0.1", attach_port), vehicles=2))
    tasks = [asyncio.create_task(attached.run()), asyncio.create_task(autopilots.run())]
    try:
        await eventually(lambda: {f.system_id for f in frames if f.message_id == 20800} == {1, 2})
        assert addresses[1] != addresses[2]
        loiter = dialect.MAVLink_command_long_message(2, 1, 176, 0, 1, 5, 0, 0, 0, 0, 0)
        station.send(Encoder(255, 190).pack(loiter), addresses[2])
        await eventually(lambda: autopilots.simulation.vehicles[2].mode == "LOITER")
        assert autopilots.simulation.vehicles[1].mode == "GUIDED"
        assert json.loads(truth.read_text())["beacons"][0]["lat"] == pytest.approx(47.0, abs=0.01)
    finally:
        attached.stop()
        autopilots.stop()
        await asyncio.gather(*tasks)
        station.close()
