"""A primal–dual interior-point method for N small convex programs at once.

Exists because the convex programs of the paper and of its baselines come down to three to a few
dozen unknowns, for which a general conic solver spends its time on everything but the
arithmetic; here N of them share each array operation. Rules: starts must lie strictly inside;
a problem that has converged is not computed again; a program's answer depends on its own
data alone, not on the others in the batch.

The program: min f(y) over y in Rⁿ, f convex, with m concave quadratic constraints
h_i(y) = b_i + a_i·y − ½ Σ_c D_ic y_c² ≥ 0. The central path is that of f − μ Σ ω_i ln h_i: with
ω_i = 3 a constraint stands for the determinant of a 3 × 3 block. Method: Boyd and Vandenberghe,
Convex Optimization, 11.7, with a step back on the residual's norm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

import numpy as np

from groundstation.localization.problem import BoolArray, FloatArray

_ITERATIONS = 80
_KEEP_FROM_BOUNDARY = 0.99
_HALVINGS = 40
_DECREASE = 0.01
_FIRST_BARRIER = 0.1
_GAP_BEHIND = 0.1
_FINER = 1e-3
_OFF_CENTRE = 0.01
_TINY = 1e-300


class Objective(Protocol):
    """f of N problems. Where f is not defined its value is inf and the rest is not read."""

    def evaluate(self, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Values (N,), gradients (N, n), Hessians (N, n, n) at y (N, n)."""
        ...

    def rows(self, chosen: Any) -> Self:
        """The problems that ``chosen`` (mask or indices) selects."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Constraints:
    """h(y) = b + A y − ½ D y² ≥ 0 for N problems (arrays without the leading axis are shared)."""

    offset: FloatArray
    """(m,) or (N, m): b."""
    slope: FloatArray
    """(m, n) or (N, m, n): A."""
    curvature: FloatArray
    """(m, n): D ≥ 0."""
    weight: FloatArray
    """(m,): ω of the central path."""

    def values(self, y: FloatArray) -> FloatArray:
        """(N, m) h at y (N, n)."""
        linear = y @ self.slope.T if self.slope.ndim == 2 else np.matmul(self.slope, y[..., None])[..., 0]
        result: FloatArray = linear + self.offset - 0.5 * (y * y) @ self.curvature.T
        return result

    def jacobian(self, y: FloatArray) -> FloatArray:
        """(N, m, n) ∇h at y (N, n)."""
        result: FloatArray = self.slope - self.curvature * y[:, None, :]
        return result

    def rows(self, chosen: Any) -> Constraints:
        """The problems that ``chosen`` selects."""
        if self.slope.ndim == 2 and self.offset.ndim == 1:
            return self
        offset = self.offset[chosen] if self.offset.ndim == 2 else self.offset
        return replace(self, offset=offset, slope=self.slope[chosen] if self.slope.ndim == 3 else self.slope)


@dataclass(frozen=True, slots=True, eq=False)
class Optimum:
    """What ``minimise`` found."""

    y: FloatArray
    """(N, n)"""
    value: FloatArray
    """(N,) f."""
    converged: BoolArray
    """(N,) duality gap and residual below the tolerance."""
    iterations: int
    """Newton steps of the slowest problem."""


def minimise(
    objective: Objective,
    constraints: Constraints,
    start: FloatArray,
    tolerance: float = 1e-9,
    *,
    centred: bool = False,
) -> Optimum:
    """Minimise f of N problems from ``start`` (N, n), strictly inside.

    ``tolerance``: duality gap relative to 1 + |f|, and a thousand times less for what the
    residual of stationarity still promises. ``centred``: go on along the central path's end, to
    the analytic centre of the optima where there are many.
    """
    count, unknowns = start.shape
    y = np.array(start)
    value, gradient, hessian = objective.evaluate(y)
    slack, jacobian = constraints.values(y), constraints.jacobian(y)
    weight, total = constraints.weight, float(constraints.weight.sum())
    # The first multipliers centre the start at a barrier that balances the objective's slope there.
    push = np.abs(_times(weight / slack, jacobian)).max(axis=1)
    level = np.abs(gradient).max(axis=1) / np.maximum(push, _TINY)
    level = np.clip(level, _FIRST_BARRIER * np.abs(value), np.abs(value))
    dual = level[:, None] * weight / slack
    rest = gradient - _times(dual, jacobian)
    final = Optimum(np.array(y), np.array(value), np.zeros(count, dtype=bool), 0)
    alive, centring = np.arange(count), np.full(count, 0.1)
    rounds = 0
    while rounds < _ITERATIONS and alive.size:
        rounds += 1
        product, ratio = slack * dual, dual / slack
        gap = product.sum(axis=1)
        matrix = np.matmul((jacobian * ratio[:, :, None]).transpose(0, 2, 1), jacobian) + hessian
        diagonal = matrix.reshape(alive.size, -1)[:, :: unknowns + 1]
        diagonal += dual @ constraints.curvature
        # Residuals count in units of the curvature, so that no unknown's unit matters.
        unit = 1.0 / np.maximum(diagonal, _TINY)
        squared = rest * rest * unit
        residual = squared.max(axis=1)
        sought = tolerance * (1.0 + np.abs(value))
        near = gap < sought
        done = near & (residual < _FINER * sought)
        if centred:
            # At the gap sought the barrier stays until all products of slack and multiplier agree.
            share = product / weight * (total / gap)[:, None]
            centring = np.where(near, 1.0, centring)
            done &= np.abs(share - 1.0).max(axis=1) < _OFF_CENTRE
        if done.any():
            final.y[alive[done]], final.value[alive[done]] = y[done], value[done]
            final.converged[alive[done]] = True
            keep = ~done
            alive = alive[keep]
            if not alive.size:
                break
            objective, constraints = objective.rows(keep), constraints.rows(keep)
            y, gradient, matrix, unit = y[keep], gradient[keep], matrix[keep], unit[keep]
            slack, dual, jacobian, ratio = slack[keep], dual[keep], jacobian[keep], ratio[keep]
            gap, squared, residual = gap[keep], squared[keep], residual[keep]
            product, centring, value = product[keep], centring[keep], value[keep]
        # A barrier that falls faster than the residual jams the iterate in a corner.
        barrier = np.maximum(centring * gap, _GAP_BEHIND * np.sqrt(residual)) / total
        target = barrier[:, None] * weight
        pull = target / slack
        move = _solved(matrix, _times(pull, jacobian) - gradient)
        dual_move = pull - dual - ratio * np.matmul(jacobian, move[:, :, None])[:, :, 0]
        # The longest step that keeps the multipliers positive, then back until the slacks are too.
        step = 1.0 / np.maximum(1.0, -(dual_move / dual).min(axis=1) / _KEEP_FROM_BOUNDARY)
        before = squared.sum(axis=1) + np.square(product - target).sum(axis=1)
        for _ in range(_HALVINGS):
            new_y = y + step[:, None] * move
            new_dual = dual + step[:, None] * dual_move
            new_slack, new_jacobian = constraints.values(new_y), constraints.jacobian(new_y)
            new_value, new_gradient, new_hessian = objective.evaluate(new_y)
            new_rest = new_gradient - _times(new_dual, new_jacobian)
            after = (new_rest * new_rest * unit).sum(axis=1)
            after += np.square(new_dual * new_slack - target).sum(axis=1)
            fine = (after <= (1.0 - _DECREASE * step) * before) & np.isfinite(new_value)
            fine &= new_slack.min(axis=1) > 0.0
            if fine.all():
                break
            step = np.where(fine, step, 0.5 * step)
        else:
            # Where no step helps rounding has the last word: the problem stays where it is, unconverged.
            lost = alive[~fine]
            final.y[lost], final.value[lost] = y[~fine], value[~fine]
            alive, step = alive[fine], step[fine]
            objective, constraints = objective.rows(fine), constraints.rows(fine)
            new_y, new_dual, new_slack, new_jacobian = (
                new_y[fine],
                new_dual[fine],
                new_slack[fine],
                new_jacobian[fine],
            )
            new_value, new_gradient, new_hessian = new_value[fine], new_gradient[fine], new_hessian[fine]
            new_rest = new_rest[fine]
        y, dual, slack, jacobian = new_y, new_dual, new_slack, new_jacobian
        value, gradient, hessian, rest = new_value, new_gradient, new_hessian, new_rest
        centring = np.where(step > 0.9, 0.02, np.where(step > 0.5, 0.1, 0.4))
    final.y[alive], final.value[alive] = y[: alive.size], value[: alive.size]
    return replace(final, iterations=rounds)


def _times(rows: FloatArray, matrices: FloatArray) -> FloatArray:
    """(N, n): rows (N, m) by matrices (N, m, n)."""
    result: FloatArray = np.matmul(rows[:, None, :], matrices)[:, 0]
    return result


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """(N, n) solutions; where rounding has made a matrix singular, of the nearest regular system."""
    try:
        result: Any = np.linalg.solve(matrix, right[..., None])[..., 0]
    except np.linalg.LinAlgError:
        result = np.matmul(np.linalg.pinv(matrix, hermitian=True), right[..., None])[..., 0]
    found: FloatArray = result
    return found
