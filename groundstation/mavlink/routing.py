"""Which way leads to whom: learned from the frames that were heard, as mavlink-router documents it.

A frame without a target, or with target system 0, goes everywhere; a targeted one only where its
(system, component) was heard last, and component 0 stands for any of that system's; nothing goes
back where it came from. What is targeted at somebody never heard goes nowhere.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass

from groundstation.mavlink.catalogue import CATALOGUE
from groundstation.mavlink.framing import MAGIC_V2, Frame

MAX_ROUTES = 2048
"""(system, component) pairs remembered; the one heard longest ago goes first."""


@dataclass(frozen=True, slots=True)
class Target:
    """Whom a frame is for."""

    system_id: int
    component_id: int
    """0: every component of the system."""


@dataclass(frozen=True, slots=True)
class Route:
    """Where somebody was heard last."""

    connection: str
    address: Hashable
    """Of the peer, in the connection's own terms; None where a connection has one peer only."""
    heard_ns: int


def target_of(raw: bytes) -> Target | None:
    """Whom a verified frame is for; None: everyone (no target fields, or target system 0)."""
    if raw[0] == MAGIC_V2:
        message_id, offset, length = raw[7] | raw[8] << 8 | raw[9] << 16, 10, raw[1]
    else:
        message_id, offset, length = raw[5], 6, raw[1]
    info = CATALOGUE.get(message_id)
    if info is None or info.target_system_offset is None:
        return None
    # What lies beyond the payload was zero and has been cut.
    at = info.target_system_offset
    system_id = raw[offset + at] if at < length else 0
    if not system_id:
        return None
    at = info.target_component_offset if info.target_component_offset is not None else length
    return Target(system_id, raw[offset + at] if at < length else 0)


class RoutingTable:
    """Who was heard where. Bounded; time comes in as an argument."""

    def __init__(self) -> None:
        self._routes: OrderedDict[tuple[int, int], Route] = OrderedDict()
        """Heard longest ago first."""
        self.evicted = 0
        """Entries that had to go because the table was full."""

    def __len__(self) -> int:
        return len(self._routes)

    def learn(self, frame: Frame, connection: str, address: Hashable, now_ns: int) -> None:
        """Notes that ``frame``'s sender was heard by ``connection`` from ``address``."""
        key = (frame.system_id, frame.component_id)
        if key not in self._routes and len(self._routes) >= MAX_ROUTES:
            self._routes.popitem(last=False)
            self.evicted += 1
        self._routes[key] = Route(connection, address, now_ns)
        self._routes.move_to_end(key)

    def forget(self, connection: str) -> None:
        """Drops all that was heard by a connection that is closed."""
        for key in [key for key, route in self._routes.items() if route.connection == connection]:
            del self._routes[key]

    def route(self, target: Target) -> Route | None:
        """Where ``target`` was heard last: one way, even where two radios hear it."""
        if target.component_id:
            return self._routes.get((target.system_id, target.component_id))
        for (system_id, _component_id), route in reversed(self._routes.items()):
            if system_id == target.system_id:
                return route
        return None

    def heard(self) -> dict[tuple[int, int], Route]:
        """All entries, by (system, component)."""
        return {key: self._routes[key] for key in sorted(self._routes)}
