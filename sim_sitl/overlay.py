"""The simulated radio sensor on the vehicles of a recording: ``sim-sitl overlay``.

Keeps the rules that every record of the original stays, byte for byte and in its order, and
that the same recording, scenario and seed give the same file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from groundstation.domain.errors import InputError
from groundstation.domain.geometry import Geodetic
from groundstation.domain.vehicle import AUTOPILOT_COMPONENT
from groundstation.mavlink.decode import decode
from groundstation.mavlink.framing import frame_of
from groundstation.mavlink.messages import Attitude, GlobalPosition, HomePosition
from groundstation.mavlink.tlog import TlogWriter, read_tlog
from sim_sitl.beacon import BeaconTransmitter, choose_beacons
from sim_sitl.poses import PoseTrack
from sim_sitl.radio_sensor import RadioSensor, SensorSettings
from sim_sitl.scenario import BeaconSpec, Scenario
from sim_sitl.simulation import truth_of, write_truth
from sim_sitl.world import World

_POSES = (30, 31, 33, 242)
"""Message ids of poses and homes."""


@dataclass(frozen=True, slots=True)
class OverlayResult:
    """What was done."""

    vehicles: tuple[int, ...]
    records: int
    """Of the original."""
    added: int
    """Sensor frames."""
    truth: Path


@dataclass(slots=True)
class _Recorded:
    """One recorded vehicle: poses by its own clock, and how that maps to the recording's."""

    track: PoseTrack
    offset_s: float = float("inf")
    """Recording time minus boot time at the shortest delay seen."""


def overlay(
    source: Path,
    scenario: Scenario,
    seed: int,
    out: Path,
    settings: SensorSettings,
    beacons: int | None = None,
) -> OverlayResult:
    """Write ``source`` with sensor frames to ``out`` and the truth to ``out`` with suffix .truth.json.

    Raises:
        InputError: no such recording, or no vehicle in it has a position.
    """
    if out.resolve() == source.resolve():
        raise InputError(f"{out} is the recording itself; needed: another file for the result")
    records = list(read_tlog(source))
    if not records:
        raise InputError(f"{source}: holds no records; needed: a .tlog")
    start_us = records[0][0]
    vehicles, ground = _read_vehicles(records, start_us)
    if ground is None:
        raise InputError(
            f"{source}: no vehicle in it has a position; needed: GLOBAL_POSITION_INT of component 1"
        )
    world_scenario = scenario.at(ground) if scenario.relative else scenario
    chosen = choose_beacons(world_scenario, beacons, seed)
    end_s = max(unix_us for unix_us, _ in records) * 1e-6 - start_us * 1e-6
    added = _sensor_frames(world_scenario, chosen, vehicles, seed, settings, end_s)
    with TlogWriter(out) as writer:
        index = 0
        for unix_us, frame in records:
            while index < len(added) and start_us + round(added[index][0] * 1e6) < unix_us:
                writer.write(start_us + round(added[index][0] * 1e6), added[index][1])
                index += 1
            writer.write(unix_us, frame)
        for due_s, frame in added[index:]:
            writer.write(start_us + round(due_s * 1e6), frame)
    truth = out.with_suffix(".truth.json")
    write_truth(truth, truth_of(world_scenario, chosen, seed))
    return OverlayResult(tuple(vehicles), len(records), len(added), truth)


def _read_vehicles(
    records: list[tuple[int, bytes]], start_us: int
) -> tuple[dict[int, _Recorded], Geodetic | None]:
    """Poses by vehicle (times mapped to seconds since ``start_us``), and the ground's place."""
    heard: dict[int, list[tuple[float, Attitude | GlobalPosition]]] = {}
    vehicles: dict[int, _Recorded] = {}
    homes: dict[int, Geodetic] = {}
    grounds: dict[int, Geodetic] = {}
    for unix_us, raw in records:
        frame = frame_of(raw)
        if frame.component_id != AUTOPILOT_COMPONENT or frame.message_id not in _POSES:
            continue
        message = decode(frame)
        if isinstance(message, HomePosition):
            if message.position.is_valid():
                homes.setdefault(frame.system_id, message.position)
        elif isinstance(message, Attitude | GlobalPosition):
            vehicle = vehicles.setdefault(frame.system_id, _Recorded(PoseTrack()))
            boot_s = message.boot_ms * 1e-3
            vehicle.offset_s = min(vehicle.offset_s, (unix_us - start_us) * 1e-6 - boot_s)
            heard.setdefault(frame.system_id, []).append((boot_s, message))
            if isinstance(message, GlobalPosition) and message.position is not None:
                place = message.position
                ground_amsl_m = place.altitude_amsl_m - message.height_above_home_m
                grounds.setdefault(
                    frame.system_id, Geodetic(place.latitude_deg, place.longitude_deg, ground_amsl_m)
                )
    for system_id, vehicle in vehicles.items():
        for boot_s, message in heard[system_id]:
            if isinstance(message, Attitude):
                vehicle.track.add_attitude(boot_s + vehicle.offset_s, message.attitude)
            elif message.position is not None:
                vehicle.track.add_position(boot_s + vehicle.offset_s, message.position)
    located = {
        system_id: vehicles[system_id] for system_id in sorted(vehicles) if vehicles[system_id].track.position
    }
    # The lowest system id's, so that it does not hang on whose message came first.
    known = homes or grounds
    return located, known[min(known)] if known else None


def _sensor_frames(
    scenario: Scenario,
    beacons: tuple[BeaconSpec, ...],
    vehicles: dict[int, _Recorded],
    seed: int,
    settings: SensorSettings,
    end_s: float,
) -> list[tuple[float, bytes]]:
    """(seconds since the recording's start, frame) of every sensor, in order of time."""
    world = World(scenario.obstacles, scenario.propagation.rubble_attenuation_db_per_m)
    packets = [
        packet for i, spec in enumerate(beacons) for packet in BeaconTransmitter(spec, i, seed).until(end_s)
    ]
    packets.sort(key=lambda packet: (packet.time_s, packet.beacon))
    frames: list[tuple[float, int, bytes]] = []
    for system_id, vehicle in vehicles.items():
        sensor = RadioSensor(system_id, scenario, beacons, world, seed, settings)
        for packet in packets:
            sensor.step(packet.time_s)
            pose = vehicle.track.at(packet.time_s, scenario.frame)
            if pose is not None:
                sensor.hear(packet, *pose)
            frames += [(due_s, system_id, frame) for due_s, frame in sensor.take(packet.time_s)]
        sensor.step(end_s)
        frames += [(due_s, system_id, frame) for due_s, frame in sensor.take(end_s)]
    # The sort is stable: a sensor's own frames keep their order, and with it their sequence.
    frames.sort(key=lambda item: item[:2])
    return [(due_s, frame) for due_s, _, frame in frames]
