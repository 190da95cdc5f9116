"""The ray of the one LOS link, eqs. (71) and (74)–(75), for N problems at once.

Exists because four methods end on that ray. Rule: the link is the surest of those labelled
LOS that have both angles; a ray is what the paper prints, from the vehicle on without end,
unless it is asked for within the target's height limits: (74) may run on under the ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.localization.batch import Batch
from groundstation.localization.problem import FloatArray, SearchArea, SignalModel

_LEVEL = 1e-3
"""Sine of the elevation under which a ray counts as level: it meets no height limit on the way."""


def unit_bearings(azimuth_rad: FloatArray, elevation_rad: FloatArray) -> FloatArray:
    """(…, 3) unit vectors δ of (71), east, north, up."""
    cos_elevation = np.cos(elevation_rad)
    return np.stack(
        [cos_elevation * np.cos(azimuth_rad), cos_elevation * np.sin(azimuth_rad), np.sin(elevation_rad)],
        axis=-1,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """N rays, one a problem."""

    link: NDArray[np.int64]
    """(N,) which link it is."""
    origin_enu_m: FloatArray
    """(N, 3) the vehicle, metres."""
    direction: FloatArray
    """(N, 3) unit vector δ of (71)."""

    @classmethod
    def of(cls, batch: Batch) -> Rays:
        """The rays of problems that each have a LOS link with angles."""
        probability = np.where(batch.bearing_usable(), batch.links.los_probability, -1.0)
        link = np.argmax(probability, axis=1)
        rows = np.arange(batch.size)
        links = batch.links
        direction = unit_bearings(links.azimuth_rad[rows, link], links.elevation_rad[rows, link])
        return cls(link, batch.place[rows, link], direction)

    def along_m(self, position_enu_m: FloatArray) -> FloatArray:
        """(N,) ρ̃ of (74): metres from the vehicle to the ray's point nearest to positions (N, 3)."""
        along = np.einsum("ni,ni->n", position_enu_m - self.origin_enu_m, self.direction)
        result: FloatArray = np.maximum(along, 0.0)
        return result

    def at(self, along_m: FloatArray) -> FloatArray:
        """(N, 3) metres: (75)."""
        return self.origin_enu_m + along_m[:, None] * self.direction

    def along_within_heights_m(self, position_enu_m: FloatArray, area: SearchArea) -> FloatArray:
        """(N,) as ``along_m``, on the stretch between the target's height limits where the ray has one."""
        along, climb = self.along_m(position_enu_m), self.direction[:, 2]
        level = np.abs(climb) < _LEVEL
        per_metre = 1.0 / np.where(level, 1.0, climb)
        low, high = (
            (height - self.origin_enu_m[:, 2]) * per_metre
            for height in (area.height_min_m, area.height_max_m)
        )
        start, end = np.minimum(low, high), np.maximum(low, high)
        return np.where(level | (end <= 0.0), along, np.clip(along, start, end))

    def angle_misfit(self, position_enu_m: FloatArray, model: SignalModel) -> FloatArray:
        """(N,) χ² of the ray's two angles, were the target at positions (N, 3); 0 on the ray."""
        offset = position_enu_m - self.origin_enu_m
        level = np.hypot(offset[:, 0], offset[:, 1])
        east, north, up = self.direction.T
        turned = np.arctan2(north, east) - np.arctan2(offset[:, 1], offset[:, 0])
        tilted = np.arctan2(up, np.hypot(east, north)) - np.arctan2(offset[:, 2], level)
        # Near the zenith an azimuth says little: its error counts by the arc that it spans.
        arc = np.hypot(east, north) * np.abs(np.exp(1j * turned) - 1.0)
        result: FloatArray = (arc / model.azimuth_std_rad) ** 2 + (tilted / model.elevation_std_rad) ** 2
        return result
