"""``angle-reconstruction``: the paper's "Angle Reconstruction with WLS-Tay" (Section V-C).

Exists as a baseline of the mixed environment. The NLOS powers give x̂, P̂_t and β̂ by iterative
LSRE–SOCP; each link without a usable angle is given the bearing from its vehicle to x̂, and
each link a distance (the NLOS links ‖x̂ − a_k‖, the LOS links what their power tells at P̂_t
and β_LOS); angles and distances then go through WLS-Taylor (30)–(51) as if all were LOS.
Rule: as described, so the weights take the made-up angles to be as good as measured ones
(σ_θ, σ_φ, σ_s of the model); neither height limits nor area bound the answer.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from groundstation.localization.baselines.nlos_part import nlos_part
from groundstation.localization.batch import Answers, Batch
from groundstation.localization.wls import WlsInput, positions


def angle_reconstruction(batch: Batch) -> Answers:
    """WLS-Taylor on all links, those without a usable angle given the bearing of the NLOS solution."""
    first = nlos_part(batch)
    measured, links, model = batch.bearing_usable(), batch.links, batch.model
    offset = first.position_enu_m[:, None, :] - batch.place
    azimuth = np.arctan2(offset[..., 1], offset[..., 0])
    elevation = np.arctan2(offset[..., 2], np.hypot(offset[..., 0], offset[..., 1]))
    log_distance = np.log10(batch.distances_m(first.position_enu_m))
    told = (first.transmit_power_dbm[:, None] - batch.received_dbm()) / (10.0 * model.los_exponent)
    log_distance = np.where(batch.los(), told, log_distance)
    # WLS takes distance ratios from powers at β_LOS: these are the powers that tell our distances.
    power = -10.0 * model.los_exponent * log_distance
    problem = WlsInput(
        batch.place,
        power,
        np.where(measured, links.azimuth_rad, azimuth),
        np.where(measured, links.elevation_rad, elevation),
    )
    position = positions(problem, model)
    status = list(first.status)
    for row in np.flatnonzero(~np.isfinite(position).all(axis=1)):
        status[row] = "the bearings are parallel; vehicles in different directions are needed"
    return replace(first, position_enu_m=position, status=status)
