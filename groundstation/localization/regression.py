"""The likelihood of many windows along flights: correlated rows, whitened into one regression.

Exists because the tracker weighs hundreds of windows that resemble each other, which the sum
over link states (``link_states``) cannot do. Rule: same model, same constants, same formulae as
``likelihood`` states them; with certain link states and unrelated rows both give the same number.

After ``whitening`` what remains is a linear regression at each candidate: power, offsets, β_LOS and
the antennas' null are integrated in closed form from running sums, β_NLOS over a few nodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from groundstation.localization.likelihood import ExponentGrid
from groundstation.localization.problem import FloatArray
from groundstation.localization.regression_solved import Solved, inverse_cholesky, log_density, log_sum
from groundstation.localization.regressors import Mixer, Regressors
from groundstation.localization.whitening import Observations, Whitened

_BLOCK = 48_000
"""Regressors (rows × candidates) taken in at once."""
_PAIR = ((0, 1, 3), (1, 2, 4), (3, 4, 5))
"""Where the product of two regressors (LOS, NLOS, null) stands in ``Evidence.path_path``."""


@dataclass(slots=True, eq=False)
class Evidence:
    """Running sums of the whitened regression at C candidates; ``add`` rows, read ``log_likelihood``."""

    level_level: float
    level_loading: FloatArray
    """(1 + V,)"""
    loading_loading: FloatArray
    """(1 + V, 1 + V), prior included."""
    level_path: FloatArray
    """(3, C): level × path loss of LOS, NLOS, × loss in the antennas' null."""
    path_path: FloatArray
    """(6, C): LOS·LOS, LOS·NLOS, NLOS·NLOS, LOS·null, NLOS·null, null·null."""
    loading_path: FloatArray
    """(3, 1 + V, C)."""
    angle_log: FloatArray
    """(N, C) log likelihood of the angles for each node of π, the share of LOS links."""
    count: int = 0
    """Rows taken in."""

    @classmethod
    def empty(cls, candidates: int, links: int, shares: int = 1) -> Evidence:
        """No evidence at ``candidates`` places from ``links`` links, for ``shares`` nodes of π."""
        return cls(
            0.0,
            np.zeros(1 + links),
            np.eye(1 + links),
            np.zeros((3, candidates)),
            np.zeros((6, candidates)),
            np.zeros((3, 1 + links, candidates)),
            np.zeros((shares, candidates)),
        )

    @property
    def candidates(self) -> int:
        """C."""
        return int(self.angle_log.shape[1])

    @classmethod
    def gathered(cls, parts: list[Evidence], place: Any) -> Evidence:
        """The same rows' evidence at candidates of several parts: ``place`` (C,) counts through them."""

        def joined(arrays: list[FloatArray]) -> FloatArray:
            result: FloatArray = np.concatenate(arrays, axis=-1).take(place, axis=-1)
            return result

        first = parts[0]
        return cls(
            first.level_level,
            first.level_loading,
            first.loading_loading,
            joined([part.level_path for part in parts]),
            joined([part.path_path for part in parts]),
            joined([part.loading_path for part in parts]),
            joined([part.angle_log for part in parts]),
            first.count,
        )

    def grow(self, links: int) -> None:
        """Make room for links not heard before."""
        more = 1 + links - self.level_loading.size
        if more <= 0:
            return
        self.level_loading = np.concatenate([self.level_loading, np.zeros(more)])
        size = self.loading_loading.shape[0]
        wider = np.eye(size + more)
        wider[:size, :size] = self.loading_loading
        self.loading_loading = wider
        pad = np.zeros((3, more, self.angle_log.shape[1]))
        self.loading_path = np.concatenate([self.loading_path, pad], axis=1)

    def add(
        self, observations: Observations, rows: Whitened, candidates: FloatArray, null: bool = False
    ) -> None:
        """Take in whitened rows; ``candidates`` (C, 3) metres ENU. ``null``: whether antennas have one."""
        if not rows.rows.size:
            return
        mixer = Mixer.of(observations, rows)
        at_once = max(_BLOCK // rows.rows.size, 1)
        self._add_levels(rows)
        for start in range(0, self.candidates, at_once):
            cells = slice(start, start + at_once)
            self._add_losses(rows, mixer.regressors(candidates[cells], null), cells)

    def add_regressors(self, rows: Whitened, regressors: Regressors) -> None:
        """``add``, where somebody has worked out the rows' ``regressors`` at all candidates already."""
        if rows.rows.size:
            self._add_levels(rows)
            self._add_losses(rows, regressors, slice(None))

    def _add_levels(self, rows: Whitened) -> None:
        self.count += int(rows.rows.size)
        self.level_level += float(rows.level @ rows.level)
        self.level_loading += rows.loading.T @ rows.level
        self.loading_loading += rows.loading.T @ rows.loading

    def _add_losses(self, rows: Whitened, regressors: Regressors, cells: slice) -> None:
        used: Any = np.flatnonzero(rows.loading.any(axis=0))
        part = np.concatenate([rows.level[None], rows.loading[:, used].T])
        # All at once needs no copy there and back.
        used = slice(None) if used.size == rows.loading.shape[1] else used
        for number, one in enumerate(regressors):
            if one is None:
                continue
            along = part @ one
            self.level_path[number, cells] += along[0]
            self.loading_path[number, used, cells] += along[1:]
            for other, two in enumerate(regressors[: number + 1]):
                if two is not None:
                    self.path_path[_PAIR[other][number], cells] += np.einsum("rc,rc->c", two, one)

    @staticmethod
    def loss_rows(
        observations: Observations, rows: Whitened, candidates: FloatArray, null: bool = False
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Whitened losses of each row at each candidate: path of LOS, path of NLOS, null; (r, C) each, dB."""
        nothing = np.zeros((rows.rows.size, candidates.shape[0]))
        los, nlos, deep = Mixer.of(observations, rows).regressors(candidates, null)
        return (
            nothing if los is None else los,
            nothing if nlos is None else nlos,
            nothing if deep is None else deep,
        )

    def state(self) -> dict[str, Any]:
        """As arrays and plain values."""
        result = {}
        for name in _SUMS:
            value = getattr(self, name)
            result[name] = value.copy() if isinstance(value, np.ndarray) else value
        return result

    @classmethod
    def restore(cls, tree: dict[str, Any]) -> Evidence:
        """The reverse."""
        arrays = {name: np.array(tree[name], dtype=np.float64) for name in _SUMS}
        return cls(**{**arrays, "level_level": float(tree["level_level"]), "count": int(tree["count"])})  # type: ignore[arg-type]

    def _reduced(self, cells: Any = slice(None)) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """The quadratic form's terms at ``cells`` with power and offsets integrated out.

        And what does that: the inverse of the Cholesky factor of ``loading_loading``.
        """
        inverse = inverse_cholesky(self.loading_loading)
        level = inverse @ self.level_loading
        cross, square = self.level_path[:, cells].copy(), self.path_path[:, cells].copy()
        # What is all zeros (no link in line of sight, no null) stays so.
        used = [number for number in range(3) if self.path_path[_PAIR[number][number]].any()]
        loads = {number: inverse @ self.loading_path[number][:, cells] for number in used}
        for number in used:
            cross[number] -= level @ loads[number]
            for other in used[: used.index(number) + 1]:
                square[_PAIR[other][number]] -= np.einsum("vc,vc->c", loads[other], loads[number])
        return self.level_level - float(level @ level), cross, square, inverse

    def log_likelihood_on_grid(
        self, exponents: ExponentGrid, noise_degrees: float | None = None
    ) -> FloatArray:
        """``log_likelihood`` as a plain sum over a grid: what the closed form is held against in tests.

        Antennas without a null, limits of β_NLOS as they stand.
        """
        constant, cross, square, _ = self._reduced()
        los, nlos = exponents.los[:, None], exponents.nlos[:, None]
        form = constant + 2.0 * (los * cross[0] + nlos * cross[1])
        form += los**2 * square[0] + 2.0 * los * nlos * square[1] + nlos**2 * square[2]
        score = exponents.log_prior[:, None] + log_density(form, self.count, noise_degrees)
        return log_sum(score) + self.log_of_angles()

    def log_likelihood(self, exponents: ExponentGrid, noise_degrees: float | None = None) -> FloatArray:
        """(C,) log likelihood of each candidate, up to a constant.

        β_LOS and the order of the antennas' null are Gaussian and integrated in closed form. Over
        β_NLOS, uniform, a few nodes are laid at each candidate where its likelihood there is: a
        long flight knows it better than any fixed grid over 1.5 to 8.

        ``noise_degrees`` None: the model's noise level is right. Else it may be higher, see
        ``log_density``: residuals larger than expected widen the belief.
        """
        return self.solved(exponents).log_likelihood(noise_degrees) + self.log_of_angles()

    def solved(self, exponents: ExponentGrid, cells: Any = slice(None)) -> Solved:
        """The regression at ``cells``, its Gaussian unknowns at their best."""
        constant, cross, square, whitener = self._reduced(cells)
        return Solved.of(exponents.model, self.count, whitener, constant, np.concatenate([cross, square]))

    def log_of_angles(self) -> FloatArray:
        """(C,); the nodes of π are equally likely."""
        return log_sum(self.angle_log) - math.log(self.angle_log.shape[0])

    def orders_drawn(self, candidates: Any, exponents: ExponentGrid, uniform: FloatArray) -> FloatArray:
        """(3, n) β_LOS, β_NLOS and null's order drawn from their posterior at n candidates.

        ``uniform`` (2, n) in [0, 1). β_LOS and order are their means given β_NLOS.
        """
        return self.solved(exponents, candidates).orders_drawn(uniform)

    def nuisances_at(
        self, candidate: int, los_exponent: float, nlos_exponent: float, null: float = 0.0
    ) -> FloatArray:
        """(1 + V,) posterior mean of power and offsets, in prior standard deviations."""
        right = (
            self.level_loading
            + los_exponent * self.loading_path[0, :, candidate]
            + nlos_exponent * self.loading_path[1, :, candidate]
            + null * self.loading_path[2, :, candidate]
        )
        return np.asarray(np.linalg.solve(self.loading_loading, right), dtype=np.float64)


_SUMS = tuple(field.name for field in fields(Evidence))
