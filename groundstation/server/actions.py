"""The seam towards the station: what an operator may do, and what the server may ask.

Rule: the server never touches the desk; whoever wires the station implements this.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from groundstation.domain.events import Event
from groundstation.server.rest import HealthCheck, SearchMap


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


EventSource = Callable[[int, int], Awaitable[Sequence[Event]]]
"""(before_ns, limit) → the newest ``limit`` events before that time, oldest first."""


@dataclass(frozen=True, slots=True)
class Sources:
    """What other rooms know and the picture does not keep. All optional."""

    older_events: EventSource | None = None
    """The database."""
    search_map: Callable[[int], SearchMap | None] | None = None
    """The tracker's raster of one beacon."""
    health: Callable[[], Sequence[HealthCheck]] | None = None
    """Checks of the other rooms."""
    version: str = field(default="0")
    """Of the ground station."""
