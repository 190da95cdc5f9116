"""All settings in one tree: what the station as a whole needs, and each room's own.

Rule: a room's numbers are declared in that room, with their documentation; this module only
puts them under a name.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from groundstation.channel.settings import ChannelSettings
from groundstation.command.settings import CommandRoomSettings
from groundstation.connections.settings import ConnectionSettings
from groundstation.domain.mission import FlightLimits
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.guidance.settings import GuidanceSettings
from groundstation.measurement.settings import MeasurementSettings
from groundstation.safety.settings import SafetySettings
from groundstation.server.settings import ServerSettings
from groundstation.store.settings import StoreSettings


@dataclass(frozen=True, slots=True)
class TargetSettings:
    """At which heights beacons may be, before an operator says otherwise."""

    height_min_m: float = 0.0
    """Lowest height of a beacon above the ground, metres."""
    height_max_m: float = 20.0
    """Highest height of a beacon above the ground, metres."""
    ground_amsl_m: float | None = None
    """Altitude of the ground above mean sea level, metres; none: the home position's is used."""


@dataclass(frozen=True, slots=True)
class Config:
    """Everything that may be set."""

    data_dir: Path = Path("sessions")
    """Directory that gets one directory for each run."""
    links: tuple[str, ...] = ()
    """Connections to vehicles: udpin:HOST:PORT, udpout:…, tcp:…, tcpin:…, serial:DEVICE:BAUD."""
    forward: tuple[str, ...] = ()
    """Connections to other ground stations, which get every vehicle's frames."""
    forward_commands: bool = False
    """Whether those stations may command the vehicles; false: they only listen."""
    area: Path | None = None
    """GeoJSON file of the search area; Points with a radius_m in it are last known places."""
    fence: Path | None = None
    """GeoJSON file of where vehicles may go; none: nothing is commanded."""
    terrain: Path | None = None
    """File of the ground's heights (.hgt, .asc, .tif); none: the ground is level."""
    target: TargetSettings = field(default_factory=TargetSettings)
    """Heights of beacons."""
    limits: FlightLimits = field(default_factory=FlightLimits)
    """What the gate allows."""
    measurement: MeasurementSettings = field(default_factory=MeasurementSettings)
    """From frames to link windows."""
    channel: ChannelSettings = field(default_factory=ChannelSettings)
    """Line of sight or not."""
    estimator: EstimatorSettings = field(default_factory=EstimatorSettings)
    """Where a beacon could be: localization and tracking."""
    guidance: GuidanceSettings = field(default_factory=GuidanceSettings)
    """Where to fly next."""
    safety: SafetySettings = field(default_factory=SafetySettings)
    """Gate, guard and grants."""
    command: CommandRoomSettings = field(default_factory=CommandRoomSettings)
    """Commands to vehicles, and what they are asked to send."""
    connections: ConnectionSettings = field(default_factory=ConnectionSettings)
    """UDP, TCP and serial."""
    store: StoreSettings = field(default_factory=StoreSettings)
    """The session's files."""
    server: ServerSettings = field(default_factory=ServerSettings)
    """HTTP and websocket."""
