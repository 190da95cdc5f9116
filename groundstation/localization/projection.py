"""Label-aware projection onto the one LOS ray, eqs. (71)–(76): as printed, and mended.

Exists because one trusted bearing is worth more than three powers through rubble. As
printed, J of (76) is taken after (68) has made every residual zero, so the test accepts
nothing. What is mended, each for a defect of the print:

- The test: both candidates are judged by the same fit, power and one shared NLOS exponent
  refitted at each with their priors, and the projection is taken unless it raises χ² by more
  than the two coordinates that it gives up explain (the 99 % point with two degrees of
  freedom).
- The ray: it ends where the target's height limits end it, and what clipping to the area then
  moves it off the bearing counts in χ². A ray that never reaches where a target may be is so
  refused.
- The refusal: a bearing that is refused is a label that is not believed, so the answer is that
  of (73) with the link as NLOS.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.localization.batch import Answers, Batch
from groundstation.localization.lsre_literal import lsre_socp, lsre_socp_iterative
from groundstation.localization.rays import Rays
from groundstation.localization.refit import misfit, refit_power_and_exponent

_CHI2_TWO_99 = 9.21
REFUSED = "ok, projection refused by the powers"
"""Status of an answer that is not on the ray, the label being contradicted."""


def projection_label_aware(batch: Batch) -> Answers:
    """One LSRE–SOCP solve (73), projected onto the LOS ray unless powers and area forbid it."""
    rays = Rays.of(batch)
    free = lsre_socp(batch).position_enu_m
    along = rays.along_within_heights_m(free, batch.area)
    projected = batch.area.clip(rays.at(along))
    raised = misfit(batch, projected) + rays.angle_misfit(projected, batch.model) - misfit(batch, free)
    accepted = raised <= _CHI2_TWO_99
    position = projected
    power, exponent = refit_power_and_exponent(batch, projected)
    refused = np.flatnonzero(~accepted)
    if refused.size:
        doubted = _as_nlos(batch.rows(refused), rays.link[refused])
        position[refused] = lsre_socp(doubted).position_enu_m
        power[refused], exponent[refused] = refit_power_and_exponent(doubted, position[refused])
    answers = Answers.closed_form(batch, position, power, exponent)
    status = list(answers.status)
    for row in refused:
        status[row] = REFUSED if status[row] == "ok" else status[row]
    return replace(answers, status=status)


def _as_nlos(batch: Batch, link: NDArray[np.int64]) -> Batch:
    """The same problems with one link (N,) of each labelled NLOS."""
    probability = batch.links.los_probability.copy()
    probability[np.arange(batch.size), link] = 0.0
    return replace(batch, links=replace(batch.links, los_probability=probability))


def projection_label_aware_literal(batch: Batch) -> Answers:
    """(73)–(76) as printed: J with the P̂_t and β̂ that (67)–(68) left, which makes the test vacuous.

    (66)–(69) are printed for every k: (68) then leaves J = 0 at the free solution whatever it
    is, and no other place can be as good. Were β_LOS kept on the LOS link through (68), J
    would be that one link's squared residual, and with (70) holding P̂_t back a large one now
    and then lets a projection through: chance, not a test of the label.
    """
    free = lsre_socp_iterative(batch, every_link=True)
    rays = Rays.of(batch)
    projected = rays.at(rays.along_m(free.position_enu_m))
    power, exponent = free.transmit_power_dbm, free.path_loss_exponent
    cost = batch.rss_cost_db2(free.position_enu_m, power, exponent)
    raised = batch.rss_cost_db2(projected, power, exponent)
    accepted = raised <= (1.0 + batch.model.projection_tolerance) * cost
    return replace(free, position_enu_m=np.where(accepted[:, None], projected, free.position_enu_m))
