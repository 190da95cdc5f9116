"""Losses at every candidate, whitened as the windows are: what the regression is on.

Exists apart from ``regression`` because this is where its time goes, and all of it: a product of
whitened rows and losses. Rule: a loss is worked out once for every window that a row or a parent
of it needs; what is zero everywhere is left out, not multiplied.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse

from groundstation.localization.likelihood import DB_OF_LOG, log_squares
from groundstation.localization.problem import FloatArray
from groundstation.localization.whitening import Observations, Whitened

_FEW_ROWS = 64
"""Up to here, setting up a sparse matrix costs more than it saves."""


@dataclass(frozen=True, slots=True, eq=False)
class Mixer:
    """How r whitened rows mix the losses of the m windows that they and their parents are."""

    place_enu_m: FloatArray
    """(m, 3)"""
    los: Any
    """(r, m) weights of the path losses as LOS links'; None: no link is in line of sight."""
    nlos: Any
    """(r, m) as NLOS links'; None: all are in line of sight."""
    whole: Any
    """(r, m) weights of a loss that all links have."""

    @classmethod
    def of(cls, observations: Observations, rows: Whitened) -> Mixer:
        """Of whitened ``rows`` of ``observations``."""
        parents = observations.parents[rows.rows]
        family = np.concatenate([rows.rows[:, None], np.where(parents >= 0, parents, 0)], axis=1)
        wanted = np.zeros(observations.count, dtype=bool)
        wanted[family] = True
        needed = np.flatnonzero(wanted)
        where = (np.cumsum(wanted) - 1)[family]
        shape = (rows.rows.size, needed.size)
        index = np.arange(shape[0])[:, None]

        def table(weights: FloatArray) -> Any:
            if shape[0] <= _FEW_ROWS:
                flat = (index * shape[1] + where).ravel()
                full = np.bincount(flat, weights.ravel(), shape[0] * shape[1])
                return full.astype(np.float32).reshape(shape)
            # Few entries a row: a sparse product costs a hundredth of the dense one.
            at = np.broadcast_to(index, where.shape).ravel()
            entries = weights.ravel().astype(np.float32)
            return scipy.sparse.csr_array((entries, (at, where.ravel())), shape=shape)

        p = observations.los_probability[needed]
        return cls(
            observations.position_enu_m[needed],
            table(rows.mixing * p[where]) if p.any() else None,
            table(rows.mixing * (1.0 - p[where])) if (p < 1.0).any() else None,
            table(rows.mixing),
        )

    def regressors(self, candidates: FloatArray, null: bool) -> list[FloatArray | None]:
        """(r, C) whitened losses: path as LOS, path as NLOS, null; None = all zero."""
        path, deep = log_squares(self.place_enu_m, candidates, null)

        def mixed(table: Any, loss: Any) -> FloatArray | None:
            if table is None or loss is None:
                return None
            # Into dB, and double precision, only here: the rows are fewer than the windows that they mix.
            result: FloatArray = np.multiply(table @ loss, DB_OF_LOG, dtype=np.float64)
            return result

        return [mixed(self.los, path), mixed(self.nlos, path), mixed(self.whole, deep)]
