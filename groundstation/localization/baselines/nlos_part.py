"""Iterative LSRE–SOCP on the links labelled NLOS alone: the first half of two mixed baselines.

Exists because "Proj-on-LOS with 3 NLOS RSS" and "angle reconstruction" both start from it
(the paper, Section V-C). Rule: the program and its iteration are those of
``lsre-socp-iterative``, as printed; K may be any number, not only 3 + 1.
"""

from __future__ import annotations

import numpy as np

from groundstation.localization.batch import Answers, Batch, selected
from groundstation.localization.lsre_literal import lsre_socp_iterative


def nlos_part(batch: Batch) -> Answers:
    """Answers from the NLOS links of each problem; β̂ of links labelled LOS is β_LOS."""
    position = np.full((batch.size, 3), np.nan)
    power = np.full(batch.size, np.nan)
    exponent = batch.first_exponents()
    rounds = np.zeros(batch.size, dtype=np.int64)
    status = [""] * batch.size
    for rows, columns in selected(~batch.los()):
        part = lsre_socp_iterative(batch.rows(rows).with_links(columns))
        position[rows], power[rows] = part.position_enu_m, part.transmit_power_dbm
        rounds[rows] = part.iterations
        exponent[rows[:, None], columns] = part.path_loss_exponent
        for number, row in enumerate(rows):
            status[row] = part.status[number]
    return Answers(position, power, exponent, rounds, status)
