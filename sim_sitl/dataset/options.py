"""What kind of data set to make; checked before anything is drawn.

Rule kept here: bandwidth and tap spacing are the user's to say, and nonsense is refused in one line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from groundstation.domain.errors import InputError
from sim_sitl.cir import Sounder

FIRST_PATH_TAP = 64.0
"""Of the plain data: noise before it, and all of the model's delays behind it."""
SAMPLES_PER_PULSE = 1.997
"""Default taps per 1/bandwidth: those of 1.0016 ns at 500 MHz."""
TAPS_MIN = 16


def dataset_sounder(
    bandwidth_mhz: float | None = None, tap_spacing_ns: float | None = None, taps: int = 1016
) -> Sounder:
    """The plain kind's sounder. Raises InputError on values that no receiver has.

    Without a tap spacing there are two taps (1.997) to 1/bandwidth, as in the default of
    500 MHz and 1.0016 ns. The paper's 3 MHz with a tap of 333 ns is ``(3, 333)``.
    """
    bandwidth = 500.0 if bandwidth_mhz is None else bandwidth_mhz
    if not (math.isfinite(bandwidth) and 0.1 <= bandwidth <= 5000):
        raise InputError(f"--bandwidth-mhz is {bandwidth_mhz}; 0.1 to 5000 is needed")
    pulse_ns = 1e3 / bandwidth
    spacing = pulse_ns / SAMPLES_PER_PULSE if tap_spacing_ns is None else tap_spacing_ns
    if bandwidth_mhz is None and tap_spacing_ns is None:
        spacing = Sounder().tap_spacing_ns
    if not (math.isfinite(spacing) and spacing > 0):
        raise InputError(f"--tap-spacing-ns is {tap_spacing_ns}; a positive number is needed")
    if spacing > 1.001 * pulse_ns:
        raise InputError(
            f"--tap-spacing-ns is {spacing:g}; {bandwidth:g} MHz need at most 1/bandwidth = {pulse_ns:g} ns"
        )
    if taps < TAPS_MIN:
        raise InputError(f"--taps is {taps}; at least {TAPS_MIN} are needed")
    return Sounder(bandwidth * 1e6, spacing, taps, min(FIRST_PATH_TAP, taps // 4))


@dataclass(frozen=True, slots=True)
class DatasetOptions:
    """What kind of data to make."""

    sounder: Sounder = field(default_factory=dataset_sounder)
    """Bandwidth, tap spacing, taps and first path of the plain kind; ``taps`` of both."""
    packets_per_link: int = 4
    """Consecutive captures of one geometry."""
    randomise: bool = False
    """Domain randomisation: see :mod:`sim_sitl.dataset.randomisation`."""
    equal_noise: bool = False
    """Plain kind: noise drawn alike for both labels, instead of following from the link budget, by
    which obstructed links stand less above it: what is left to tell them by is the shape."""

    def __post_init__(self) -> None:
        """Raises InputError on less than one packet, or on options that exclude one another."""
        if self.randomise and self.equal_noise:
            raise InputError("--equal-noise is of the plain kind; --randomise draws noise alike anyway")
        if self.packets_per_link < 1:
            raise InputError(f"--packets is {self.packets_per_link}; at least 1 is needed")
