"""The whole simulated world, deterministic: scenario, vehicles, beacons and a seed, nothing else.

Keeps the rule that no clock, socket or global randomness is in here: the same calls give the
same bytes. swarm.py paces it and puts its frames on sockets.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from groundstation.domain.errors import UsageError
from groundstation.domain.geometry import Enu
from groundstation.mavlink.dialect import dialect
from sim_sitl.beacon import BeaconTransmitter, choose_beacons
from sim_sitl.commands import CommandHandler
from sim_sitl.flight import Orbit
from sim_sitl.modes import Flavour
from sim_sitl.radio_sensor import RadioSensor, SensorSettings
from sim_sitl.scenario import BeaconSpec, Scenario
from sim_sitl.vehicle import TICK_S, Vehicle, VehicleSettings
from sim_sitl.world import World

MAX_VEHICLES = 200
HOME_SPACING_M = 3.0


@dataclass(frozen=True, slots=True)
class SimulationSettings:
    """What may be chosen beside scenario, counts and seed."""

    airborne: bool = True
    """Start in the air with the first pattern under way; else on the ground, booting."""
    flavour: Flavour = Flavour.ARDUPILOT
    ready_after_s: float = 42.0
    """From boot until a vehicle on the ground would arm."""
    start_unix_usec: int = 1_800_000_000_000_000
    """Unix time when the run starts."""
    first_system_id: int = 1
    sensor: SensorSettings = field(default_factory=SensorSettings)


class Simulation:
    """Vehicles with their sensors, and beacons. ``step`` moves on; frames go in and out."""

    def __init__(
        self,
        scenario: Scenario,
        vehicles: int,
        beacons: int | None,
        seed: int,
        settings: SimulationSettings | None = None,
    ) -> None:
        settings = settings or SimulationSettings()
        last_id = settings.first_system_id + vehicles - 1
        if not 1 <= vehicles <= MAX_VEHICLES or last_id > 250:
            raise UsageError(f"{vehicles} vehicles asked for; needed: 1 to {MAX_VEHICLES}")
        self.scenario = scenario
        self.seed = seed
        self.beacons = choose_beacons(scenario, beacons, seed)
        self.time_s = 0.0
        world = World(scenario.obstacles, scenario.propagation.rubble_attenuation_db_per_m)
        self._transmitters = [BeaconTransmitter(spec, i, seed) for i, spec in enumerate(self.beacons)]
        self.vehicles: dict[int, Vehicle] = {}
        self.sensors: dict[int, RadioSensor] = {}
        self._commands: dict[int, CommandHandler] = {}
        self._ticks = 0
        self.rejected_frames = 0
        """Frames from outside that could not be decoded."""
        self._decoder = dialect.MAVLink(None)
        for index in range(vehicles):
            system_id = settings.first_system_id + index
            vehicle = Vehicle(_vehicle_settings(scenario, settings, index, vehicles), scenario.frame, seed)
            self.vehicles[system_id] = vehicle
            self._commands[system_id] = CommandHandler(vehicle)
            self.sensors[system_id] = RadioSensor(
                system_id, scenario, self.beacons, world, seed, settings.sensor
            )

    def step(self, time_s: float) -> dict[int, list[bytes]]:
        """Advance to ``time_s`` (seconds since the start); the frames each vehicle sent, in order.

        Motion runs on a fixed raster, so the slicing of calls does not change the outcome.
        """
        frames: dict[int, list[bytes]] = {system_id: [] for system_id in self.vehicles}
        while (self._ticks + 1) * TICK_S <= time_s + 1e-9:
            self._ticks += 1
            self.time_s = self._ticks * TICK_S
            packets = sorted(
                (packet for transmitter in self._transmitters for packet in transmitter.until(self.time_s)),
                key=lambda packet: (packet.time_s, packet.beacon),
            )
            for system_id, vehicle in self.vehicles.items():
                vehicle.step(self.time_s)
                sensor = self.sensors[system_id]
                sensor.step(self.time_s)
                for packet in packets:
                    sensor.hear(
                        packet, _position_at(vehicle, self.time_s - packet.time_s), vehicle.flight.attitude
                    )
                frames[system_id] += vehicle.take()
                frames[system_id] += [frame for _, frame in sensor.take(self.time_s)]
        return frames

    def receive(self, vehicle_id: int, frame: bytes) -> None:
        """A whole verified frame that reached one vehicle's radio."""
        try:
            message: Any = self._decoder.decode(bytearray(frame))
        except dialect.MAVError:
            self.rejected_frames += 1
            return
        self._commands[vehicle_id].handle(message)
        self.sensors[vehicle_id].receive(message, self.time_s)

    def truth(self) -> dict[str, Any]:
        """Where the beacons are, for whoever scores the estimates."""
        return truth_of(self.scenario, self.beacons, self.seed)

    def describe(self) -> str:
        """One line: what flies, and which links are line-of-sight."""
        parts = []
        for system_id, vehicle in self.vehicles.items():
            states = self.sensors[system_id].line_of_sight
            marks = "".join("?" if state is None else "L" if state else "n" for state in states)
            height = vehicle.flight.position_m[2] - vehicle.settings.home_enu_m[2]
            parts.append(
                f"{system_id} {vehicle.mode}{'' if vehicle.armed else ' disarmed'} {height:.0f} m {marks}"
            )
        return f"t {self.time_s:.0f} s: " + " | ".join(parts)


def truth_of(scenario: Scenario, beacons: tuple[BeaconSpec, ...], seed: int) -> dict[str, Any]:
    """The truth as a JSON tree: each beacon's id (decimal string), place and power."""
    listed = []
    for beacon in beacons:
        place = scenario.frame.to_geodetic(beacon.position_enu_m)
        listed.append(
            {
                "id": str(beacon.beacon_id),
                "lat": round(place.latitude_deg, 9),
                "lon": round(place.longitude_deg, 9),
                "alt_amsl_m": round(place.altitude_amsl_m, 3),
                "transmit_power_dbm": beacon.transmit_power_dbm,
            }
        )
    return {
        "format": "sim-sitl-truth",
        "version": 1,
        "scenario": scenario.name,
        "seed": seed,
        "beacons": listed,
    }


def write_truth(path: Path, truth: dict[str, Any]) -> None:
    """Write a truth file."""
    path.write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


def _vehicle_settings(
    scenario: Scenario, settings: SimulationSettings, index: int, count: int
) -> VehicleSettings:
    spec = scenario.vehicles
    angle = 2 * math.pi * index / count
    center = spec.ring_center_m
    row = HOME_SPACING_M * (index - (count - 1) / 2)
    base = VehicleSettings(
        system_id=settings.first_system_id + index,
        home_enu_m=(spec.home_m[0] + row, spec.home_m[1], 0.0),
        flavour=settings.flavour,
        airborne=settings.airborne,
        start_enu_m=(
            center[0] + spec.ring_radius_m * math.cos(angle),
            center[1] + spec.ring_radius_m * math.sin(angle),
            spec.altitude_m,
        ),
        speed_m_s=spec.speed_m_s,
        ready_after_s=settings.ready_after_s,
        prearm_after_s=min(23.0, settings.ready_after_s),
        position_after_s=min(9.0, settings.ready_after_s),
        start_unix_usec=settings.start_unix_usec,
    )
    if spec.pattern == "hover":
        return base
    return replace(base, pattern=Orbit(center, spec.ring_radius_m, spec.altitude_m, spec.speed_m_s))


def _position_at(vehicle: Vehicle, ago_s: float) -> Enu:
    """Where it was a part of a tick ago: within one, velocity is constant."""
    x, y, z = vehicle.flight.position_enu_m
    vx, vy, vz = vehicle.flight.velocity_enu_m_s
    return x - vx * ago_s, y - vy * ago_s, z - vz * ago_s
