"""The matrix lifting of (62), Z ⪰ 0, reduced to the one number that the programs see of it.

Exists because tr(C_k Z) = tr X − 2 a_k·x + ‖a_k‖² (Z = [X x; xᵀ 1], Z₄₄ divided out) knows the
3 × 3 block X only by its trace s, and a Z ⪰ 0 with tr X = s exists exactly where s ≥ ‖x‖². The
semidefinite program over ten numbers is thus, without loss, a program over (x, s) with one
quadratic constraint; the tests compare it with the program over Z. Rule: where the optimum is not
unique (vehicles at one height leave s and the height of x exchangeable), the answer is the
analytic centre that an interior-point solver of the program over Z returns: there X − x xᵀ is a
multiple of the unit matrix, whose determinant is ((s − ‖x‖²)/3)³, hence the weight of three.
"""

from __future__ import annotations

import numpy as np

from groundstation.localization.batch import Batch
from groundstation.localization.interior import Constraints
from groundstation.localization.problem import FloatArray
from groundstation.localization.region import Region

_FIRST_SURPLUS = 0.25


def lifted_constraints(region: Region, unknowns: int = 4) -> Constraints:
    """Heights and outline over x, and s − ‖x‖² ≥ 0, over (x, s, …) with so many unknowns."""
    area = region.constraints(unknowns)
    slope, curvature = np.zeros((1, unknowns)), np.zeros((1, unknowns))
    slope[0, 3] = 1.0
    curvature[0, :3] = 2.0
    return Constraints(
        np.append(area.offset, 0.0),
        np.concatenate([area.slope, slope]),
        np.concatenate([area.curvature, curvature]),
        np.append(area.weight, 3.0),
    )


def lifted_start(batch: Batch, region: Region, position_enu_m: FloatArray) -> FloatArray:
    """(N, 4) scaled (x, s) at positions (N, 3), strictly inside."""
    at = region.inside(position_enu_m)
    square = np.square(region.scaled(batch.place) - at[:, None, :]).sum(axis=-1)
    return np.column_stack([at, np.square(at).sum(axis=1) + _FIRST_SURPLUS * square.min(axis=1) + 1e-9])


def relative_squares(batch: Batch, region: Region, log_gain: FloatArray) -> tuple[FloatArray, FloatArray]:
    """c_k² tr(C_k Z) as slopes (N, K, 4) over scaled (x, s) and offsets (N, K); 1 where link k fits.

    ``log_gain`` (N, K): ln c_k, c_k = m_k/m_t per metre.
    """
    place = region.scaled(batch.place)
    square = np.exp(2.0 * (log_gain + np.log(region.scale_m)))
    slope = np.concatenate([-2.0 * place, np.ones((*square.shape, 1))], axis=-1) * square[..., None]
    return slope, square * np.square(place).sum(axis=-1)
