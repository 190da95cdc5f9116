"""The closed form is the dense one: β_LOS and the null's order given β_NLOS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.localization import SERVICE_MODEL
from groundstation.localization.regression_solved import Solved, inverse_cholesky

PRIOR = replace(SERVICE_MODEL, los_exponent_std=0.3, antenna_null_std=0.8)
PAIRS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


def form(rows: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Levels (rows,) and whitened losses (rows, 3): as LOS, as NLOS, in the null; all alike somewhat."""
    rng = np.random.default_rng(seed)
    losses = rng.normal(4.0, 1.0, (rows, 1)) + 0.6 * rng.normal(size=(rows, 3))
    level = -losses @ [2.3, 3.1, 0.7] + rng.normal(size=rows)
    return level, losses


def solved(forms: list[tuple[np.ndarray, np.ndarray]]) -> Solved:
    (constant,) = {round(float(level @ level), 12) for level, _ in forms}
    terms = np.array(
        [[*(level @ losses), *(losses[:, a] @ losses[:, b] for a, b in PAIRS)] for level, losses in forms]
    )
    return Solved.of(PRIOR, len(forms[0][0]), np.eye(1), constant, terms.T)


@pytest.mark.parametrize("nlos", [1.7, 3.0, 5.5])
def test_it_is_the_dense_regression(nlos: float) -> None:
    level, losses = form(12, 1)
    ours = solved([(level, losses)])
    std = np.array([PRIOR.los_exponent_std, PRIOR.antenna_null_std])
    mean = np.array([PRIOR.los_exponent, PRIOR.antenna_null_mean])
    design = losses[:, [0, 2]] * std
    left = level + nlos * losses[:, 1] + losses[:, [0, 2]] @ mean
    precision = np.eye(2) + design.T @ design
    best = -np.linalg.solve(precision, design.T @ left)
    least = np.square(left + design @ best).sum() + best @ best
    assert ours.constant[0] + 2.0 * ours.slope[0] * nlos + ours.curve[0] * nlos**2 == pytest.approx(least)
    assert ours.log_spread[0] == pytest.approx(0.5 * np.linalg.slogdet(precision)[1])
    expected = mean + std * best
    assert ours.los[0][0] + nlos * ours.los[1][0] == pytest.approx(expected[0])
    assert ours.null[0][0] + nlos * ours.null[1][0] == pytest.approx(expected[1])


def test_each_candidate_is_solved_as_if_alone() -> None:
    level, losses = form(12, 1)
    other = losses + 0.3 * np.random.default_rng(2).normal(size=losses.shape)
    both = solved([(level, losses), (level, other)])
    for number, each in enumerate((losses, other)):
        alone = solved([(level, each)])
        assert both.means_at(number) == pytest.approx(alone.means_at(0))
        assert both.log_likelihood(5.0)[number] == pytest.approx(alone.log_likelihood(5.0)[0])


def test_the_inverse_of_the_factor_whitens_and_nothing_else_will_do() -> None:
    rng = np.random.default_rng(3)
    half = rng.normal(size=(6, 9))
    precision = half @ half.T
    inverse = inverse_cholesky(precision)
    np.testing.assert_allclose(inverse @ precision @ inverse.T, np.eye(6), atol=1e-9)
    assert (np.triu(inverse, 1) == 0.0).all()
    with pytest.raises(np.linalg.LinAlgError):
        inverse_cholesky(-precision)
