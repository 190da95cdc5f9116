"""A typed message with where and when it was heard.

It lives here because the engines hand it to the command desk and neither may import the
other.
"""

from __future__ import annotations

from dataclasses import dataclass

from groundstation.mavlink.messages import Message


@dataclass(frozen=True, slots=True)
class VehicleMessage:
    """One message of a vehicle, as the command desk needs it."""

    vehicle_id: int
    """MAVLink system id."""
    component_id: int
    """MAVLink component id of the sender."""
    connection: str
    """Name of the connection it arrived on."""
    time_ns: int
    """Station time of its arrival."""
    message: Message
