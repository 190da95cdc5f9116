"""Numbers of the channel room, each with its unit; the composition root may replace them.

Rule kept here: what shapes the network's input is not here but in the model's metadata, for
a model and its preprocessing belong together.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ChannelSettings:
    """Settings of channel identification."""

    prior_los_probability: float = 0.5
    """P(line of sight) of a link that cannot be classified, 0..1."""
    packets_max: int = 8
    """Newest captures of a link that are looked at."""
    taps_min: int = 16
    """Fewer taps than this are no channel response."""
    reject_noise: bool = True
    """Whether a capture that looks like noise alone is left out (a study judges every one)."""
    batch_max: int = 256
    """Links per run of the network; bounds memory."""
