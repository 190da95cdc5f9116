"""What the station asks of vehicles and tells them, without moving any of them.

A live autopilot sends only HEARTBEAT until asked, so every needed message is asked for, and
asked for again, ever more seldom, until it comes. Impulse responses are asked for link by
link within each connection's byte budget: a telemetry radio carries 1.6 kB/s in all.

All of it is decided on ticks and frames; the guard lets these messages pass as harmless.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from groundstation.command.outputs import SendFrame
from groundstation.command.settings import CommandSettings, StreamRequest, TelemetrySettings
from groundstation.domain.inputs import Direction, FrameInput, Record, SessionInput, TickInput
from groundstation.domain.radio import LinkActivity
from groundstation.domain.target import TargetState
from groundstation.domain.vehicle import AUTOPILOT_COMPONENT, SENSOR_COMPONENT, VehicleState
from groundstation.mavlink import encode
from groundstation.mavlink.framing import frame_of
from groundstation.mavlink.messages import Timesync
from groundstation.mavlink.vehicle_message import VehicleMessage

_HOME_POSITION = 242
_REQUESTS_PER_TICK = 2
"""Of each vehicle: a slow radio must not be flooded when a vehicle appears."""
_FAST_TIMESYNCS = 5
"""The first ones come a second apart, so that times can be mapped soon."""
_CIR_OVERHEAD_BYTES, _CIR_DATA_BYTES = 52, 212
_RENEW_AT = 0.8
"""Part of the asked-for captures after which they are asked for again."""


@dataclass(slots=True)
class _Asked:
    """One repeated request."""

    attempts: int = 0
    next_ns: int = 0
    heard_ns: int | None = None


@dataclass(slots=True)
class _Vehicle:
    state: VehicleState
    streams: dict[int, _Asked] = field(default_factory=dict)
    home: _Asked = field(default_factory=_Asked)
    timesync: _Asked = field(default_factory=_Asked)


@dataclass(slots=True)
class _Link:
    heard_ns: int
    next_ns: int = 0


class TelemetryDesk:
    """Heartbeat, stream requests, home, TIMESYNC, CIR requests, target estimates."""

    def __init__(
        self, settings: TelemetrySettings | None = None, identity: CommandSettings | None = None
    ) -> None:
        self.settings = settings or TelemetrySettings()
        identity = identity or CommandSettings()
        self._own = (identity.system_id, identity.component_id)
        self._encoder = encode.Encoder(*self._own)
        self._forget()

    def handle(
        self, record: Record, ingest_outputs: Iterable[object], targets: Iterable[TargetState]
    ) -> list[SendFrame]:
        """One record of the journal, what ingest made of it, and the newest beliefs."""
        sends: list[SendFrame] = []
        for item in ingest_outputs:
            if isinstance(item, VehicleState):
                self._on_state(item)
            elif isinstance(item, LinkActivity):
                link = self._links.setdefault((item.vehicle_id, item.beacon_id), _Link(item.time_ns))
                link.heard_ns = item.time_ns
            elif isinstance(item, VehicleMessage) and isinstance(item.message, Timesync):
                sends += self._answer_timesync(item, item.message, record.time_ns)
        match record.input:
            case FrameInput(direction=Direction.IN, frame=raw):
                self._on_frame(raw, record.time_ns)
            case TickInput():
                sends += self._on_tick(record, targets)
            case SessionInput(event="resumed"):
                self._forget()
        return sends

    def _forget(self) -> None:
        self._vehicles: dict[int, _Vehicle] = {}
        self._links: dict[tuple[int, int], _Link] = {}
        self._heartbeat_ns = 0
        self._estimates_ns: dict[int, int] = {}

    def _on_state(self, state: VehicleState) -> None:
        vehicle = self._vehicles.get(state.vehicle_id)
        if vehicle is None:
            self._vehicles[state.vehicle_id] = vehicle = _Vehicle(state)
        if state.armed and not vehicle.state.armed:
            # Arming moves home to where the vehicle stands.
            vehicle.home = _Asked()
        if state.home is not None and state.home != vehicle.state.home:
            vehicle.home.heard_ns = state.time_ns
        vehicle.state = state

    def _on_frame(self, raw: bytes, now: int) -> None:
        frame = frame_of(raw)
        vehicle = self._vehicles.get(frame.system_id)
        if vehicle is None or frame.component_id != AUTOPILOT_COMPONENT:
            return
        if frame.message_id == _HOME_POSITION:
            vehicle.home.heard_ns = now
        asked = vehicle.streams.get(frame.message_id)
        if asked is not None:
            asked.heard_ns = now

    def _answer_timesync(self, item: VehicleMessage, message: Timesync, now: int) -> list[SendFrame]:
        if message.tc1 != 0:
            return []
        reply = encode.timesync_reply(message.ts1, now)
        return [self._send(item.vehicle_id, reply)]

    def _on_tick(self, record: Record, targets: Iterable[TargetState]) -> list[SendFrame]:
        now = record.time_ns
        sends: list[SendFrame] = []
        if now >= self._heartbeat_ns:
            self._heartbeat_ns = now + _ns(self.settings.heartbeat_s)
            sends.append(self._send(None, encode.heartbeat()))
        for vehicle_id in sorted(self._vehicles):
            vehicle = self._vehicles[vehicle_id]
            if vehicle.state.lost:
                continue
            sends += self._ask_streams(vehicle_id, vehicle, now)
            sends += self._ask_home(vehicle_id, vehicle, now)
            sends += self._ask_time(vehicle_id, vehicle, now)
        if self.settings.cir_interval_ms > 0:
            sends += self._ask_captures(now)
        if self.settings.estimate_s > 0.0:
            sends += self._tell_estimates(targets, record)
        return sends

    def _ask_streams(self, vehicle_id: int, vehicle: _Vehicle, now: int) -> list[SendFrame]:
        sends: list[SendFrame] = []
        for stream in self.settings.streams:
            asked = vehicle.streams.setdefault(stream.message_id, _Asked())
            if len(sends) >= _REQUESTS_PER_TICK:
                break
            if self._is_due(asked, stream, now):
                self._repeat_later(asked, now)
                request = encode.set_message_interval(
                    vehicle_id, AUTOPILOT_COMPONENT, stream.message_id, round(1e6 / stream.rate_hz)
                )
                sends.append(self._send(vehicle_id, request))
        return sends

    def _is_due(self, asked: _Asked, stream: StreamRequest, now: int) -> bool:
        if asked.attempts == 0:
            return True
        if asked.heard_ns is not None and now - asked.heard_ns <= _ns(max(3.0 / stream.rate_hz, 2.0)):
            asked.attempts = 1
            return False
        if stream.optional and asked.attempts >= self.settings.optional_attempts:
            return False
        return now >= asked.next_ns

    def _repeat_later(self, asked: _Asked, now: int) -> None:
        wait_s = min(
            self.settings.request_retry_s * 2.0 ** min(asked.attempts, 16), self.settings.request_retry_max_s
        )
        asked.attempts += 1
        asked.next_ns = now + _ns(wait_s)

    def _ask_home(self, vehicle_id: int, vehicle: _Vehicle, now: int) -> list[SendFrame]:
        home = vehicle.home
        if home.heard_ns is not None and home.attempts > 0:
            if now - home.heard_ns < _ns(self.settings.home_refresh_s):
                return []
            home.heard_ns, home.attempts, home.next_ns = None, 0, 0
        if now < home.next_ns:
            return []
        self._repeat_later(home, now)
        request = encode.command_long(
            vehicle_id, AUTOPILOT_COMPONENT, _MAV_CMD_REQUEST_MESSAGE, (float(_HOME_POSITION),)
        )
        return [self._send(vehicle_id, request)]

    def _ask_time(self, vehicle_id: int, vehicle: _Vehicle, now: int) -> list[SendFrame]:
        asked = vehicle.timesync
        if now < asked.next_ns:
            return []
        asked.attempts += 1
        asked.next_ns = now + _ns(1.0 if asked.attempts < _FAST_TIMESYNCS else self.settings.timesync_s)
        # It names no component: autopilot and sensor each have a clock and each answer.
        return [self._send(vehicle_id, encode.timesync_request(now))]

    def _ask_captures(self, now: int) -> list[SendFrame]:
        active: dict[str, list[tuple[int, int]]] = {}
        for key in sorted(self._links):
            vehicle = self._vehicles.get(key[0])
            if now - self._links[key].heard_ns > _ns(self.settings.link_active_s):
                del self._links[key]
            elif vehicle is not None and vehicle.state.connections:
                active.setdefault(vehicle.state.connections[0], []).append(key)
        sends = []
        for connection, keys in active.items():
            interval_ms = self._capture_interval_ms(connection, len(keys))
            captures = min(self.settings.cir_captures, 255)
            for key in keys:
                if now < self._links[key].next_ns:
                    continue
                self._links[key].next_ns = now + round(_RENEW_AT * captures * interval_ms * 1e6)
                request = encode.cir_request(
                    key[0],
                    SENSOR_COMPONENT,
                    key[1],
                    captures=captures,
                    interval_ms=interval_ms,
                    tap_count=self.settings.cir_taps,
                )
                sends.append(self._send(key[0], request))
        return sends

    def _capture_interval_ms(self, connection: str, links: int) -> int:
        """Interval at which all links of a connection together stay within its budget."""
        taps = self.settings.cir_taps or 64
        size = taps + _CIR_OVERHEAD_BYTES * -(-taps // _CIR_DATA_BYTES)
        serial = connection.startswith("serial")
        budget = (
            self.settings.cir_budget_serial_bytes_s if serial else self.settings.cir_budget_network_bytes_s
        )
        return min(max(self.settings.cir_interval_ms, -(-links * size * 1000 // round(budget))), 65_535)

    def _tell_estimates(self, targets: Iterable[TargetState], record: Record) -> list[SendFrame]:
        sends = []
        for target in targets:
            if record.time_ns >= self._estimates_ns.get(target.beacon_id, 0):
                self._estimates_ns[target.beacon_id] = record.time_ns + _ns(self.settings.estimate_s)
                sends.append(self._send(None, encode.target_estimate(target, record.unix_us)))
        return sends

    def _send(self, vehicle_id: int | None, message: Any) -> SendFrame:
        return SendFrame(vehicle_id, self._encoder.pack(message))


_MAV_CMD_REQUEST_MESSAGE = 512


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
