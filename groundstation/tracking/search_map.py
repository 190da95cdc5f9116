"""The search map: where a beacon could be, square by square, ready to be coloured.

Exists so that a searcher sees more than three outlines. Rule: it is the raster that the
regions are read off, so that the square marked "90 %" lies inside the 90 % outline; its size
is bounded, and values are rounded, so that the last bit of a sum is not part of an answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.localization.containment import Raster

_SHARE_DECIMALS = 7
UNITS = 10_000
"""Of containment: 9000 are 90 %."""


@dataclass(frozen=True, slots=True, eq=False)
class SquareShares:
    """What each square holds, rows from the north, columns from the west."""

    share: NDArray[np.float32]
    """(rows, columns) share of the belief; sums to one but for rounding."""
    containment: NDArray[np.uint16]
    """(rows, columns) share of the belief in all squares at least as likely, in ``UNITS``."""


def square_shares(picture: Raster) -> SquareShares:
    """Shares and containment of a raster whose rows begin in the south.

    Squares of one share have one containment, that of them all together: an even belief is
    even on the map, whatever order its squares are counted in.
    """
    mass = picture.mass[::-1]
    share = np.round(mass / mass.sum(), _SHARE_DECIMALS)
    values, index, count = np.unique(share, return_inverse=True, return_counts=True)
    # From the likeliest down: all squares of one value at once.
    reached = np.cumsum((values * count)[::-1])[::-1] / (values * count).sum()
    contained = np.clip(np.round(reached * UNITS), 0, UNITS).astype(np.uint16)
    return SquareShares(share.astype(np.float32), contained[_flat(index)].reshape(share.shape))


def _flat(index: Any) -> Any:
    # NumPy 2.0 gave the inverse the shape of what it was asked of, others a flat one.
    return np.asarray(index).ravel()
