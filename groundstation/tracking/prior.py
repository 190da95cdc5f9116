"""What is known of a person's place before any radio was heard: last known positions.

Exists so that a witness counts as evidence and not as a fence. Rule: a prior never rules
out: a share of it stays even over the search area, whatever the witness said.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.localization.problem import FloatArray, SearchArea
from groundstation.tracking.belief import Field

_STD_OF_RADIUS_90 = math.sqrt(2.0 * math.log(10.0))
"""A circle round a Gaussian's mean holds 90 % at so many standard deviations of one axis."""


@dataclass(frozen=True, slots=True)
class LastKnown:
    """A place where the person was last known to be."""

    east_m: float
    north_m: float
    radius_m: float
    """Of the circle that is trusted to hold the person nine times in ten."""


def prior_field(places: Sequence[LastKnown], area: SearchArea, doubt: float) -> Field | None:
    """Log likelihood of boxes, relative to an even belief over ``area``; None without places.

        log p(x) A = log((1 − ε) A / n Σ N(x; c_k, σ_k²) + ε),   σ_k = r_k / √(2 ln 10)

    with A the area in m² and ε ``doubt``, the share of the belief that knows nothing. A box is
    weighed by the Gaussian widened by its own extent. The places stand beside each other (he
    was seen here or there), they do not multiply.
    """
    if not places:
        return None
    size_m2 = math.pi * area.radius_m**2 if area.polygon_en_m is None else area.polygon_en_m.area
    doubt = min(max(doubt, 1e-3), 1.0)

    def field(center_enu_m: FloatArray, half_m: FloatArray) -> FloatArray:
        density = np.zeros(center_enu_m.shape[0])
        for place in places:
            variance = (place.radius_m / _STD_OF_RADIUS_90) ** 2 + half_m[:, 0] ** 2 / 3.0
            square = (center_enu_m[:, 0] - place.east_m) ** 2 + (center_enu_m[:, 1] - place.north_m) ** 2
            density += np.exp(-0.5 * square / variance) / (2.0 * math.pi * variance)
        result: FloatArray = np.log((1.0 - doubt) * size_m2 / len(places) * density + doubt)
        return result

    return field
