"""What the service assumes of the radio and of a snapshot: wider than the paper's analytic channel.

Exists because a service does not know the reference loss, the receivers' calibration or the
exponent of the rubble under it. Rule: each number here is an assumption of the service, not
of the solvers, whose defaults are the paper's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from groundstation.localization.environment import SOUND_CHOICE, Choice
from groundstation.localization.problem import SignalModel

SERVICE_MODEL = SignalModel(
    rss_std_db=5.0,
    nlos_rss_std_db=5.0,
    azimuth_std_rad=math.radians(1.0),
    elevation_std_rad=math.radians(1.0),
    angle_outlier_probability=0.05,
    los_exponent=2.2,
    los_exponent_std=0.2,
    transmit_power_min_dbm=-110.0,
    transmit_power_max_dbm=110.0,
    receiver_offset_std_db=3.0,
    nlos_exponent_min=1.5,
    nlos_exponent_max=8.0,
    shared_shadowing=0.7,
    nlos_bias_max_db=7.0,
    antenna_null_mean=1.2,
    antenna_null_std=1.0,
    vehicle_position_std_m=1.0,
    vehicle_height_std_m=2.0,
)
"""Transmit power here is that received at one metre in the model's terms: it takes in the loss
over the first metre (31.5 dB at 900 MHz), antennas, an excess loss common to all links and the zero
of a receiver that was never calibrated: a steep exponent met by such a receiver puts it 60 to 100 dB
from where a calibrated one has it, and a narrow prior then turns the exponent, and with it the place.
Exponents go up to 8: the cover of a buried phone is the longer the flatter the ray, which adds
its own exponent, (11), to that of free space, (10). Most of the shadowing is shared: what
stands round a phone stands there for every vehicle. Upright antennas are deaf overhead: without
that the strongest places, a ring round the transmitter, are taken for its own (docs/flights.md).
Places are those of a satellite receiver without corrections, where vehicles do not say otherwise."""


@dataclass(frozen=True, slots=True)
class LocalizationSettings:
    """Settings of the snapshot (Algorithm 1) in the service."""

    model: SignalModel = field(default_factory=lambda: SERVICE_MODEL)
    """What is assumed of the radio."""
    choice: Choice = SOUND_CHOICE
    """Solver for each environment."""
    window_age_s: float = 15.0
    """A vehicle's newest window older than this is left out, seconds."""
    window_path_m: float = 40.0
    """A window averaged over a longer flight than this is left out, metres."""
