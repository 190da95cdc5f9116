from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize as scipy_minimize

from groundstation.localization.interior import Constraints, minimise


class Quadratic:
    """½ (y − p)ᵀ Q (y − p) of N problems."""

    def __init__(self, matrix: np.ndarray, peak: np.ndarray) -> None:
        self.matrix, self.peak = matrix, peak

    def evaluate(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        offset = y - self.peak
        gradient = np.einsum("nij,nj->ni", self.matrix, offset)
        return 0.5 * (offset * gradient).sum(axis=1), gradient, np.array(self.matrix)

    def rows(self, chosen: np.ndarray) -> Quadratic:
        return Quadratic(self.matrix[chosen], self.peak[chosen])


def ball_and_slab(unknowns: int) -> Constraints:
    """|y|² ≤ 1 and −0.2 ≤ y₀ ≤ 0.3."""
    slope, bend = np.zeros((3, unknowns)), np.zeros((3, unknowns))
    slope[1, 0], slope[2, 0] = 1.0, -1.0
    bend[0] = 2.0
    return Constraints(np.array([1.0, 0.2, 0.3]), slope, bend, np.ones(3))


def drawn(count: int, unknowns: int, seed: int) -> Quadratic:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((count, unknowns, unknowns))
    return Quadratic(
        root @ root.swapaxes(1, 2) + 0.05 * np.eye(unknowns), 2.0 * rng.standard_normal((count, unknowns))
    )


@pytest.mark.parametrize("unknowns", [2, 3, 8])
def test_against_a_general_solver(unknowns: int) -> None:
    problem, constraints = drawn(12, unknowns, unknowns), ball_and_slab(unknowns)
    found = minimise(problem, constraints, np.zeros((12, unknowns)))
    assert found.converged.all()
    assert (constraints.values(found.y) >= 0.0).all()
    for row in range(12):
        one = problem.rows([row])
        peer = scipy_minimize(
            lambda y, f=one: f.evaluate(y[None])[0][0],
            np.zeros(unknowns),
            jac=lambda y, f=one: f.evaluate(y[None])[1][0],
            method="SLSQP",
            constraints={"type": "ineq", "fun": lambda y: constraints.values(y[None])[0]},
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert found.value[row] == pytest.approx(peer.fun, rel=1e-6, abs=1e-9)
        assert found.y[row] == pytest.approx(peer.x, abs=1e-4)


def test_free_optimum_is_found_where_nothing_binds() -> None:
    problem = drawn(5, 3, 1)
    problem.peak = 0.05 * problem.peak
    found = minimise(problem, ball_and_slab(3), np.zeros((5, 3)))
    assert found.y == pytest.approx(problem.peak, abs=1e-4)


def test_batch_is_the_loop() -> None:
    problem, constraints = drawn(40, 3, 2), ball_and_slab(3)
    whole = minimise(problem, constraints, np.zeros((40, 3)))
    for row in range(40):
        one = minimise(problem.rows([row]), constraints, np.zeros((1, 3)))
        assert one.y[0] == pytest.approx(whole.y[row], abs=1e-9)


def test_units_of_the_unknowns_do_not_matter() -> None:
    """The same problem with unknowns counted in very different units."""
    problem, constraints = drawn(10, 3, 3), ball_and_slab(3)
    unit = np.array([1e4, 1e-3, 10.0])
    other = Quadratic(problem.matrix * unit[:, None] * unit, problem.peak / unit)
    stretched = Constraints(
        constraints.offset, constraints.slope * unit, constraints.curvature * unit**2, constraints.weight
    )
    plain = minimise(problem, constraints, np.zeros((10, 3)))
    scaled = minimise(other, stretched, np.zeros((10, 3)))
    assert scaled.converged.all()
    assert scaled.y * unit == pytest.approx(plain.y, abs=1e-5)


def test_idle_unknown_ends_at_the_analytic_centre() -> None:
    """f knows only y₀; y₁ between −1 and 3 with weights 3 and 1 maximises 3 ln(y₁ + 1) + ln(3 − y₁): 2."""
    matrix = np.zeros((1, 2, 2))
    matrix[0, 0, 0] = 1.0
    slope = np.array([[0.0, 1.0], [0.0, -1.0]])
    constraints = Constraints(np.array([1.0, 3.0]), slope, np.zeros((2, 2)), np.array([3.0, 1.0]))
    found = minimise(Quadratic(matrix, np.array([[0.7, 0.0]])), constraints, np.zeros((1, 2)), centred=True)
    assert found.y[0] == pytest.approx([0.7, 2.0], abs=0.01)


def test_constraints_of_their_own() -> None:
    """Each problem with its own half-plane y₀ ≤ b."""
    bound = np.array([[0.5], [-1.0], [3.0]])
    slope = np.tile([[[-1.0, 0.0]]], (3, 1, 1))
    constraints = Constraints(bound, slope, np.zeros((1, 2)), np.ones(1))
    problem = Quadratic(np.tile(np.eye(2), (3, 1, 1)), np.tile([2.0, 1.0], (3, 1)))
    found = minimise(problem, constraints, np.tile([-5.0, 0.0], (3, 1)))
    assert found.y == pytest.approx(np.array([[0.5, 1.0], [-1.0, 1.0], [2.0, 1.0]]), abs=1e-4)
