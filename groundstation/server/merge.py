"""Two deltas in a row as one: how a slow client catches up without losing an event.

Rule: the merged delta leaves a page in the state that both in turn would; rows are
coalesced per key, events are joined.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import TypeVar

from groundstation.server import wire

_Row = TypeVar("_Row", bound=wire.Model)


def merge(first: wire.Delta, second: wire.Delta) -> wire.Delta:
    """``first`` then ``second``. They must follow each other (``second.previous_seq == first.seq``)."""
    gone = {(item.kind, item.key) for item in second.removed}

    def newest(
        old: Sequence[_Row], new: Sequence[_Row], kind: str, key: Callable[[_Row], Hashable]
    ) -> list[_Row]:
        by_key = {key(row): row for row in old if (kind, str(key(row))) not in gone}
        by_key.update((key(row), row) for row in new)
        return list(by_key.values())

    a, b = first.rows, second.rows
    removed = {(item.kind, item.key): item for item in (*first.removed, *second.removed)}
    return wire.Delta(
        type="delta",
        schema_version=wire.SCHEMA_VERSION,
        epoch=second.epoch,
        seq=second.seq,
        previous_seq=first.previous_seq,
        server_time_ns=second.server_time_ns,
        rows=wire.Rows(
            vehicles=newest(a.vehicles, b.vehicles, "vehicle", lambda row: row.vehicle_id),
            links=newest(a.links, b.links, "link", lambda row: f"{row.vehicle_id}:{row.beacon_id}"),
            targets=newest(a.targets, b.targets, "target", lambda row: row.beacon_id),
            regions=newest(a.regions, b.regions, "regions", lambda row: row.beacon_id),
            explanations=newest(a.explanations, b.explanations, "explanation", lambda row: row.beacon_id),
            proposals=newest(a.proposals, b.proposals, "proposal", lambda row: row.proposal_id),
            commands=newest(a.commands, b.commands, "command", lambda row: row.command_id),
            connections=newest(a.connections, b.connections, "connection", lambda row: row.connection),
            counters=newest(
                a.counters, b.counters, "counter", lambda row: (row.name, tuple(sorted(row.labels.items())))
            ),
            forwards=a.forwards if b.forwards is None else b.forwards,
            mission=a.mission if b.mission is None else b.mission,
            station=a.station if b.station is None else b.station,
        ),
        removed=list(removed.values()),
        events=[*first.events, *second.events],
    )
