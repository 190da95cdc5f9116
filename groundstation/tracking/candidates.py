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

    def take(self, observations: Observations, first: int, whitened: list[Whitened], links: int) -> None:
        """Take in the windows from row ``first`` on: ``whitened`` are their powers, in groups."""
        before = self.evidence.count
        for rows in whitened:
            self.evidence.add(
                observations, rows.of_links(links), self.mesh.center_enu_m, self._model.has_antenna_null
            )
        self.bearings.grow(links, self._model)
        self.bearings.add(observations, first, self.mesh, self._model, self.evidence.angle_log)
        self.log_likelihood = self._told(self.evidence)
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
        parts: list[Evidence] = []
        bearings: list[Bearings] = []
        told: list[FloatArray] = []
        told_otherwise: list[FloatArray] = []

        def evaluate(mesh: Mesh, _: IntArray) -> tuple[FloatArray, float]:
            place = np.array([old.get(key, -1) for key in _keys(mesh)] if old else [-1] * mesh.count)
            new = mesh.keep(np.flatnonzero(place < 0))
            part, errors = self._weighed(observations, every, rows, links, new)
            if new.count < mesh.count:
                place[place < 0] = self.mesh.count + np.arange(new.count)
                part = Evidence.gathered([self.evidence, part], place)
                errors = Bearings.gathered([self.bearings, errors], place)
            parts.append(part)
            bearings.append(errors)
            told.append(self._told(part))
            told_otherwise.append(fields_at(mesh))
            return told[-1] + told_otherwise[-1], 1.0

        found = refine(area, evaluate, settings)
        self.mesh, self.gone = found.mesh, _NO_BOX
        self.log_likelihood = np.concatenate(told)[found.place]
        self.evidence = Evidence.gathered(parts, found.place)
        self.bearings = Bearings.gathered(bearings, found.place)
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
        return kept

    def found_again(
        self,
        total: FloatArray,
        observations: Observations,
        rows: Whitened,
        links: int,
        fields_at: Callable[[Mesh], FloatArray],
    ) -> bool:
        """Whether a box that was let go may hold something by now; ``total`` as in ``let_go``."""
        if not self.gone.count:
            return False
        best = self.mesh.keep(np.array([int(np.argmax(total))]))
        every = np.arange(observations.count)
        likely = self.gone
        for stride in _STRIDES:
            windows = every[::stride]
            mesh = joined([best, likely])
            # Both by the windows remembered: the running sums hold forgotten ones too.
            powers = rows.take(np.isin(rows.rows, windows, assume_unique=True))
            score = self._told(self._weighed(observations, windows, powers, links, mesh)[0]) + fields_at(mesh)
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
