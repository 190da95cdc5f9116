"""The boxes of a belief, and what all windows say of each: what a window's cost is spent on.

Exists so that ``belief`` decides what counts and when, and the boxes' sums are kept here. Rules: a
window goes into every box that stands; a box that was there before keeps its sums where they are
still those of the remembered windows; and a box that holds nothing, away from all that hold anything,
is let go, looked at again now and then, and back as soon as it might hold something.

Letting go is safe while the model is right: what share of the belief some boxes hold is a martingale,
so that a share m grows to c with a chance of m/c at most (Ville's inequality); e⁻⁴⁰ a place never
returns. ``found_again`` is for when the model is wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np

from groundstation.localization.bearings import Bearings
from groundstation.localization.likelihood import ExponentGrid
from groundstation.localization.mesh import IntArray, Mesh, MeshSettings, joined, refine
from groundstation.localization.problem import BoolArray, FloatArray, SearchArea, SignalModel
from groundstation.localization.regression import Evidence
from groundstation.localization.regression_solved import Solved
from groundstation.localization.regressors import Losses, Regressors
from groundstation.localization.whitening import Observations, Whitened

_NOTHING = 40.0
"""A box is let go whose density is e⁻⁴⁰ of the highest …"""
_SOMETHING = 10.0
"""… and comes back when it is e⁻¹⁰ of it, by the windows remembered."""
_STRIDES = (13, 3, 1)
"""Looking, one window in thirteen comes first, then one in three: all of them only where that leaves a box
likely enough."""
_WORTH_IT = 0.25
"""Boxes are let go when that is so large a share of them: copying the rest costs something too."""
_TRIED_EVERY = 100
"""Powers between two attempts."""


class Candidates:
    """See the module."""

    def __init__(self, model: SignalModel, exponents: ExponentGrid, noise_degrees: float | None) -> None:
        self._model, self._exponents, self._noise_degrees = model, exponents, noise_degrees
        self.mesh = _NO_BOX
        """The boxes, C of them."""
        self.gone = _NO_BOX
        """Those that were let go."""
        self.evidence = Evidence.empty(0, 0, len(model.los_shares))
        """The running sums of the powers at ``mesh``."""
        self.bearings = Bearings.empty(0, 0, model)
        """What is known of the vehicles' constant errors there."""
        self.log_likelihood: FloatArray = np.zeros(0)
        """(C,) of all windows, up to a constant."""
        self._to_be_tried = False
        self._solved: Solved | None = None
        self._losses: Losses | None = None

    @property
    def solved(self) -> Solved:
        """The regression of ``evidence``."""
        if self._solved is None:
            self._solved = self.evidence.solved(self._exponents)
        return self._solved

    def regressors(self, observations: Observations, rows: Whitened) -> Regressors:
        """Of ``rows`` of the windows remembered, at the boxes."""
        if self._losses is None:
            self._losses = Losses(self.mesh.center_enu_m, self._model.has_antenna_null)
        self._losses.add(observations.position_enu_m[self._losses.count :])
        return self._losses.regressors(observations, rows)

    def forget(self, dropped: IntArray) -> None:
        """The windows ``dropped`` are remembered no more; they stay in the sums."""
        if self._losses is not None:
            self._losses.forget(dropped)

    def rest(self) -> None:
        """Free what can be worked out again: losses are kept for the next windows only."""
        self._losses = self._solved = None

    def grow(self, links: int) -> None:
        """Make room for vehicles not heard before."""
        if links >= self.evidence.level_loading.size:
            self.evidence.grow(links)
            self._solved = None
        self.bearings.grow(links, self._model)

    def take(
        self, observations: Observations, first: int, powers: list[tuple[Whitened, Regressors]], links: int
    ) -> None:
        """Take in the windows from row ``first`` on: their ``powers``, in groups, with their regressors."""
        before = self.evidence.count
        self.grow(links)
        for rows, regressors in powers:
            self.evidence.add_regressors(rows.of_links(links), regressors)
        self.bearings.add(observations, first, self.mesh, self._model, self.evidence.angle_log)
        self._solved = None
        self.log_likelihood = self.solved.log_likelihood(self._noise_degrees) + self.evidence.log_of_angles()
        self._to_be_tried = before // _TRIED_EVERY != self.evidence.count // _TRIED_EVERY

    def lay(
        self,
        area: SearchArea,
        settings: MeshSettings,
        observations: Observations,
        rows: Whitened,
        links: int,
        fields_at: Callable[[Mesh], FloatArray],
        reuse: bool,
    ) -> FloatArray:
        """Lay the boxes anew over the area and weigh all windows on them.

        ``reuse``: boxes that are there keep their sums, for the windows are the same. ``fields_at``: log
        likelihood of boxes that no window states; returns it for the boxes laid, (C,).
        """
        every = np.arange(observations.count)
        old = {key: number for number, key in enumerate(_keys(self.mesh))} if reuse else {}
        sums, errors = ([self.evidence], [self.bearings]) if old else ([], [])
        # Of all boxes evaluated: where in ``sums`` they are, and what they are told, otherwise too.
        slots: list[IntArray] = []
        told: list[FloatArray] = []
        told_otherwise: list[FloatArray] = []

        def evaluate(mesh: Mesh, _: IntArray) -> tuple[FloatArray, float]:
            slot, log = np.full(mesh.count, -1), np.empty(mesh.count)
            if old:
                slot[:] = [old.get(key, -1) for key in _keys(mesh)]
                known = slot >= 0
                log[known] = self.log_likelihood[slot[known]]
            new = np.flatnonzero(slot < 0)
            if new.size:
                slot[new] = sum(part.candidates for part in sums) + np.arange(new.size)
                evidence, bearings = self._weighed(observations, every, rows, links, mesh.keep(new))
                sums.append(evidence)
                errors.append(bearings)
                log[new] = self._told(evidence)
            slots.append(slot)
            told.append(log)
            told_otherwise.append(fields_at(mesh))
            return log + told_otherwise[-1], 1.0

        found = refine(area, evaluate, settings)
        slot = np.concatenate(slots)[found.place]
        self.mesh, self.gone = found.mesh, _NO_BOX
        self.log_likelihood = np.concatenate(told)[found.place]
        self.evidence = Evidence.gathered(sums, slot)
        self.bearings = Bearings.gathered(errors, slot)
        self._solved = self._losses = None
        return np.concatenate(told_otherwise)[found.place]

    def let_go(self, total: FloatArray) -> IntArray | None:
        """Let go of boxes that hold nothing by their log density ``total`` (C,), fields included.

        Returns the numbers of those kept; None: all are.
        """
        if not self._to_be_tried:
            return None
        empty = total < total.max() - _NOTHING
        if empty.sum() <= _WORTH_IT * empty.size:
            return None
        # Boxes beside the belief stay: their centres say little of their nearest edges.
        empty &= ~_beside(self.mesh, empty)
        if empty.sum() <= _WORTH_IT * empty.size:
            return None
        kept = np.flatnonzero(~empty)
        self.gone = joined([self.gone, self.mesh.keep(empty)])
        self.mesh = self.mesh.keep(kept)
        self.evidence = Evidence.gathered([self.evidence], kept)
        self.bearings = Bearings.gathered([self.bearings], kept)
        self.log_likelihood = self.log_likelihood[kept]
        self._solved = self._losses = None
        return kept

    def found_again(
        self,
        total: FloatArray,
        windows: int,
        told: Callable[[IntArray], tuple[Observations, Whitened]],
        links: int,
        fields_at: Callable[[Mesh], FloatArray],
    ) -> bool:
        """Whether a box that was let go may hold something by now; ``total`` as in ``let_go``.

        ``windows`` are remembered; ``told`` gives all, some of them related and their powers whitened.
        """
        if not self.gone.count:
            return False
        best = self.mesh.keep(np.array([int(np.argmax(total))]))
        likely = self.gone
        for stride in _STRIDES:
            mesh = joined([best, likely])
            some = np.arange(0, windows, stride)
            observations, powers = told(some)
            # Both by the windows remembered: the running sums hold forgotten ones too.
            score = self._told(self._weighed(observations, some, powers, links, mesh)[0]) + fields_at(mesh)
            likely = likely.keep(np.flatnonzero(score[1:] > score[0] - _SOMETHING))
            if not likely.count:
                return False
        return True

    def state(self) -> dict[str, Any]:
        """As arrays and plain values."""
        return {
            **{name: getattr(self.mesh, name).copy() for name in _BOXES},
            **{f"gone_{name}": getattr(self.gone, name).copy() for name in _BOXES},
            "log_likelihood": self.log_likelihood.copy(),
            **self.evidence.state(),
            **self.bearings.state(),
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what ``state`` gave."""
        self.mesh = _mesh_of(tree)
        self.gone = _mesh_of(tree, "gone_") if "gone_log_volume" in tree else _NO_BOX
        self.log_likelihood = np.array(tree["log_likelihood"], dtype=np.float64)
        self.evidence, self.bearings = Evidence.restore(tree), Bearings.restore(tree)
        self._solved = self._losses = None

    def _weighed(
        self, observations: Observations, windows: Any, rows: Whitened, links: int, mesh: Mesh
    ) -> tuple[Evidence, Bearings]:
        """What ``windows``, ``rows`` of whitened powers, say at boxes that have been told nothing yet."""
        evidence = Evidence.empty(mesh.count, links, len(self._model.los_shares))
        evidence.add(observations, rows, mesh.center_enu_m, self._model.has_antenna_null)
        bearings = Bearings.empty(mesh.count, links, self._model)
        if windows.size < observations.count:
            observations = observations.take(windows)
        bearings.add(observations, 0, mesh, self._model, evidence.angle_log)
        return evidence, bearings

    def _told(self, evidence: Evidence) -> FloatArray:
        return evidence.log_likelihood(self._exponents, self._noise_degrees)


def _beside(mesh: Mesh, empty: BoolArray) -> BoolArray:
    """(C,) which of the ``empty`` boxes lie no further than half their width from one that is not."""
    full = np.flatnonzero(~empty)
    result = np.zeros(mesh.count, dtype=bool)
    half = mesh.half_m[:, [0, 0, 1]]
    # A few at a time: boxes × boxes are many.
    for some in np.array_split(np.flatnonzero(empty), 1 + empty.size // 256):
        close = np.ones((some.size, full.size), dtype=bool)
        for axis in range(3):
            apart = np.abs(mesh.center_enu_m[some, axis, None] - mesh.center_enu_m[full, axis])
            close &= apart <= 2.0 * half[some, axis, None] + half[full, axis]
        result[some] = close.any(axis=1)
    return result


def _keys(mesh: Mesh) -> list[bytes]:
    """What tells boxes apart: those that are cut from the same base boxes have the same bits."""
    rows = np.ascontiguousarray(np.column_stack([mesh.center_enu_m, mesh.half_m[:, :1]]))
    result: list[bytes] = rows.view("V32").ravel().tolist()
    return result


def _mesh_of(tree: dict[str, Any], prefix: str = "") -> Mesh:
    center, half, volume = (np.array(tree[prefix + name], dtype=np.float64) for name in _BOXES)
    return Mesh(center.reshape(-1, 3), half.reshape(-1, 2), volume.reshape(-1))


_BOXES = tuple(field.name for field in fields(Mesh))
_NO_BOX = Mesh(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0))
