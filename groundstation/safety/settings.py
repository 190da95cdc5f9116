"""What the safety room may be told; the mission's own limits are in ``domain.mission``."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SafetySettings:
    """Tolerances of gate, grants and guard."""

    min_flying_height_m: float = 2.0
    """Below this height above home a vehicle counts as on the ground, metres."""
    height_tolerance_m: float = 2.0
    """How far a flying vehicle's present height may stray beyond floor or ceiling, metres."""
    datum_tolerance_m: float = 5.0
    """Largest difference between a vehicle's height above home and its altitude less home's, metres."""
    look_ahead_s: float = 3.0
    """How long another vehicle is assumed to go on at its velocity, seconds."""
    grant_lifetime_s: float = 6.0
    """How long a grant lets frames leave, retries included, seconds."""
    grant_tolerance_m: float = 0.2
    """How far a frame's target may be from its grant's (rounding on the wire), metres."""
    hold_shadow_s: float = 5.0
    """How long after a hold another ground station's frames to that vehicle are refused, seconds."""
