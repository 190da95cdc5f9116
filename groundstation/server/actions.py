"""The seam towards the station: what an operator may do, and what the server may ask.

Rule: the server never touches the desk; whoever wires the station implements this.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from groundstation.domain.events import Event
from groundstation.domain.target import SearchMap
from groundstation.server.rest import HealthCheck, HistoryPoint


@dataclass(frozen=True, slots=True)
class ActionResult:
    """What became of an operator's action."""

    accepted: bool
    """False: nothing will be sent, and ``text`` says why."""
    text: str
    """One line for the operator."""
    command_ids: tuple[str, ...] = ()
    """Commands that it started, if they are known yet."""


class Actions(Protocol):
    """An operator's actions. ``who`` says who acted, for the journal."""

    async def confirm(self, proposal_id: str, vehicle_id: int, who: str) -> ActionResult:
        """Fly the proposal with this vehicle."""
        ...

    async def dismiss(self, proposal_id: str, who: str) -> ActionResult:
        """Drop the proposal."""
        ...

    async def hold(self, vehicle_id: int, who: str) -> ActionResult:
        """Hold one vehicle now."""
        ...

    async def hold_all(self, who: str) -> ActionResult:
        """Hold every vehicle now."""
        ...

    async def join(self, beacon_id: int, into_beacon_id: int, who: str) -> ActionResult:
        """Take two ids for one transmitter: what the first one said counts for the second."""
        ...

    async def separate(self, beacon_id: int, who: str) -> ActionResult:
        """Take a join back: the beacon stands for itself again."""
        ...


EventSource = Callable[[int, int], Awaitable[Sequence[Event]]]
"""(before_ns, limit) → the newest ``limit`` events before that time, oldest first."""

HistorySource = Callable[[int, int, int], Awaitable[Sequence[HistoryPoint]]]
"""(beacon_id, since_ns, limit) → at most ``limit`` beliefs after that time, evenly, oldest first."""


@dataclass(frozen=True, slots=True)
class Sources:
    """What other rooms know and the picture does not keep. All optional."""

    older_events: EventSource | None = None
    """The database."""
    history: HistorySource | None = None
    """The database; without it the picture's own few points are given."""
    search_map_file: Callable[[SearchMap], bytes] | None = None
    """The raster as a ZIP archive that a GIS opens."""
    health: Callable[[], Sequence[HealthCheck]] | None = None
    """Checks of the other rooms."""
    version: str = field(default="0")
    """Of the ground station."""
