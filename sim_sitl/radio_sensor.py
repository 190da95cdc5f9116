"""The radio sensor of one vehicle: component 191, with a clock of its own.

Hears the beacons' packets where the vehicle is and speaks SAR_RSS, SAR_AOA, SAR_CIR and
SAR_LINK_STATE. Keeps the rule that it knows no station: it sends CIRs unasked only when
configured to, and else answers SAR_CIR_REQUEST. The vehicle may be ours, a real autopilot
(attach.py) or a recording (overlay.py): it is only told poses.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, field
from typing import Any

from groundstation.domain.geometry import Enu, Quaternion
from groundstation.domain.vehicle import SENSOR_COMPONENT
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.tunnel import wrap
from sim_sitl.beacon import Packet
from sim_sitl.cir import Sounder
from sim_sitl.cir_encoding import CirEncoding
from sim_sitl.cir_sounding import LinkSounder
from sim_sitl.flight import rotate_to_body
from sim_sitl.propagation import LinkChannel, Reception
from sim_sitl.randomness import Stream, generator
from sim_sitl.scenario import BeaconSpec, Scenario
from sim_sitl.world import World

_LOCAL_NED, _BODY_FRD = 1, 12
_INT16_MIN = -32768
MAX_PENDING = 2048
"""Messages waiting for their delay."""


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """How the radio sensors are configured."""

    cir_every: int = 2
    """Send a CIR unasked with each n-th packet of a beacon; 0 = only on request."""
    cir_encoding: CirEncoding = CirEncoding.U8_LOG_MAGNITUDE
    """Of unasked captures."""
    cir_full: bool = False
    """Unasked captures hold the full response instead of the 64 taps round the first path."""
    angles: str = "body"
    """``body`` (airframe), ``earth`` or ``off``."""
    link_state: bool = False
    """Send SAR_LINK_STATE, as an on-board classifier would."""
    tunnel: bool = False
    """Wrap our messages in TUNNEL."""
    clock_skew: float = 1e-5
    """Standard deviation of the sensor clock's rate error."""
    delay_s: tuple[float, float] = (0.008, 0.020)
    """From a packet to its messages, uniform."""
    sounder: Sounder = field(default_factory=Sounder)


@dataclass(slots=True)
class _CirOrder:
    """A SAR_CIR_REQUEST being served."""

    beacon_id: int
    window: tuple[int, int] | None
    encoding: CirEncoding
    left: int | None
    interval_s: float
    next_s: float


class RadioSensor:
    """One vehicle's sensor. All times are on the run's clock, seconds."""

    def __init__(
        self,
        vehicle_id: int,
        scenario: Scenario,
        beacons: tuple[BeaconSpec, ...],
        world: World,
        seed: int,
        settings: SensorSettings,
    ) -> None:
        self.vehicle_id = vehicle_id
        self._settings = settings
        self._beacons = beacons
        self._world = world
        self._report_offset_db = scenario.propagation.report_offset_db
        self._channels = [
            LinkChannel(
                scenario.propagation,
                scenario.receiver,
                beacon,
                seed=seed,
                vehicle_id=vehicle_id,
                beacon_key=i,
            )
            for i, beacon in enumerate(beacons)
        ]
        self._sounders = [
            LinkSounder(seed, vehicle_id, i, beacon.frequency_hz, settings.sounder)
            for i, beacon in enumerate(beacons)
        ]
        self._heard = [0] * len(beacons)
        self.lost_below_sensitivity = [0] * len(beacons)
        """Packets too weak to hear, per beacon."""
        self.dropped = 0
        """Messages that found the sensor's queue full."""
        self.line_of_sight: list[bool | None] = [None] * len(beacons)
        """State of each link at its last packet; None before the first."""
        self._rng = generator(seed, Stream.SENSOR_CLOCK, vehicle_id)
        self._boot_s = -float(self._rng.uniform(20.0, 300.0))
        self._skew = settings.clock_skew * float(self._rng.standard_normal())
        self._encoder = Encoder(vehicle_id, SENSOR_COMPONENT)
        self._pending: list[tuple[float, int, Any]] = []
        self._pushed = 0
        self._orders: list[_CirOrder] = []
        self._heartbeat_s = float(self._rng.random())
        self._time_s = 0.0

    def clock_ns(self, time_s: float) -> int:
        """The sensor's own clock: ns since its boot."""
        return round((time_s - self._boot_s) * (1.0 + self._skew) * 1e9)

    def step(self, time_s: float) -> None:
        """Advance to ``time_s``: heartbeats and time come once a second."""
        self._time_s = time_s
        while self._heartbeat_s <= time_s:
            due = self._heartbeat_s
            self._push(due, dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
            self._push(due, dialect.MAVLink_system_time_message(0, self.clock_ns(due) // 1_000_000))
            self._heartbeat_s += 1.0

    def hear(self, packet: Packet, position_enu_m: Enu, attitude: Quaternion) -> None:
        """A packet was sent while the vehicle was at ``position_enu_m`` with ``attitude``."""
        beacon = self._beacons[packet.beacon]
        obstruction = self._world.obstruction(beacon, position_enu_m)
        self.line_of_sight[packet.beacon] = obstruction.line_of_sight
        reception = self._channels[packet.beacon].receive(position_enu_m, obstruction)
        if not reception.heard:
            self.lost_below_sensitivity[packet.beacon] += 1
            return
        due = packet.time_s + float(self._rng.uniform(*self._settings.delay_s))
        time_usec = self.clock_ns(packet.time_s) // 1000
        self._push_sar(due, self._rss(time_usec, beacon, packet, reception))
        if self._settings.angles != "off":
            self._push_sar(due, self._aoa(time_usec, beacon, reception, attitude))
        if self._settings.link_state:
            shape = (8.0, 2.0) if obstruction.line_of_sight else (2.0, 8.0)
            probability = float(self._rng.beta(*shape))
            self._push_sar(
                due, dialect.MAVLink_sar_link_state_message(time_usec, beacon.beacon_id, probability, 1)
            )
        self._captures(due, time_usec, packet, position_enu_m, reception)
        self._heard[packet.beacon] += 1

    def receive(self, message: Any, time_s: float) -> None:
        """A decoded message from anybody."""
        kind = message.get_type()
        if kind == "TIMESYNC":
            if message.tc1 == 0:
                self._push(time_s, dialect.MAVLink_timesync_message(self.clock_ns(time_s), message.ts1))
            return
        if getattr(message, "target_system", -1) not in (0, self.vehicle_id):
            return
        if kind == "SAR_CIR_REQUEST" and message.target_component in (0, SENSOR_COMPONENT):
            self._take_order(message, time_s)
        elif kind in ("COMMAND_LONG", "COMMAND_INT") and message.target_component == SENSOR_COMPONENT:
            sender = message.get_srcSystem(), message.get_srcComponent()
            self._push(time_s, dialect.MAVLink_command_ack_message(message.command, 3, 0, 0, *sender))

    def take(self, time_s: float) -> list[tuple[float, bytes]]:
        """(time, frame) of what left up to ``time_s``, in order."""
        frames: list[tuple[float, bytes]] = []
        while self._pending and self._pending[0][0] <= time_s:
            due, _, message = heapq.heappop(self._pending)
            frames.append((due, self._encoder.pack(message)))
        return frames

    # ── messages ──────────────────────────────────────────────────────────────────────────────

    def _rss(self, time_usec: int, beacon: BeaconSpec, packet: Packet, reception: Reception) -> Any:
        level, noise = (
            max(_INT16_MIN + 1, min(32767, round(x * 100))) for x in (reception.rss_dbm, reception.noise_dbm)
        )
        return dialect.MAVLink_sar_rss_message(
            time_usec, beacon.beacon_id, beacon.frequency_hz, level, noise, packet.sequence
        )

    def _aoa(self, time_usec: int, beacon: BeaconSpec, reception: Reception, attitude: Quaternion) -> Any:
        azimuth, elevation = reception.azimuth_rad, reception.elevation_rad
        ned = (
            math.cos(elevation) * math.sin(azimuth),
            math.cos(elevation) * math.cos(azimuth),
            -math.sin(elevation),
        )
        frame = _LOCAL_NED
        if self._settings.angles == "body":
            frame, ned = _BODY_FRD, rotate_to_body(attitude, ned)
        std = reception.angle_std_rad
        return dialect.MAVLink_sar_aoa_message(
            time_usec, beacon.beacon_id, math.atan2(ned[1], ned[0]),
            math.atan2(-ned[2], math.hypot(ned[0], ned[1])), std, std, frame,
        )  # fmt: skip

    def _captures(
        self, due_s: float, time_usec: int, packet: Packet, position_enu_m: Enu, reception: Reception
    ) -> None:
        beacon = self._beacons[packet.beacon]
        settings = self._settings
        wanted: list[tuple[CirEncoding, tuple[int, int] | None]] = []
        if settings.cir_every and self._heard[packet.beacon] % settings.cir_every == 0:
            wanted.append((settings.cir_encoding, (0, settings.sounder.taps) if settings.cir_full else None))
        for order in self._orders:
            if order.beacon_id in (0, beacon.beacon_id) and packet.time_s >= order.next_s:
                wanted.append((order.encoding, order.window))
                order.next_s = packet.time_s + order.interval_s
                if order.left is not None:
                    order.left -= 1
        self._orders = [order for order in self._orders if order.left is None or order.left > 0]
        toward = tuple(b - a for a, b in zip(position_enu_m, beacon.position_enu_m, strict=True))
        for encoding, window in wanted:
            for fields in self._sounders[packet.beacon].capture(
                position_enu_m,
                (toward[0], toward[1], toward[2]),
                reception,
                report_offset_db=self._report_offset_db,
                encoding=encoding,
                window=window,
                tunnel=settings.tunnel,
            ):
                values = {**fields, "data": list(fields["data"])}
                self._push_sar(due_s, dialect.MAVLink_sar_cir_message(time_usec, beacon.beacon_id, **values))

    def _take_order(self, m: Any, time_s: float) -> None:
        """A request: ``captures`` of one beacon (0: of any), 0 captures = until stopped, interval 0 = stop.

        For one beacon there is one order: the newest.
        """
        self._orders = [order for order in self._orders if m.beacon_id not in (0, order.beacon_id)]
        if m.interval_ms == 0 or m.encoding not in tuple(CirEncoding):
            return
        targets = [m.beacon_id] if m.beacon_id else [beacon.beacon_id for beacon in self._beacons]
        for beacon_id in targets:
            self._orders.append(
                _CirOrder(
                    beacon_id=beacon_id,
                    window=(m.first_tap, m.tap_count) if m.tap_count else None,
                    encoding=CirEncoding(m.encoding),
                    left=m.captures or None,
                    interval_s=m.interval_ms * 1e-3,
                    next_s=time_s,
                )
            )

    def _push_sar(self, due_s: float, message: Any) -> None:
        self._push(due_s, wrap(message) if self._settings.tunnel else message)

    def _push(self, due_s: float, message: Any) -> None:
        if len(self._pending) >= MAX_PENDING:
            self.dropped += 1
            return
        self._pushed += 1
        heapq.heappush(self._pending, (due_s, self._pushed, message))
