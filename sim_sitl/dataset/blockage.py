"""People who walk through a link.

Why: the paper enables NYUSIM's human blockage. Its four-state chain (unshadowed, decaying,
shadowed, rising) says when, with the default rates that NYUSIM takes from measurements at
73 GHz. How deep cannot be taken from there: a body that costs 15 dB at 73 GHz is half a
wavelength wide at 868 MHz. The depth is therefore that of knife-edge diffraction round a screen of
a person's size (3GPP TR 38.901, 7.6.4.2, blockage model B). Rule kept here: what stands in the way
attenuates the paths that leave the beacon in its direction, and no others; the label stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_sitl.cir import SPEED_OF_LIGHT_M_S
from sim_sitl.dataset.geometry import CAPTURE_INTERVAL_S, FREQUENCY_HZ

UNSHADOWED, DECAYING, SHADOWED, RISING = range(4)
RATES_PER_S = (0.2, 8.1, 7.85, 6.7)
"""Out of each state; NYUSIM's defaults for a beam of 10°, the narrowest it gives."""
PERSON_WIDTH_M = (0.3, 0.6)
PERSON_ABOVE_BEACON_M = (0.2, 1.6)
PERSON_DISTANCE_M = (0.3, 3.0)


@dataclass(frozen=True, slots=True, eq=False)
class Blockage:
    """One link's blocker through its captures."""

    state: NDArray[np.int64]
    """(captures,)"""
    loss_db: NDArray[np.float64]
    """(captures, paths)"""


def draw_blockage(
    rng: np.random.Generator, departure_azimuth_rad: NDArray[np.float64], captures: int
) -> Blockage:
    """A blocker for paths that leave the beacon at ``departure_azimuth_rad`` (paths,)."""
    state, share = _chain(rng, captures)
    width_m = float(rng.uniform(*PERSON_WIDTH_M))
    above_m = float(rng.uniform(*PERSON_ABOVE_BEACON_M))
    distance_m = float(rng.uniform(*PERSON_DISTANCE_M))
    # Somewhere round the beacon: as often as not nobody stands in the direct path.
    offset_rad = departure_azimuth_rad - rng.uniform(-np.pi, np.pi)
    depth_db = screen_loss_db(offset_rad, distance_m, width_m, above_m)
    return Blockage(state, share[:, None] * depth_db)


def screen_loss_db(
    offset_rad: NDArray[np.float64], distance_m: float, width_m: float, above_m: float
) -> NDArray[np.float64]:
    """Loss of paths that pass a standing person at ``offset_rad`` (...), ≥ 0 dB; far other end.

    L = −20 log₁₀(1 − (F_h1 + F_h2)(F_w1 + F_w2)),
    F = atan(±(π/2) √(π/λ · excess length over that edge)) / π; 0 behind the beacon.
    """
    wavelength_m = SPEED_OF_LIGHT_M_S / FREQUENCY_HZ
    along = distance_m * np.cos(offset_rad)
    across = distance_m * np.sin(offset_rad)

    def edge(past_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Diffraction at an edge that reaches ``past_m`` beyond the ray (< 0: short of it)."""
        excess_m = np.hypot(along, past_m) - along
        term: NDArray[np.float64] = np.arctan(
            np.sign(past_m) * np.pi / 2 * np.sqrt(np.pi / wavelength_m * excess_m)
        )
        return term / np.pi

    ahead = along > 0
    along = np.where(ahead, along, 1.0)
    sideways = edge(width_m / 2 - across) + edge(width_m / 2 + across)
    # The screen reaches from well below the beacon to the person's head.
    upright = edge(np.full_like(along, above_m)) + edge(np.full_like(along, 1.0))
    shadow = np.clip(sideways * upright, 0.0, 0.99)
    return np.where(ahead, -20 * np.log10(1 - shadow), 0.0)


def _chain(rng: np.random.Generator, captures: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """(captures,) state and share of the full depth in dB, from the chain's steady state."""
    stay_s = 1 / np.array(RATES_PER_S)
    state = int(rng.choice(4, p=stay_s / stay_s.sum()))
    # Memoryless: what is left of a stay is distributed as a whole one.
    began_s, ends_s = 0.0, float(rng.exponential(stay_s[state]))
    states = np.empty(captures, np.int64)
    share = np.empty(captures)
    for index in range(captures):
        now_s = index * CAPTURE_INTERVAL_S
        while now_s >= ends_s:
            state = (state + 1) % 4
            began_s, ends_s = ends_s, ends_s + float(rng.exponential(stay_s[state]))
        passed = (now_s - began_s) / (ends_s - began_s)
        states[index] = state
        share[index] = (0.0, passed, 1.0, 1 - passed)[state]
    return states, share
