"""Settings of the server room, one frozen dataclass, composed by the config room."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ServerSettings:
    """Where the page is served, how often it is refreshed, and every bound."""

    host: str = "127.0.0.1"
    """Address to listen on. Anything but loopback lets others on the network act."""
    port: int = 8000
    """TCP port; 0 takes a free one."""
    allowed_hosts: tuple[str, ...] = ()
    """Names, besides ``localhost`` and IP addresses, under which a browser may open the page."""
    publish_interval_s: float = 0.1
    """Shortest time between two deltas."""
    heartbeat_interval_s: float = 1.0
    """A message goes out at least this often, so that the page can tell silence from loss."""
    ring_deltas: int = 100
    """Newest deltas kept for clients that come back (``?since=``); after more, a snapshot is cheaper."""
    events_in_memory: int = 5000
    """Newest events kept, also between two deltas; older ones come from the database."""
    snapshot_events: int = 200
    """Newest events sent to a page that opens."""
    client_events_max: int = 5000
    """Events waiting for one slow client before it is closed."""
    send_timeout_s: float = 10.0
    """A client that takes nothing for this long is closed."""
    max_clients: int = 64
    """Websocket clients at one time."""
    max_vehicles: int = 255
    """Rows kept; MAVLink has no more system ids."""
    max_links: int = 4096
    """Rows kept; the link not heard for longest gives way."""
    max_targets: int = 1024
    """Rows kept; the beacon not updated for longest gives way."""
    max_proposals: int = 256
    """Rows kept; the oldest gives way."""
    max_commands: int = 200
    """Rows kept; the oldest gives way."""
    max_counters: int = 4096
    """Rows kept; further names are refused and counted."""
    max_connections: int = 256
    """Rows kept; the connection not updated for longest gives way."""
    history_points: int = 240
    """Beliefs kept of each beacon for the curve of its radius, evenly over the time; the database has all."""
    trail_points: int = 300
    """Points kept of each vehicle's path."""
    trail_spacing_m: float = 3.0
    """Distance between two points of a path."""
    body_limit_bytes: int = 65_536
    """Largest request body."""
    graceful_stop_s: float = 3.0
    """How long open requests get when the server stops."""
