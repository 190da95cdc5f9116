"""Losses at every candidate, whitened as the windows are: what the regression is on.

Exists apart from ``regression`` because this is where its time goes: losses, and products of whitened
rows and losses. Rules: a loss is worked out once for every window that a row or a parent of it needs
(``Mixer``: many rows at once), or once for all (``Losses``: few rows at a time, whose parents were
parents before); what is zero everywhere is left out, not multiplied.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse

from groundstation.localization.likelihood import DB_OF_LOG, log_squares, logs_of_squares
from groundstation.localization.problem import FloatArray
from groundstation.localization.whitening import Observations, Whitened

_FEW_ROWS = 64
"""Up to here, setting up a sparse matrix costs more than it saves."""
_BLOCK = 48_000
"""Losses (windows × candidates) worked out at once: more does not stay in the processor's cache."""

Regressors = tuple[FloatArray | None, FloatArray | None, FloatArray | None]
"""(r, C) whitened losses, dB: path as LOS, path as NLOS, null; None = all zero."""


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

    def regressors(self, candidates: FloatArray, null: bool) -> Regressors:
        """Whitened losses of each row at ``candidates`` (C, 3), metres ENU."""
        tables = self.los, self.nlos, self.whole if null else None
        count = candidates.shape[0]
        at_once = max(_BLOCK // max(self.place_enu_m.shape[0], 1), 1)
        los, nlos, deep = (
            None if table is None else np.empty((self.whole.shape[0], count)) for table in tables
        )
        for start in range(0, count, at_once):
            cells = slice(start, start + at_once)
            losses = log_squares(self.place_enu_m, candidates[cells], null)
            for table, loss, result in zip(tables, (0, 0, 1), (los, nlos, deep), strict=True):
                if result is not None:
                    # Into dB, and double precision, only here: the rows are fewer than the windows they mix.
                    np.multiply(table @ losses[loss], DB_OF_LOG, out=result[:, cells])
        return los, nlos, deep


class Losses:
    """Losses of n windows at C candidates, kept, in single precision: 8 bytes each with a null, else 4."""

    def __init__(self, candidates: FloatArray, null: bool) -> None:
        # From one origin, so that it does not matter which windows come together.
        self._origin = candidates.mean(axis=0)
        self._there = (candidates - self._origin).astype(np.float32).T.copy()
        self._kept: Any = np.empty((1 + null, 0, candidates.shape[0]), np.float32)
        """(1 or 2, at least n, C) as ``logs_of_squares`` gives them."""
        self._row: Any = np.zeros(0, dtype=np.int64)
        """(n,) where among them each window's are: they stay there while others are forgotten."""

    @property
    def count(self) -> int:
        """n."""
        return int(self._row.size)

    def add(self, place_enu_m: FloatArray) -> None:
        """Take in windows heard at ``place_enu_m`` (m, 3), metres."""
        count, more = self.count, place_enu_m.shape[0]
        kinds, room, cells = self._kept.shape
        if count + more > room:
            wider = np.empty((kinds, max(count + more, 2 * room), cells), np.float32)
            wider[:, :room] = self._kept
            self._kept = wider
        free = np.ones(self._kept.shape[1], dtype=bool)
        free[self._row] = False
        rows = np.flatnonzero(free)[:more]
        self._row = np.concatenate([self._row, rows])
        here = (place_enu_m - self._origin).astype(np.float32)
        at_once = max(_BLOCK // max(cells, 1), 1)
        for start in range(0, more, at_once):
            some = slice(start, start + at_once)
            self._kept[:, rows[some]] = self._worked_out(here[some])

    def _worked_out(self, here: Any) -> Any:
        """(1 or 2, m, C) of windows heard at ``here`` (m, 3), from the origin."""
        result = np.empty((len(self._kept), here.shape[0], self._there.shape[1]), np.float32)
        # Without a null both are one array.
        square, flat = result[0], result[-1]
        np.subtract(self._there[0], here[:, 0, None], out=flat)
        flat *= flat
        gap = self._there[1] - here[:, 1, None]
        gap *= gap
        flat += gap
        np.subtract(self._there[2], here[:, 2, None], out=gap)
        gap *= gap
        np.add(flat, gap, out=square)
        logs_of_squares(square, flat, len(result) == 2)
        return result

    def forget(self, dropped: Any) -> None:
        """Let go of the windows ``dropped``, by number."""
        self._row = np.delete(self._row, dropped)

    def regressors(self, observations: Observations, rows: Whitened) -> Regressors:
        """As ``Mixer.regressors``, of ``rows`` of the windows taken in, which ``observations`` are."""
        if not rows.rows.size:
            return None, None, None
        family = np.concatenate([rows.rows[:, None], np.maximum(observations.parents[rows.rows], 0)], axis=1)
        p = observations.los_probability[family]
        found: dict[int, FloatArray] = {}
        where = self._row[family].ravel()
        of_paths = {number: share for number, share in ((0, p), (1, 1.0 - p)) if share.any()}
        for kind, shares in enumerate((of_paths, {2: np.ones_like(p)})[: len(self._kept)]):
            weights = np.stack([rows.mixing * share for share in shares.values()], axis=1)
            losses = self._kept[kind].take(where, axis=0).reshape(*family.shape, -1)
            mixed = (DB_OF_LOG * weights).astype(np.float32) @ losses
            # In double precision only here: the rows are fewer than the windows that they mix.
            found |= {number: mixed[:, place].astype(np.float64) for place, number in enumerate(shares)}
        return found.get(0), found.get(1), found.get(2)
