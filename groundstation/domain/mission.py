"""What the operator set: origin, search area, what is known before, fence, limits.

Revised as a whole, journalled as a whole: a replay needs no other file.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from groundstation.domain.geometry import Geodetic

Ring = tuple[tuple[float, float], ...]
"""(latitude_deg, longitude_deg) corners, closed: the last equals the first."""


@dataclass(frozen=True, slots=True)
class Area:
    """One or several polygons on WGS84: for each an outer ring and its holes."""

    polygons: tuple[tuple[Ring, ...], ...]
    name: str = ""


@dataclass(frozen=True, slots=True)
class LastKnownPlace:
    """Where somebody was last known to be: seen, or by the last call of a phone."""

    latitude_deg: float
    longitude_deg: float
    radius_m: float
    """Of the circle that is trusted to hold the person nine times in ten."""
    name: str = ""
    beacon_id: int | None = None
    """Of the beacon that this is known of; None: of any of them."""


@dataclass(frozen=True, slots=True)
class Terrain:
    """Heights of the ground at the nodes of a grid on WGS84, as read from a file and cut to the mission."""

    south_deg: float
    """Latitude of the first row."""
    west_deg: float
    """Longitude of the first column."""
    latitude_step_deg: float
    longitude_step_deg: float
    columns: int
    altitude_dm: tuple[int | None, ...]
    """Altitude above mean sea level, decimetres, row by row from the south-west; None: not known."""
    source: str
    """The file's name, for people."""

    @property
    def rows(self) -> int:
        """From south to north."""
        return len(self.altitude_dm) // self.columns


@dataclass(frozen=True, slots=True)
class FlightLimits:
    """What the gate allows; metres, seconds."""

    floor_m: float = 20.0
    """Lowest commanded height above home."""
    ceiling_m: float = 120.0
    """Highest commanded height above home."""
    separation_m: float = 15.0
    """Smallest distance between a commanded place (and the way there) and another vehicle or its target."""
    fence_margin_m: float = 5.0
    """How far inside the fence a commanded place and the way there must stay."""
    stale_pose_s: float = 3.0
    """An older pose makes the gate refuse."""
    max_leg_m: float = 2000.0
    """Longest allowed leg of one command."""


@dataclass(frozen=True, slots=True)
class Mission:
    """Everything above, with a revision that grows by one at each change."""

    revision: int = 0
    origin: Geodetic | None = None
    """Of the local frame: set by the operator or the first valid home position."""
    search_area: Area | None = None
    fence: Area | None = None
    """Where vehicles may go: without it nothing is commanded."""
    target_height_min_m: float = 0.0
    """Above the ground."""
    target_height_max_m: float = 20.0
    """Above the ground."""
    ground_amsl_m: float | None = None
    """Altitude of the ground; None: not known, the origin's is used and the output says so."""
    height_reference: str = "unknown"
    """Where ``ground_amsl_m`` comes from: ``terrain``, ``home``, ``settings`` or ``unknown``."""
    limits: FlightLimits = field(default_factory=FlightLimits)
    last_known: tuple[LastKnownPlace, ...] = ()
    """Where a person was last known to be: a prior for the search, never a fence."""
    terrain: Terrain | None = None
    """The ground's heights; where it has none, ``ground_amsl_m`` counts."""
