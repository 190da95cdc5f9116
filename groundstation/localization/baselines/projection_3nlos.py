"""``projection-3nlos``: the paper's "Proj-on-LOS with 3 NLOS RSS" (Section V-C), as described.

Exists as the paper's own simpler variant of its mixed method. Rule: the NLOS powers alone give
a place, which is then always projected, (74)–(75); the LOS link's power is not used, nothing
is tested, and the ray may end under the ground or outside the area, as printed.
"""

from __future__ import annotations

from dataclasses import replace

from groundstation.localization.baselines.nlos_part import nlos_part
from groundstation.localization.batch import Answers, Batch
from groundstation.localization.rays import Rays


def projection_3nlos(batch: Batch) -> Answers:
    """Iterative LSRE–SOCP on the NLOS links, projected onto the LOS ray."""
    free = nlos_part(batch)
    rays = Rays.of(batch)
    return replace(free, position_enu_m=rays.at(rays.along_m(free.position_enu_m)))
