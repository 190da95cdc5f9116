"""What the guidance room may be told."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class GuidanceSettings:
    """How vehicles are spread round an estimate, and when it is worth a proposal."""

    valid_s: float = 90.0
    """How long a proposal may be confirmed, seconds."""
    standoff_of_radius: float = 1.0
    """Distance from the estimate in its 90 % radii, before the limits below."""
    standoff_of_height: float = 0.8
    """Smallest distance from the estimate, in heights above it: nearer, azimuth says little."""
    standoff_min_m: float = 25.0
    """Smallest horizontal distance from the estimate, metres."""
    standoff_max_m: float = 200.0
    """Largest horizontal distance from the estimate, metres."""
    found_radius_m: float = 3.0
    """A beacon whose 90 % radius is below this needs no more vehicles, metres; what the vehicles' own places
    are unsure by, which no flight makes better, does not count."""
    stale_target_s: float = 120.0
    """A beacon not heard for longer gets no vehicles, seconds."""
    vehicles_per_beacon: int = 3
    """As many vehicles as one beacon gets before a second beacon gets any."""
    move_min_m: float = 12.0
    """A vehicle nearer than this to its place stays where it is, metres."""
    move_of_standoff: float = 0.2
    """… or nearer than this part of the distance to the estimate."""
    rotations: int = 12
    """Turns of the whole ring that are tried for the shortest way to fly."""
    height_margin_m: float = 2.0
    """Proposed heights stay this far from floor and ceiling, metres."""
