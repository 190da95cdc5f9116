"""What one flight of the lone surveyor is made of, and how a plausible one is drawn.

Rule: the same seed gives the same flight; nothing of it depends on the station's settings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from groundstation.domain.geometry import Enu
from sim_sitl.randomness import Stream, generator


@dataclass(frozen=True, slots=True)
class Survey:
    """What one flight is made of; ``draw`` gives a plausible one."""

    seed: int
    plan: str
    """``stops``: a coarse round of hovers, then a ring round the strongest; ``lanes``: a lawnmower."""
    half_width_m: float
    """Of the square search area round the origin, metres."""
    target_enu_m: Enu
    height_m: float
    """Of the vehicle above ground, metres."""
    frequency_hz: float
    unit_offset_db: float
    """What the receiver's decibels are off from dBm."""
    sample_hz: float
    shadowing_std_db: float
    shadowing_m: float
    """Distance over which shadowing forgets itself, metres."""
    rician_k_db: float
    transmitter_tilt_rad: float
    airframe_std_db: float
    """Size of the airframe's pattern, dB."""
    roughness_m: float
    """Standard deviation of the ground's height, metres."""
    ground_permittivity: float
    clutter_db_per_m: float
    """Loss on the way through what stands on the ground, per horizontal metre."""
    margin_db: float
    """Mean power above the threshold of lock at 100 m with both antennas at their best."""
    unlocked: str
    """Below lock the receiver gives ``noise`` (its floor, drifting) or ``nothing``."""
    turns: bool
    """The nose follows the flight; else it keeps one direction."""
    duration_s: float = 600.0


def draw(seed: int, plan: str = "stops") -> Survey:
    """A plausible flight; the same seed gives the same one."""
    rng = generator(seed, Stream.SURVEY, 0)
    half = float(rng.uniform(100.0, 150.0))
    # Most targets lie well inside, some near the edge, some a little outside.
    reach = half * float(rng.choice([0.5, 0.95, 1.1], p=[0.5, 0.4, 0.1]))
    place = rng.uniform(-reach, reach, 2)
    return Survey(
        seed,
        plan,
        half,
        (float(place[0]), float(place[1]), float(rng.uniform(0.5, 1.8))),
        float(rng.uniform(30.0, 60.0)),
        float(rng.choice([3.32e9, 0.9e9, 2.44e9])),
        float(rng.uniform(-60.0, 60.0)),
        float(rng.choice([1.0, 2.0, 5.0])),
        float(rng.uniform(3.0, 6.0)),
        float(rng.uniform(8.0, 30.0)),
        float(rng.uniform(3.0, 12.0)),
        math.radians(float(rng.uniform(0.0, 20.0))),
        float(rng.uniform(1.0, 3.0)),
        float(rng.uniform(0.01, 0.06)),
        float(rng.uniform(4.0, 20.0)),
        float(rng.uniform(0.0, 0.08)),
        float(rng.uniform(5.0, 40.0)),
        str(rng.choice(["noise", "nothing"])),
        bool(rng.integers(2)),
    )
