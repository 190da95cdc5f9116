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
from groundstation.localization.problem import FloatArray, SignalModel
from groundstation.localization.regressors import Mixer
from groundstation.localization.whitening import Observations, Whitened

_BLOCK = 48_000
"""Losses (windows × candidates) worked out at once: more does not stay in the processor's cache."""
_PAIR = ((0, 1, 3), (1, 2, 4), (3, 4, 5))
"""Where the product of two regressors (LOS, NLOS, null) stands in ``Evidence.path_path``."""
_NODES = 5
_MIDDLES = (np.arange(_NODES)[:, None] + 0.5).astype(np.float64)
_REACH = 3.2
"""Nodes over β_NLOS reach to so many standard deviations: 1.3 apart, where the midpoint rule errs by 1e-5."""
_STEEP = 1.5
_DOUBTS = 4.0
"""β_NLOS is followed beyond its limits until its prior has fallen by e⁻⁴."""
_LEAST_CURVE = 1e-9


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
        self.count += int(rows.rows.size)
        self.level_level += float(rows.level @ rows.level)
        self.level_loading += rows.loading.T @ rows.level
        self.loading_loading += rows.loading.T @ rows.loading
        used: Any = np.flatnonzero(rows.loading.any(axis=0))
        part = np.concatenate([rows.level[None], rows.loading[:, used].T])
        # All at once needs no copy there and back.
        used = slice(None) if used.size == rows.loading.shape[1] else used
        mixer = Mixer.of(observations, rows)
        at_once = max(_BLOCK // mixer.place_enu_m.shape[0], 1)
        for start in range(0, self.candidates, at_once):
            cells = slice(start, start + at_once)
            regressors = mixer.regressors(candidates[cells], null)
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

    def _reduced(self, cells: Any = slice(None)) -> tuple[float, FloatArray, FloatArray]:
        """The quadratic form's terms at ``cells`` with power and offsets integrated out."""
        factor = np.linalg.cholesky(self.loading_loading)
        inverse = np.linalg.inv(factor)
        level = inverse @ self.level_loading
        cross, square = self.level_path[:, cells].copy(), self.path_path[:, cells].copy()
        # What is all zeros (no link in line of sight, no null) stays so.
        used = [number for number in range(3) if self.path_path[_PAIR[number][number]].any()]
        loads = {number: inverse @ self.loading_path[number][:, cells] for number in used}
        for number in used:
            cross[number] -= level @ loads[number]
            for other in used[: used.index(number) + 1]:
                square[_PAIR[other][number]] -= np.einsum("vc,vc->c", loads[other], loads[number])
        return self.level_level - float(level @ level), cross, square

    def log_likelihood_on_grid(
        self, exponents: ExponentGrid, noise_degrees: float | None = None
    ) -> FloatArray:
        """``log_likelihood`` as a plain sum over a grid: what the closed form is held against in tests.

        Antennas without a null, limits of β_NLOS as they stand.
        """
        constant, cross, square = self._reduced()
        los, nlos = exponents.los[:, None], exponents.nlos[:, None]
        form = constant + 2.0 * (los * cross[0] + nlos * cross[1])
        form += los**2 * square[0] + 2.0 * los * nlos * square[1] + nlos**2 * square[2]
        score = exponents.log_prior[:, None] + _log_density(form, self.count, noise_degrees)
        return _log_sum(score) + self._log_of_angles()

    def log_likelihood(self, exponents: ExponentGrid, noise_degrees: float | None = None) -> FloatArray:
        """(C,) log likelihood of each candidate, up to a constant.

        β_LOS and the order of the antennas' null are Gaussian and integrated in closed form. Over
        β_NLOS, uniform, a few nodes are laid at each candidate where its likelihood there is: a
        long flight knows it better than any fixed grid over 1.5 to 8.

        ``noise_degrees`` None: the model's noise level is right. Else it may be higher, see
        ``_log_density``: residuals larger than expected widen the belief.
        """
        prior = exponents.model
        constant, slope, curve, log_spread, _ = self._of_nlos_exponent(prior, slice(None))
        nodes, width = self._nlos_nodes(constant, slope, curve, prior, noise_degrees)
        form = constant + nodes * (2.0 * slope + nodes * curve)
        score = _log_density(form, self.count, noise_degrees)
        if prior.nlos_exponent_doubt > 0.0:
            score = score + _log_prior_of_nlos_exponent(nodes, prior)
        return _log_sum(score) + np.log(width) - log_spread + self._log_of_angles()

    def _of_nlos_exponent(
        self, prior: SignalModel, cells: Any
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, Any]:
        """The form at ``cells`` as a + 2 b β_NLOS + c β_NLOS², the Gaussian unknowns at their best.

        Then half the log determinant that integrating these out costs, and what their means are:
        (intercept, slope on β_NLOS) of β_LOS and of the null's order.
        """
        constant, cross, square = self._reduced(cells)
        ll, ln, nn, lg, ng, gg = square
        mean, std = (
            (prior.los_exponent, prior.antenna_null_mean),
            (
                prior.los_exponent_std,
                prior.antenna_null_std,
            ),
        )
        a = constant + 2.0 * (mean[0] * cross[0] + mean[1] * cross[2])
        a = a + mean[0] ** 2 * ll + 2.0 * mean[0] * mean[1] * lg + mean[1] ** 2 * gg
        b = cross[1] + mean[0] * ln + mean[1] * ng
        c = nn
        # Each in prior standard deviations u: form + u² = … + 2 u (k₀ + k₁ β) + u² w.
        first = std[0] * (cross[0] + mean[0] * ll + mean[1] * lg), std[0] * ln, 1.0 + std[0] ** 2 * ll
        second = std[1] * (cross[2] + mean[0] * lg + mean[1] * gg), std[1] * ng, 1.0 + std[1] ** 2 * gg
        both = std[0] * std[1] * lg
        k0 = second[0] - both * first[0] / first[2]
        k1 = second[1] - both * first[1] / first[2]
        w = second[2] - both * both / first[2]
        a = a - first[0] ** 2 / first[2] - k0 * k0 / w
        b = b - first[0] * first[1] / first[2] - k0 * k1 / w
        c = c - first[1] ** 2 / first[2] - k1 * k1 / w
        u2 = -k0 / w, -k1 / w
        u1 = -(first[0] + both * u2[0]) / first[2], -(first[1] + both * u2[1]) / first[2]
        means = (
            (mean[0] + std[0] * u1[0], std[0] * u1[1]),
            (mean[1] + std[1] * u2[0], std[1] * u2[1]),
        )
        return a, b, np.maximum(c, _LEAST_CURVE), 0.5 * np.log(first[2] * w), means

    def _nlos_nodes(
        self,
        constant: FloatArray,
        slope: FloatArray,
        curve: FloatArray,
        prior: SignalModel,
        noise_degrees: float | None,
    ) -> tuple[FloatArray, FloatArray]:
        """(M, C) midpoints over where β_NLOS is likely within its limits, and how far apart they are."""
        beyond = math.exp(_DOUBTS * prior.nlos_exponent_doubt)
        low, high = prior.nlos_exponent_min / beyond, prior.nlos_exponent_max * beyond
        if high <= low:
            return np.full((1, slope.size), low), np.ones(slope.size)
        best = -slope / curve
        variance = 1.0 / curve
        if noise_degrees is not None:
            least = np.maximum(constant + slope * best, self.count)
            variance = variance * (noise_degrees + least) / (noise_degrees + self.count)
        std = np.sqrt(variance)
        inside = np.clip(best, low, high)
        # Beyond a limit the likelihood falls off like an exponential from there.
        reach = _REACH * std / np.maximum(np.abs(best - inside) / (_STEEP * std), 1.0)
        first = np.maximum(inside - reach, low)
        width = (np.minimum(inside + reach, high) - first) / _NODES
        return first + width * _MIDDLES, width

    def _log_of_angles(self) -> FloatArray:
        """(C,); the nodes of π are equally likely."""
        return _log_sum(self.angle_log) - math.log(self.angle_log.shape[0])

    def means_at(self, candidate: int, exponents: ExponentGrid) -> tuple[float, float, float]:
        """Posterior mean of β_LOS, β_NLOS and the order of the antennas' null at one candidate."""
        prior = exponents.model
        constant, slope, curve, _, (los, null) = self._of_nlos_exponent(
            prior, slice(candidate, candidate + 1)
        )
        nodes, _ = self._nlos_nodes(constant, slope, curve, prior, None)
        score = _log_prior_of_nlos_exponent(nodes, prior) - 0.5 * nodes * (2.0 * slope + nodes * curve)
        weight = np.exp(score - score.max())
        mean = float((weight * nodes).sum() / weight.sum())
        return float(los[0][0] + los[1][0] * mean), mean, float(null[0][0] + null[1][0] * mean)

    def orders_drawn(self, candidates: Any, exponents: ExponentGrid, uniform: FloatArray) -> FloatArray:
        """(3, n) β_LOS, β_NLOS and null's order drawn from their posterior at n candidates.

        ``uniform`` (2, n) in [0, 1). β_LOS and order are their means given β_NLOS.
        """
        _, slope, curve, _, (los, null) = (parts := self._of_nlos_exponent(exponents.model, candidates))
        nodes, width = self._nlos_nodes(parts[0], slope, curve, exponents.model, None)
        score = -0.5 * nodes * (2.0 * slope + nodes * curve)
        score += _log_prior_of_nlos_exponent(nodes, exponents.model)
        reached = np.cumsum(np.exp(score - score.max(axis=0)), axis=0)
        node = np.argmax(reached >= uniform[0] * reached[-1], axis=0)
        nlos = nodes[node, np.arange(node.size)]
        if len(nodes) > 1:
            nlos = nlos + width * (uniform[1] - 0.5)
        return np.stack([los[0] + los[1] * nlos, nlos, null[0] + null[1] * nlos])

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


def _log_density(form: FloatArray, count: int, noise_degrees: float | None) -> FloatArray:
    """Log density of a quadratic form of ``count`` rows, up to a constant.

    Gaussian where the noise is the model's (``noise_degrees`` None). Else the noise may be higher by a
    factor s² ≥ 1, inverse-gamma with so many degrees of freedom, taken at its best value: Gaussian
    up to the form to be expected, a Student-t's tail beyond. Never lower: residuals too small show that
    shadowing is smoother than thought, not that there is less of it.
    """
    if noise_degrees is None:
        return -0.5 * form
    beyond = np.maximum(form - count, 0.0)
    result: FloatArray = -0.5 * np.minimum(form, count) - 0.5 * (noise_degrees + count) * np.log1p(
        beyond / (noise_degrees + count)
    )
    return result


def _log_prior_of_nlos_exponent(exponent: FloatArray, prior: SignalModel) -> FloatArray:
    """Log density, up to a constant: even within the limits, beyond them falling with ln β."""
    if prior.nlos_exponent_doubt <= 0.0:
        return np.zeros_like(exponent)
    below = np.log(np.maximum(prior.nlos_exponent_min / exponent, 1.0))
    above = np.log(np.maximum(exponent / prior.nlos_exponent_max, 1.0))
    result: FloatArray = -(below + above) / prior.nlos_exponent_doubt
    return result


def _log_sum(score: FloatArray) -> FloatArray:
    """Log of the sum of exponentials over the first axis."""
    top = score.max(axis=0)
    result: FloatArray = top + np.log(np.exp(score - top).sum(axis=0))
    return result


_SUMS = tuple(field.name for field in fields(Evidence))
