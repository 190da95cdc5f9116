"""The simulated radio sensor on real autopilots: ``sim-sitl swarm --attach URL``.

A router between autopilots (ArduPilot or PX4, in simulation or not) and the station: their
frames pass both ways untouched, and each vehicle gets a component 191 that hears the
scenario's beacons where the autopilot says it is. Keeps the rule that the deciding part
(:class:`AttachedSensors`) has no clock and no socket.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from groundstation.domain.geometry import Geodetic
from groundstation.domain.vehicle import AUTOPILOT_COMPONENT, SENSOR_COMPONENT
from groundstation.mavlink.decode import decode
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.framing import Frame, Framer
from groundstation.mavlink.messages import Attitude, CommandAck, GlobalPosition, HomePosition
from sim_sitl.beacon import BeaconTransmitter, choose_beacons
from sim_sitl.endpoints import Endpoint, LinkUrl, UdpIn, open_endpoint
from sim_sitl.lossy_link import LinkQuality, LossyLink
from sim_sitl.poses import PoseTrack
from sim_sitl.radio_sensor import RadioSensor, SensorSettings
from sim_sitl.scenario import BeaconSpec, Scenario
from sim_sitl.simulation import truth_of, write_truth
from sim_sitl.swarm import PACE_S, REPORT_INTERVAL_S, stop_on_signals
from sim_sitl.world import World

STREAMS_US = ((33, 200_000), (30, 100_000))
"""What a sensor needs of its autopilot: message id, interval."""
ASK_AGAIN_S = 2.0
"""When a stream is silent for so long it is asked for (again)."""
POSE_LATENCY_S = 0.15
"""Packets are evaluated so much later, when poses on both sides of them have come."""
HISTORY_S = 10.0
MAX_VEHICLES = 200


@dataclass(slots=True)
class Outgoing:
    """What one call makes of it: frames for both sides of one vehicle."""

    to_station: list[bytes] = field(default_factory=list)
    to_autopilot: list[bytes] = field(default_factory=list)


@dataclass(slots=True)
class _Attached:
    """One real vehicle."""

    encoder: Encoder
    track: PoseTrack = field(default_factory=PoseTrack)
    sensor: RadioSensor | None = None
    offset_s: float = float("inf")
    """Our time minus its boot time, at the shortest delay seen."""
    heard_s: dict[int, float] = field(default_factory=dict)
    """Message id → our time."""
    asked_s: float = float("-inf")


class AttachedSensors:
    """Sensors for whatever vehicles are heard. Times are seconds on one clock of the caller's."""

    def __init__(self, scenario: Scenario, beacons: int | None, seed: int, settings: SensorSettings) -> None:
        self.scenario = scenario
        self.anchored = not scenario.relative
        """Whether the scenario has its place: a relative one takes the first vehicle's home."""
        self.beacons: tuple[BeaconSpec, ...] = choose_beacons(scenario, beacons, seed)
        self.vehicles_refused = 0
        self._seed = seed
        self._settings = settings
        self._world = World(scenario.obstacles, scenario.propagation.rubble_attenuation_db_per_m)
        self._transmitters = [BeaconTransmitter(spec, i, seed) for i, spec in enumerate(self.beacons)]
        self._vehicles: dict[int, _Attached] = {}
        self._decoder = dialect.MAVLink(None)

    @property
    def vehicle_ids(self) -> list[int]:
        """Vehicles heard so far."""
        return list(self._vehicles)

    def from_autopilot(self, frame: Frame, time_s: float) -> Outgoing:
        """A frame that a vehicle sent."""
        out = Outgoing()
        if frame.component_id != AUTOPILOT_COMPONENT:
            out.to_station.append(frame.raw)
            return out
        vehicle = self._vehicles.get(frame.system_id)
        if vehicle is None:
            if len(self._vehicles) >= MAX_VEHICLES:
                self.vehicles_refused += 1
                out.to_station.append(frame.raw)
                return out
            vehicle = self._vehicles[frame.system_id] = _Attached(Encoder(frame.system_id, SENSOR_COMPONENT))
        message = decode(frame)
        if (
            isinstance(message, CommandAck)
            and message.target_component == SENSOR_COMPONENT
            and message.target_system == frame.system_id
        ):
            return out
        out.to_station.append(frame.raw)
        vehicle.heard_s[frame.message_id] = time_s
        if isinstance(message, Attitude | GlobalPosition):
            boot_s = message.boot_ms * 1e-3
            if time_s - boot_s < vehicle.offset_s or time_s - boot_s > vehicle.offset_s + 5.0:
                # A shorter delay than ever, or the vehicle started anew.
                vehicle.offset_s = time_s - boot_s
            if isinstance(message, Attitude):
                vehicle.track.add_attitude(boot_s + vehicle.offset_s, message.attitude)
            elif message.position is not None:
                vehicle.track.add_position(boot_s + vehicle.offset_s, message.position)
                place = message.position
                self._anchor(
                    Geodetic(
                        place.latitude_deg,
                        place.longitude_deg,
                        place.altitude_amsl_m - message.height_above_home_m,
                    )
                )
        elif isinstance(message, HomePosition) and message.position.is_valid():
            self._anchor(message.position)
        return out

    def from_station(self, vehicle_id: int, frame: Frame, time_s: float) -> Outgoing:
        """A frame that the station sent to one vehicle's address."""
        out = Outgoing(to_autopilot=[frame.raw])
        vehicle = self._vehicles.get(vehicle_id)
        if vehicle is not None and vehicle.sensor is not None:
            with contextlib.suppress(dialect.MAVError):
                vehicle.sensor.receive(self._decoder.decode(bytearray(frame.raw)), time_s)
        return out

    def step(self, time_s: float) -> dict[int, Outgoing]:
        """Advance to ``time_s``: packets are heard, streams that are silent are asked for."""
        out = {vehicle_id: Outgoing() for vehicle_id in self._vehicles}
        packets = [
            p for transmitter in self._transmitters for p in transmitter.until(time_s - POSE_LATENCY_S)
        ]
        packets.sort(key=lambda packet: (packet.time_s, packet.beacon))
        for vehicle_id, vehicle in self._vehicles.items():
            self._ask(vehicle_id, vehicle, time_s, out[vehicle_id])
            if not self.anchored:
                continue
            if vehicle.sensor is None:
                vehicle.sensor = RadioSensor(
                    vehicle_id, self.scenario, self.beacons, self._world, self._seed, self._settings
                )
                # Its heartbeats begin now, not when the run began.
                vehicle.sensor.step(time_s)
                vehicle.sensor.take(time_s)
            vehicle.sensor.step(time_s)
            for packet in packets:
                pose = vehicle.track.at(packet.time_s, self.scenario.frame)
                if pose is not None:
                    vehicle.sensor.hear(packet, *pose)
            vehicle.track.forget_before(time_s - HISTORY_S)
            out[vehicle_id].to_station += [frame for _, frame in vehicle.sensor.take(time_s)]
        return out

    def describe(self) -> str:
        """One line: which vehicles are heard, and which links are line-of-sight."""
        parts = []
        for vehicle_id, vehicle in self._vehicles.items():
            states = vehicle.sensor.line_of_sight if vehicle.sensor else []
            marks = "".join("?" if state is None else "L" if state else "n" for state in states)
            parts.append(f"{vehicle_id} {marks or 'no position yet'}")
        return "attached: " + (" | ".join(parts) or "no autopilot heard yet")

    def _ask(self, vehicle_id: int, vehicle: _Attached, time_s: float, out: Outgoing) -> None:
        silent = [s for s in STREAMS_US if time_s - vehicle.heard_s.get(s[0], float("-inf")) > ASK_AGAIN_S]
        if not silent or time_s - vehicle.asked_s < ASK_AGAIN_S:
            return
        vehicle.asked_s = time_s
        for message_id, interval_us in silent:
            request = dialect.MAVLink_command_long_message(
                vehicle_id, AUTOPILOT_COMPONENT, 511, 0, message_id, interval_us, 0, 0, 0, 0, 0
            )
            out.to_autopilot.append(vehicle.encoder.pack(request))

    def _anchor(self, ground: Geodetic) -> None:
        if not self.anchored and ground.is_valid():
            self.scenario = self.scenario.at(ground)
            self.anchored = True


@dataclass(frozen=True, slots=True)
class AttachOptions:
    """A run on real autopilots."""

    scenario: Scenario
    attach: LinkUrl
    link: LinkUrl
    beacons: int | None = None
    seed: int = 1
    duration_s: float | None = None
    truth: Path | None = None
    quality: LinkQuality = field(default_factory=LinkQuality)
    sensor: SensorSettings = field(default_factory=SensorSettings)


class AttachedSwarm:
    """AttachedSensors with sockets: one listening to autopilots, one a vehicle to the station."""

    def __init__(self, options: AttachOptions, report: Callable[[str], None] | None = None) -> None:
        self.sensors = AttachedSensors(options.scenario, options.beacons, options.seed, options.sensor)
        self._options = options
        self._report = report
        self._began = time.monotonic()
        self._autopilots = UdpIn(self._from_autopilot)
        self._autopilot_framers: dict[tuple[str, int], Framer] = {}
        self._addresses: dict[int, tuple[str, int]] = {}
        self._stations: dict[int, Endpoint] = {}
        self._station_framers: dict[int, Framer] = {}
        self._down: dict[int, LossyLink] = {}
        self._stopping = asyncio.Event()

    def stop(self) -> None:
        """End the run soon."""
        self._stopping.set()

    async def run(self) -> None:
        """Route until the duration is over or somebody stops it; raises ResourceError."""
        options = self._options
        truth_written = options.truth is None
        try:
            await self._autopilots.open(options.attach)
            report_at = REPORT_INTERVAL_S
            while not self._stopping.is_set() and (
                options.duration_s is None or self._now_s() < options.duration_s
            ):
                now_s = self._now_s()
                for vehicle_id, out in self.sensors.step(now_s).items():
                    if vehicle_id not in self._stations:
                        self._station_framers[vehicle_id] = Framer()
                        self._down[vehicle_id] = LossyLink(options.quality, options.seed, vehicle_id, 0)
                        self._stations[vehicle_id] = await open_endpoint(
                            options.link, partial(self._from_station, vehicle_id)
                        )
                    self._send(vehicle_id, out)
                    for frame in self._down[vehicle_id].due(now_s):
                        self._stations[vehicle_id].send(frame)
                if not truth_written and self.sensors.anchored and options.truth is not None:
                    write_truth(
                        options.truth, truth_of(self.sensors.scenario, self.sensors.beacons, options.seed)
                    )
                    truth_written = True
                if self._report is not None and now_s >= report_at:
                    report_at = now_s + REPORT_INTERVAL_S
                    self._report(self.sensors.describe())
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._stopping.wait(), PACE_S)
        finally:
            self._autopilots.close()
            for endpoint in self._stations.values():
                endpoint.close()

    def _now_s(self) -> float:
        return time.monotonic() - self._began

    def _send(self, vehicle_id: int, out: Outgoing) -> None:
        address = self._addresses.get(vehicle_id)
        if address is not None:
            for frame in out.to_autopilot:
                self._autopilots.send(frame, address)
        if vehicle_id in self._down:
            for frame in out.to_station:
                self._down[vehicle_id].offer(self._now_s(), frame)

    def _from_autopilot(self, data: bytes, address: tuple[str, int]) -> None:
        framer = self._autopilot_framers.get(address)
        if framer is None:
            if len(self._autopilot_framers) >= MAX_VEHICLES:
                return
            framer = self._autopilot_framers[address] = Framer()
        for frame in framer.feed(data):
            self._addresses[frame.system_id] = address
            self._send(frame.system_id, self.sensors.from_autopilot(frame, self._now_s()))

    def _from_station(self, vehicle_id: int, data: bytes) -> None:
        for frame in self._station_framers[vehicle_id].feed(data):
            self._send(vehicle_id, self.sensors.from_station(vehicle_id, frame, self._now_s()))


def run_attached(options: AttachOptions, report: Callable[[str], None] | None) -> None:
    """``sim-sitl swarm --attach``: blocks until the end, or until SIGINT or SIGTERM."""

    async def main() -> None:
        swarm = AttachedSwarm(options, report)
        stop_on_signals(swarm.stop)
        await swarm.run()

    asyncio.run(main())
