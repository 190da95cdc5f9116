"""Frames to windows: the first engine.

Decides whose frame it is and hands it to that vehicle's intake. A vehicle is a system whose
component 1 sends a heartbeat of an autopilot; ground stations, radios and cameras are not, and
radio samples of a system that never showed an autopilot are counted and told.

Rule: every frame handed in is counted under exactly one of ``frame_out_total``,
``frame_malformed_total``, ``frame_not_vehicle_total``, ``frame_unknown_system_total``,
``frame_duplicate_total``, ``frame_unused_total`` and ``frame_used_total``.
"""

from __future__ import annotations

from typing import Any

from groundstation.domain.errors import PeerError
from groundstation.domain.events import Counter, Event, Severity
from groundstation.domain.inputs import Direction, FrameInput, Record, SessionInput, TickInput
from groundstation.domain.radio import Listening
from groundstation.domain.vehicle import AUTOPILOT_COMPONENT
from groundstation.engine.vehicle_intake import IngestOutput, VehicleIntake
from groundstation.mavlink.decode import decode
from groundstation.mavlink.framing import Frame, frame_of
from groundstation.mavlink.messages import AoaSample, CirFragment, Heartbeat, LinkStateReport, RssSample
from groundstation.mavlink.vehicle_message import VehicleMessage
from groundstation.measurement.settings import MeasurementSettings
from groundstation.measurement.tally import Tally
from groundstation.measurement.vehicle_picture import is_vehicle

__all__ = ["Ingest", "IngestOutput", "VehicleMessage"]

_HEARTBEAT_ID = 0
_TUNNEL_ID = 385
_SAR_IDS = frozenset({20800, 20801, 20802, 20803, _TUNNEL_ID})
_RECENT_FRAMES = 128
_HOT = ("frame_out", "frame_not_vehicle", "frame_duplicate", "frame_unused", "frame_used")


class _Recent:
    """Frames of one system heard lately, by their bytes: the same frame by two radios counts once."""

    __slots__ = ("connections", "frames")

    def __init__(self) -> None:
        self.connections: dict[str, None] = {}
        self.frames: dict[bytes, int] = {}

    def seen(self, frame: Frame, connection: str, now_ns: int, within_ns: int) -> bool:
        """Whether it came before; remembers it. Costs nothing for a system on one connection."""
        connections = self.connections
        if len(connections) < 2:
            connections[connection] = None
        if len(connections) == 1:
            return False
        frames = self.frames
        raw = frame.raw
        heard_ns = frames.get(raw)
        if heard_ns is not None and now_ns - heard_ns < within_ns:
            return True
        frames.pop(raw, None)
        frames[raw] = now_ns
        if len(frames) > _RECENT_FRAMES:
            del frames[next(iter(frames))]
        return False


class Ingest:
    """State machine over the journal's records: ``handle(record)`` gives what came of it."""

    def __init__(self, settings: MeasurementSettings | None = None) -> None:
        self.settings = settings if settings is not None else MeasurementSettings()
        self._tally = Tally()
        self._vehicles: dict[int, VehicleIntake] = {}
        self._recent: dict[int, _Recent] = {}
        self._beacons: dict[int, int] = {}
        self._strangers: dict[int, list[Any]] = {}
        self._counts = dict.fromkeys(_HOT, 0)
        self._duplicate_ns = round(self.settings.duplicate_s * 1e9)
        self._stranger_ns = round(self.settings.unknown_system_s * 1e9)
        self._listening_ns = max(round(self.settings.listening_interval_s * 1e9), 1)
        self._listening_since_ns: int | None = None

    def handle(self, record: Record) -> list[IngestOutput]:
        """What follows from one record, in order. Records that are not for ingest give nothing."""
        item = record.input
        out: list[IngestOutput] = []
        if isinstance(item, FrameInput):
            self._frame(item, record.time_ns, out)
        elif isinstance(item, TickInput):
            self._tick(record.time_ns, out)
        elif isinstance(item, SessionInput):
            self._session(item.event, record.time_ns, out)
        return out

    @property
    def vehicle_ids(self) -> list[int]:
        """Vehicles found, in the order they were."""
        return list(self._vehicles)

    def counters(self) -> list[Counter]:
        """Every frame, drop and rejection so far."""
        hot = [Counter(f"{name}_total", (), value) for name, value in self._counts.items()]
        texts: list[Counter] = []
        for vehicle_id, vehicle in self._vehicles.items():
            label = (("vehicle", str(vehicle_id)),)
            texts.append(Counter("status_text_repeated_total", label, vehicle.texts.repeated))
            texts.append(Counter("status_text_informational_total", label, vehicle.texts.informational))
        return hot + texts + self._tally.counters()

    def _frame(self, item: FrameInput, now_ns: int, out: list[IngestOutput]) -> None:
        counts = self._counts
        if item.direction is Direction.OUT:
            counts["frame_out"] += 1
            return
        try:
            frame = frame_of(item.frame)
        except PeerError:
            self._tally.add("frame_malformed_total")
            return
        system_id = frame.system_id
        vehicle = self._vehicles.get(system_id)
        if vehicle is None:
            vehicle = self._introduce(frame, now_ns, out)
            if vehicle is None:
                return
        if self._recent[system_id].seen(frame, item.connection, now_ns, self._duplicate_ns):
            counts["frame_duplicate"] += 1
            return
        vehicle.loss.observe(frame.component_id, frame.sequence, now_ns)
        message = decode(frame)
        if message is None:
            counts["frame_unused"] += 1
            return
        counts["frame_used"] += 1
        if frame.message_id in _SAR_IDS and isinstance(
            message, (RssSample, AoaSample, CirFragment, LinkStateReport)
        ):
            beacon_id = message.beacon_id
            if beacon_id not in self._beacons:
                self._beacon_found(beacon_id, system_id, now_ns, out)
        vehicle.message(frame.component_id, item.connection, message, now_ns, out)

    def _introduce(self, frame: Frame, now_ns: int, out: list[IngestOutput]) -> VehicleIntake | None:
        """The vehicle that this frame makes known; None (counted) where it makes none."""
        system_id = frame.system_id
        if frame.message_id == _HEARTBEAT_ID and frame.component_id == AUTOPILOT_COMPONENT and system_id:
            heartbeat = decode(frame)
            if isinstance(heartbeat, Heartbeat) and is_vehicle(heartbeat):
                if len(self._vehicles) >= self.settings.vehicles:
                    self._tally.add("vehicle_overflow_total")
                    return None
                vehicle = self._vehicles[system_id] = VehicleIntake(
                    self.settings, system_id, self._tally, now_ns
                )
                self._recent[system_id] = _Recent()
                self._strangers.pop(system_id, None)
                text = f"vehicle {system_id} found"
                out.append(Event(now_ns, "vehicle.found", Severity.INFO, text, vehicle_id=system_id))
                return vehicle
        if frame.message_id in _SAR_IDS:
            self._tally.add("frame_unknown_system_total", f"system={system_id}")
            stranger = self._strangers.setdefault(system_id, [now_ns, False])
            if not stranger[1] and now_ns - stranger[0] >= self._stranger_ns:
                stranger[1] = True
                text = (
                    f"radio samples of system {system_id} are dropped: no heartbeat of an autopilot"
                    f" (component {AUTOPILOT_COMPONENT}) came from it"
                )
                out.append(Event(now_ns, "vehicle.unknown", Severity.WARNING, text, vehicle_id=system_id))
        else:
            self._counts["frame_not_vehicle"] += 1
        return None

    def _beacon_found(self, beacon_id: int, vehicle_id: int, now_ns: int, out: list[IngestOutput]) -> None:
        if len(self._beacons) >= self.settings.links_per_vehicle:
            # Its links will be counted as overflow where they would begin.
            return
        self._beacons[beacon_id] = now_ns
        text = f"beacon {beacon_id} is heard, first by vehicle {vehicle_id}"
        out.append(Event(now_ns, "beacon.found", Severity.INFO, text, vehicle_id, beacon_id))

    def _tick(self, now_ns: int, out: list[IngestOutput]) -> None:
        for vehicle in self._vehicles.values():
            vehicle.tick(now_ns, out)
        self._listen(now_ns, out)

    def _listen(self, now_ns: int, out: list[IngestOutput]) -> None:
        """Who listened where, once an interval; those end at whole multiples of their length."""
        since_ns = self._listening_since_ns
        if since_ns is None:
            self._listening_since_ns = now_ns
        elif now_ns // self._listening_ns > since_ns // self._listening_ns:
            self._listening_since_ns = now_ns
            found = [vehicle.listened(since_ns, now_ns) for vehicle in self._vehicles.values()]
            listeners = tuple(listener for listener in found if listener is not None)
            # After a gap (a stop, a cut recording) no pose covers its middle: nobody listened.
            if listeners:
                out.append(Listening(since_ns, now_ns, listeners))

    def _session(self, event: str, now_ns: int, out: list[IngestOutput]) -> None:
        if event == "resumed":
            for vehicle in self._vehicles.values():
                vehicle.forget_stream(now_ns)
            for recent in self._recent.values():
                recent.frames.clear()
                recent.connections.clear()
            self._strangers.clear()
            self._listening_since_ns = None
        elif event == "ended":
            for vehicle in self._vehicles.values():
                vehicle.end(now_ns, out)

    def state(self) -> dict[str, Any]:
        """Everything, as a tree: dicts with string keys, lists, numbers, strings, bytes, arrays."""
        return {
            "version": 1,
            "tally": self._tally.state(),
            "counts": dict(self._counts),
            "vehicles": [[vehicle_id, vehicle.state()] for vehicle_id, vehicle in self._vehicles.items()],
            "recent": [
                [system_id, list(recent.connections), [list(item) for item in recent.frames.items()]]
                for system_id, recent in self._recent.items()
            ],
            "beacons": [list(item) for item in self._beacons.items()],
            "listening_since_ns": self._listening_since_ns,
            "strangers": [[system_id, *kept] for system_id, kept in self._strangers.items()],
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state()`` gave: what follows is the same to the bit."""
        self._tally.restore(tree["tally"])
        self._counts = dict(tree["counts"])
        self._vehicles = {}
        for vehicle_id, kept in tree["vehicles"]:
            vehicle = self._vehicles[vehicle_id] = VehicleIntake(self.settings, vehicle_id, self._tally, 0)
            vehicle.restore(kept)
        self._recent = {}
        for system_id, connections, frames in tree["recent"]:
            recent = self._recent[system_id] = _Recent()
            recent.connections = dict.fromkeys(connections)
            recent.frames = dict(frames)
        self._beacons = dict(tree["beacons"])
        self._listening_since_ns = tree.get("listening_since_ns")
        self._strangers = {system_id: [since_ns, told] for system_id, since_ns, told in tree["strangers"]}
