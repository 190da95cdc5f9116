"""What the tracker assumes of the field, and what it may cost. Wider than the paper's model."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TrackingSettings:
    """Settings of one beacon's belief."""

    correlation_m: float = 30.0
    """Distance over which shadowing forgets itself, metres (Gudmundson: 10–50)."""
    parents: int = 3
    """Earlier windows of the same vehicle that a window is conditioned on."""
    foreign_parents: int = 3
    """Earlier windows of other vehicles that it is conditioned on as well."""
    sample_std_db: float = 1.5
    """Noise of a window's averaged power besides shadowing (fading, quantisation), dB."""
    noise_degrees: float | None = 12.0
    """How firmly the noise level is believed (degrees of freedom); None: it is taken as given."""
    outlier_std: float = 3.0
    """A window further off than this many standard deviations at every likely place is weighted down."""
    angle_bias_std_rad: float = math.radians(1.0)
    """Constant error of a vehicle's angles (mounting, compass), radians."""
    angle_outlier_probability: float = 0.05
    """Share of LOS angles that point anywhere."""
    los_shares: tuple[float, ...] = (0.01, 0.05, 0.2, 0.5, 0.8, 0.95)
    """Equally likely shares of a beacon's links that are line of sight: how far its angles are trusted."""
    windows_per_place: int = 4
    """Windows of one vehicle taken from one place; more of them teach nothing and are counted."""
    place_radius_m: float = 1.5
    """What counts as one place, metres."""
    maximum_windows: int = 500
    """Windows remembered a beacon; beyond it every second of a vehicle's older ones goes."""
    base_cells: int = 18
    """Boxes across the search area before any split."""
    maximum_cells: int = 1600
    """Candidate boxes a beacon."""
    split_mass: float = 0.006
    """A box with more of the belief than this is split."""
    remesh_mass: float = 0.025
    """The boxes are laid anew when one that can be split holds more than this."""
    minimum_half_m: float = 0.3
    """Half the width of the smallest box, metres."""
