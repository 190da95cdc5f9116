"""What the operator set: origin, search area, fence, limits. Revised as a whole, journalled."""

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
