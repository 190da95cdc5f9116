"""What the tracker assumes of the field, and what it may cost. Wider than the paper's model."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TrackingSettings:
    """Settings of one beacon's belief."""

    correlation_m: float = 25.0
    """Distance over which shadowing forgets itself, metres (Gudmundson: 10–50)."""
    parents: int = 5
    """Earlier windows that a window is conditioned on: those that together foretell most of it."""
    sample_std_db: float = 2.5
    """Noise of a window's averaged power besides shadowing (fading, quantisation), dB."""
    noise_degrees: float | None = 5.0
    """How firmly it is believed that the noise is no higher (degrees of freedom); None: taken as given."""
    nlos_exponent_doubt: float = 0.15
    """How far the NLOS exponent may lie beyond the model's limits (e-folding of its prior in ln β)."""
    outlier_std: float = 3.0
    """A window further off than this many standard deviations at every likely place is weighted down."""
    angle_bias_std_rad: float = math.radians(1.0)
    """Constant error of a vehicle's angles (mounting, compass), radians."""
    angle_correlation_m: float = 2.0
    """Distance over which the rest of an angle's error forgets itself, metres."""
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
    minimum_half_m: float = 0.08
    """Half the width of the smallest box, metres; never under a quarter of the places' error."""
    sensitivity_dbm: float | None = None
    """Level from which on the receivers hear, dBm; none: learned from what each one reports."""
    detection_snr_db: float = 10.0
    """So far above the noise that a receiver reports it hears at least, dB; what it heard proves more."""
    sensitivity_std_db: float = 3.0
    """How well such a sensitivity is known, dB."""
    silence_spacing_m: float = 15.0
    """Silences of one vehicle closer together than this are one, metres."""
    maximum_silent_places: int = 48
    """Places kept where a beacon was listened for; more are taken further apart."""
    maximum_heard_places: int = 20
    """Places kept where its level was heard, for what it should have been elsewhere."""
    deaf_probability: float = 0.05
    """P(a receiver that reported beacons hears nothing now)."""
    unproven_deaf_probability: float = 0.3
    """The same of a receiver that lives, but never reported a beacon."""
    quiet_probability: float = 0.1
    """Least P(a beacon did not speak where nobody heard it), however regular it was."""
    switched_on_later_probability: float = 0.3
    """P(it did not speak yet before it was first heard), if it speaks all the time since."""
    silence_doubt: float = 0.02
    """P(nothing of this holds): silence lowers no place by more than this factor."""
    last_known_doubt: float = 0.2
    """Share of the belief that no last known position moves."""
    walking_prior: float = 0.03
    """P(the person walks) when first heard."""
    walking_rate_per_s: float = 1.0 / 5000.0
    """How often somebody who stands still starts to walk, per second."""
    walking_speed_std_mps: float = 0.7
    """Spread of a walker's velocity on each axis, m/s."""
    walking_speed_max_mps: float = 1.5
    """Nobody in rubble is faster, m/s."""
    walking_memory_s: float = 60.0
    """How long a walker keeps direction and speed, seconds."""
    walking_particles: int = 2000
    """Particles of a walker who is suspected: with fewer, bearings leave a handful and a region too small."""
    walking_watch_particles: int = 500
    """The same where nobody is."""
    walking_watch_vehicles: int = 8
    """Of more vehicles only so many are listened to at a step, in turn, where nobody is suspected."""
    walking_births: int = 40
    """Of them, those that may start to walk at each step."""
    walking_points: int = 160
    """Places of the still belief that its forecast is scored at."""
    walking_redraw_s: float = 10.0
    """They are drawn anew this often, seconds."""
    walking_watch_interval_s: float = 4.0
    """Steps of the walker are this far apart, seconds."""
    walking_interval_s: float = 2.0
    """The same where walking is suspected."""
    walking_suspected: float = 0.1
    """P(walking) from which on it is."""
    walking_vehicles: int = 3
    """With fewer vehicles nobody is taken to walk: an antenna or a model that is off looks the same."""
    walking_certain: float = 0.99
    """From this P(walking) on, the still belief is begun anew where the walker is."""
    walking_restart_s: float = 20.0
    """At most this often, seconds."""
    walking_stopped: float = 0.2
    """P(a walker has stopped by then)."""
    walking_shown: float = 0.5
    """Below this P(walking) the answer is the still belief's alone."""
