"""What may be set about connections; the defaults suit radios in the field."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ConnectionSettings:
    """Limits and waiting times of all connections."""

    backoff_initial_s: float = 0.5
    """Wait before the first new try after a loss, seconds."""
    backoff_factor: float = 2.0
    """By how much each further wait is longer."""
    backoff_max_s: float = 15.0
    """Longest wait between two tries, seconds."""
    stable_after_s: float = 10.0
    """A connection that lasted this long begins again with the shortest wait, seconds."""
    connect_timeout_s: float = 5.0
    """How long opening may take, seconds."""
    max_peers: int = 256
    """Peers behind one UDP socket; the one heard longest ago goes first."""
    max_clients: int = 32
    """Clients of one TCP server; further ones are turned away, counted."""
    write_queue_bytes: int = 65_536
    """Bytes that may wait to leave by one socket; frames beyond are dropped, counted."""
    serial_write_queue_bytes: int = 4_096
    """The same of a serial port: under a second at 57,600 baud, for a later command is a wrong one."""
    receive_buffer_bytes: int = 1 << 22
    """Asked of the system for each UDP socket."""
    max_datagram_bytes: int = 1_400
    """Frames are put together up to this size when passed on by UDP."""
