"""What the page may ask for that its picture does not keep: the database, the disk, the exporters.

Rule: a question to the database is asked on a thread; the event loop never waits for a disk.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from groundstation import __version__
from groundstation.domain.events import Event
from groundstation.export import search_map_archive
from groundstation.server.actions import Sources
from groundstation.server.rest import HealthCheck, HistoryPoint
from groundstation.store.queries import TargetPoint
from groundstation.store.session import Session


def session_sources(session: Session) -> Sources:
    """Of a live session."""

    def health() -> list[HealthCheck]:
        return [HealthCheck(name=name, ok=False, detail=why) for name, why in session.health().items()]

    async def older_events(before_ns: int, limit: int) -> Sequence[Event]:
        return await asyncio.to_thread(session.database.reader.events_before, before_ns, limit)

    async def history(beacon_id: int, since_ns: int, limit: int) -> Sequence[HistoryPoint]:
        curve = session.database.reader.target_curve
        return [_point_row(point) for point in await asyncio.to_thread(curve, beacon_id, since_ns, limit)]

    return Sources(
        older_events=older_events,
        history=history,
        search_map_file=search_map_archive,
        health=health,
        version=__version__,
    )


def _point_row(point: TargetPoint) -> HistoryPoint:
    return HistoryPoint(
        time_ns=str(point.time_ns),
        latitude_deg=point.latitude_deg,
        longitude_deg=point.longitude_deg,
        altitude_amsl_m=point.altitude_amsl_m,
        radius_90_m=point.radius_90_m,
        windows=point.windows,
        links=point.links,
    )
