"""What the operator sees, as pure state: outputs of the engines in, rows and deltas out.

Rule: state is coalesced per key, events never are. Each delta has a number (``seq``) that
grows by one within the ``epoch`` that the session gives; a bounded ring of deltas lets a
page that lost its connection for a moment go on where it was.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

from groundstation.domain.command import CommandStatus, Proposal, ProposalGone
from groundstation.domain.errors import InternalError
from groundstation.domain.events import Counter, Event
from groundstation.domain.geometry import Geodetic
from groundstation.domain.inputs import ConnectionInput, MissionInput
from groundstation.domain.mission import Mission
from groundstation.domain.radio import LinkActivity
from groundstation.domain.target import (
    LinkVerdict,
    SearchMap,
    TargetExplanation,
    TargetJoined,
    TargetState,
    TargetWaiting,
)
from groundstation.domain.vehicle import VehicleState
from groundstation.server import rows, target_rows, wire
from groundstation.server.history import Histories
from groundstation.server.merge import merge
from groundstation.server.rows import ForwardStatus, StationStatus
from groundstation.server.settings import ServerSettings
from groundstation.server.table import Table

PictureInput = (
    VehicleState
    | LinkActivity
    | LinkVerdict
    | TargetState
    | TargetWaiting
    | TargetJoined
    | TargetExplanation
    | SearchMap
    | Proposal
    | ProposalGone
    | CommandStatus
    | Event
    | Counter
    | ConnectionInput
    | Mission
    | MissionInput
    | ForwardStatus
    | StationStatus
)

_METRES_PER_DEGREE = 111_320.0


@dataclass(frozen=True, slots=True)
class _Link:
    activity: LinkActivity | None
    verdict: LinkVerdict | None


class Picture:
    """The newest row of everything, and the deltas between."""

    def __init__(self, epoch: str, settings: ServerSettings | None = None) -> None:
        """``epoch`` names this run of the server: letters, digits, ``-``, ``_`` and ``.``."""
        self.settings = settings or ServerSettings()
        self.epoch = epoch
        self.seq = 0
        self.newest_time_ns = 0
        limits = self.settings
        self.vehicles: Table[int, VehicleState, wire.VehicleRow] = Table(
            "vehicle", limits.max_vehicles, lambda _key, state: rows.vehicle_row(state)
        )
        self.links: Table[tuple[int, int], _Link, wire.LinkRow] = Table(
            "link",
            limits.max_links,
            lambda key, link: rows.link_row(key[0], key[1], link.activity, link.verdict),
            lambda key: f"{key[0]}:{key[1]}",
        )
        self.targets: Table[int, TargetState | TargetWaiting | TargetJoined, wire.TargetRow] = Table(
            "target", limits.max_targets, lambda _key, state: target_rows.target_row(state)
        )
        # Of each beacon the newest state that had regions: most updates come without.
        self.regions: Table[int, TargetState, wire.RegionsRow] = Table(
            "regions", limits.max_targets, lambda _key, state: target_rows.regions_row(state)
        )
        self.explanations: Table[int, TargetExplanation, wire.ExplanationRow] = Table(
            "explanation", limits.max_targets, lambda _key, told: target_rows.explanation_row(told)
        )
        # Asked for by those who look at them: never part of the stream.
        self.search_maps: dict[int, SearchMap] = {}
        self.histories = Histories(limits.max_targets, limits.history_points)
        self.proposals: Table[str, Proposal, wire.ProposalRow] = Table(
            "proposal", limits.max_proposals, lambda _key, proposal: rows.proposal_row(proposal)
        )
        self.commands: Table[str, CommandStatus, wire.CommandRow] = Table(
            "command", limits.max_commands, lambda _key, status: rows.command_row(status)
        )
        self.connections: Table[str, tuple[ConnectionInput, int], wire.ConnectionRow] = Table(
            "connection", limits.max_connections, lambda _key, value: rows.connection_row(*value)
        )
        self.counters: dict[tuple[str, tuple[tuple[str, str], ...]], Counter] = {}
        self.counters_refused_total = 0
        self._counters_changed: dict[tuple[str, tuple[tuple[str, str], ...]], None] = {}
        self._forwards: dict[str, ForwardStatus] = {}
        self._forwards_changed = False
        self._mission: Mission | None = None
        self._mission_changed = False
        self._station: StationStatus | None = None
        self._station_changed = False
        self.events: deque[wire.EventRow] = deque(maxlen=limits.events_in_memory)
        self.events_total = 0
        self._events_new = 0
        self.events_unsent_total = 0
        self._trails: dict[int, deque[tuple[float, float]]] = {}
        self._ring: deque[wire.Delta] = deque(maxlen=limits.ring_deltas)

    def apply(self, output: PictureInput, time_ns: int | None = None) -> None:
        """Take in one output. ``time_ns`` is needed for values that carry no time of their own.

        Raises InternalError for a value that is not for the picture.
        """
        own_time_ns = getattr(output, "time_ns", None) if time_ns is None else time_ns
        if own_time_ns is not None:
            self.newest_time_ns = max(self.newest_time_ns, own_time_ns)
        match output:
            case LinkActivity() | LinkVerdict():
                self._apply_link(output)
            case VehicleState():
                self.vehicles.put(output.vehicle_id, output)
                if output.position is not None and output.position.is_valid():
                    self._extend_trail(output.vehicle_id, output.position)
            case TargetState() | TargetWaiting() | TargetJoined():
                self._apply_target(output)
            case TargetExplanation() if isinstance(self.targets.get(output.beacon_id), TargetState):
                self.explanations.put(output.beacon_id, output)
            case SearchMap() if isinstance(self.targets.get(output.beacon_id), TargetState):
                self.search_maps[output.beacon_id] = output
            case TargetExplanation() | SearchMap():
                pass  # of a beacon that gave way to others
            case Proposal():
                self.proposals.put(output.proposal_id, output)
            case ProposalGone():
                self.proposals.remove(output.proposal_id, output.reason)
            case CommandStatus():
                self.commands.put(output.command_id, output)
            case Event():
                self._apply_event(output)
            case Counter():
                self._apply_counter(output)
            case ConnectionInput():
                self.connections.put(output.connection, (output, own_time_ns or self.newest_time_ns))
            case Mission():
                self._mission, self._mission_changed = output, True
            case MissionInput():
                self._mission, self._mission_changed = output.mission, True
            case ForwardStatus():
                self._forwards[output.url] = output
                self._forwards_changed = True
            case StationStatus():
                self._station, self._station_changed = output, True
            case _:
                raise InternalError(f"the picture has no place for a {type(output).__name__}; please report")

    def _apply_link(self, output: LinkActivity | LinkVerdict) -> None:
        key = (output.vehicle_id, output.beacon_id)
        link = self.links.get(key) or _Link(None, None)
        if isinstance(output, LinkActivity):
            self.links.put(key, _Link(output, link.verdict))
        else:
            self.links.put(key, _Link(link.activity, output))

    def _apply_target(self, output: TargetState | TargetWaiting | TargetJoined) -> None:
        evicted = self.targets.put(output.beacon_id, output)
        if evicted is not None:
            self._forget_estimate(evicted, "evicted: too many rows")
        if not isinstance(output, TargetState):
            self._forget_estimate(output.beacon_id, "no estimate")
            return
        self.histories.add(output)
        if output.regions:
            known = self.regions.get(output.beacon_id)
            if known is None or known.regions != output.regions:
                self.regions.put(output.beacon_id, output)

    def _forget_estimate(self, beacon_id: int, reason: str) -> None:
        """What belongs to an estimate goes with it; how it came about stays."""
        self.regions.remove(beacon_id, reason)
        self.explanations.remove(beacon_id, reason)
        self.search_maps.pop(beacon_id, None)

    def _apply_event(self, event: Event) -> None:
        self.events_total += 1
        row = rows.event_row(event, self.events_total)
        self.events.append(row)
        self._events_new += 1
        if self._events_new > self.settings.events_in_memory:
            # Nobody publishes (a headless run), or thousands came at once.
            self._events_new -= 1
            self.events_unsent_total += 1

    def _apply_counter(self, counter: Counter) -> None:
        key = (counter.name, counter.labels)
        if key not in self.counters and len(self.counters) >= self.settings.max_counters:
            self.counters_refused_total += 1
        elif self.counters.get(key) != counter:
            self.counters[key] = counter
            self._counters_changed[key] = None

    def _extend_trail(self, vehicle_id: int, position: Geodetic) -> None:
        trail = self._trails.setdefault(vehicle_id, deque(maxlen=self.settings.trail_points))
        if trail:
            longitude, latitude = trail[-1]
            north = (position.latitude_deg - latitude) * _METRES_PER_DEGREE
            east = (
                (position.longitude_deg - longitude)
                * _METRES_PER_DEGREE
                * math.cos(math.radians(position.latitude_deg))
            )
            if math.hypot(north, east) < self.settings.trail_spacing_m:
                return
        trail.append((float(position.longitude_deg), float(position.latitude_deg)))

    @property
    def dirty(self) -> bool:
        """Whether something changed since the last delta."""
        return bool(
            self._events_new
            or self._counters_changed
            or self._forwards_changed
            or self._mission_changed
            or self._station_changed
            or any(table.dirty for table in self._tables())
        )

    def _tables(self) -> tuple[Table[Any, Any, Any], ...]:
        return (
            self.vehicles, self.links, self.targets, self.regions, self.explanations,
            self.proposals, self.commands, self.connections,
        )  # fmt: skip

    def take_delta(self, server_time_ns: int) -> wire.Delta | None:
        """What changed since the last call, numbered and kept in the ring; None if nothing did."""
        if not self.dirty:
            return None
        removed = [item for table in self._tables() for item in table.take_removed()]
        self._drop_trails(removed)
        delta = wire.Delta(
            type="delta",
            schema_version=wire.SCHEMA_VERSION,
            epoch=self.epoch,
            seq=self.seq + 1,
            previous_seq=self.seq,
            server_time_ns=str(server_time_ns),
            rows=wire.Rows(
                vehicles=self.vehicles.take_changed(),
                links=self.links.take_changed(),
                targets=self.targets.take_changed(),
                regions=self.regions.take_changed(),
                explanations=self.explanations.take_changed(),
                proposals=self.proposals.take_changed(),
                commands=self.commands.take_changed(),
                connections=self.connections.take_changed(),
                counters=[rows.counter_row(self.counters[key]) for key in self._counters_changed],
                forwards=self.forward_rows() if self._forwards_changed else None,
                mission=self.mission_row() if self._mission_changed else None,
                station=rows.station_row(self._station) if self._station_changed and self._station else None,
            ),
            removed=removed,
            events=list(self.events)[len(self.events) - self._events_new :],
        )
        self._counters_changed.clear()
        self._forwards_changed = self._mission_changed = self._station_changed = False
        self._events_new = 0
        self.seq += 1
        self._ring.append(delta)
        return delta

    def _drop_trails(self, removed: list[wire.Removed]) -> None:
        for item in removed:
            if item.kind == "vehicle":
                self._trails.pop(int(item.key), None)

    def snapshot(self, server_time_ns: int) -> wire.Snapshot:
        """The whole picture as of delta ``seq``.

        Call ``take_delta`` first, or the next delta repeats what the snapshot already says.
        """
        first_event = max(0, len(self.events) - self.settings.snapshot_events)
        return wire.Snapshot(
            type="snapshot",
            schema_version=wire.SCHEMA_VERSION,
            epoch=self.epoch,
            seq=self.seq,
            server_time_ns=str(server_time_ns),
            rows=wire.Rows(
                vehicles=self.vehicle_rows(),
                links=self.link_rows(),
                targets=self.target_rows(),
                regions=self.regions.rows(),
                explanations=self.explanations.rows(),
                proposals=self.proposals.rows(),
                commands=self.commands.rows(),
                connections=self.connections.rows(),
                counters=[rows.counter_row(counter) for counter in self.counters.values()],
                forwards=self.forward_rows(),
                mission=self.mission_row(),
                station=rows.station_row(self._station) if self._station else None,
            ),
            trails=[
                wire.Trail(vehicle_id=vehicle_id, points_deg=[list(point) for point in points])
                for vehicle_id, points in sorted(self._trails.items())
            ],
            events=list(self.events)[first_event:],
        )

    def heartbeat(self, server_time_ns: int) -> wire.Heartbeat:
        """A sign of life."""
        return wire.Heartbeat(
            type="heartbeat",
            schema_version=wire.SCHEMA_VERSION,
            epoch=self.epoch,
            seq=self.seq,
            server_time_ns=str(server_time_ns),
        )

    def since(self, epoch: str, seq: int) -> list[wire.Delta] | None:
        """Deltas after ``seq``, merged to one at most; None when they are not all there any more."""
        if epoch != self.epoch or seq > self.seq or seq < 0:
            return None
        if seq == self.seq:
            return []
        if not self._ring or self._ring[0].previous_seq > seq:
            return None
        missed = [delta for delta in self._ring if delta.seq > seq]
        merged = missed[0]
        for delta in missed[1:]:
            merged = merge(merged, delta)
        return [merged]

    def vehicle_rows(self) -> list[wire.VehicleRow]:
        """In order of vehicle id."""
        return sorted(self.vehicles.rows(), key=lambda row: row.vehicle_id)

    def link_rows(self) -> list[wire.LinkRow]:
        """In order of vehicle and beacon."""
        return sorted(self.links.rows(), key=lambda row: (row.vehicle_id, int(row.beacon_id)))

    def target_rows(self) -> list[wire.TargetRow]:
        """In order of beacon id."""
        return sorted(self.targets.rows(), key=lambda row: int(row.beacon_id))

    def forward_rows(self) -> list[wire.ForwardRow]:
        """In order of URL."""
        return [rows.forward_row(self._forwards[url]) for url in sorted(self._forwards)]

    def mission_row(self) -> wire.MissionRow | None:
        """The mission, if one was set."""
        return rows.mission_row(self._mission) if self._mission else None
