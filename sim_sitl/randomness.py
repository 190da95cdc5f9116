"""Named streams of randomness: one seed, and every part of the world draws from its own.

Keeps the rule that adding a vehicle, a beacon or a draw somewhere changes nothing elsewhere.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """Who draws. Numbers are part of what a seed means: append only."""

    BEACON_PLACE = 1
    SHADOWING = 2
    MATERIAL = 3
    FADING = 4
    ANGLE = 5
    REFLECTOR = 6
    SENSOR_CLOCK = 7
    CIR = 8
    AUTOPILOT = 9
    WIND = 10
    LOSSY_LINK = 11
    PACKETS = 12
    SURVEY = 13


def generator(seed: int, stream: Stream, *key: int) -> np.random.Generator:
    """The generator of one stream, for one vehicle, beacon, … (non-negative integers)."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, int(stream), *key])))
