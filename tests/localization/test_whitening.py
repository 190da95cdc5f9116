from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.localization import SignalModel, whitening
from groundstation.localization.whitening import Observations, informative_parents, whiten, whiten_rows

MODEL = SignalModel(nlos_rss_std_db=5.0, shared_shadowing=0.5)
CORRELATION_M = 25.0


def laps(count: int, links: int = 1, apart_m: float = 5.0) -> Observations:
    """Obstructed windows 8 m apart on laps of radius 100 m, each lap ``apart_m`` beside the last one."""
    number = np.arange(count)
    turn = 0.08 * (number // links)
    radius = 100.0 - apart_m * turn / (2.0 * np.pi)
    place = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(count, 50.0)], axis=1)
    nothing = np.full(count, np.nan)
    return Observations(
        place,
        number % links,
        np.full(count, -60.0),
        np.zeros(count),
        np.full(count, 0.5),
        nothing,
        nothing,
        np.full((count, 2), 0.02),
        np.zeros(count),
        np.ones(count),
        np.full((count, 0), -1),
        np.zeros((count, 2)),
    )


def covariance_db2(seen: Observations) -> np.ndarray:
    """Dense (n, n): what every choice of parents approximates."""
    gap = np.linalg.norm(seen.position_enu_m[:, None] - seen.position_enu_m, axis=-1)
    alike = np.where(seen.link[:, None] == seen.link, 1.0, MODEL.shared_shadowing)
    shadowing = MODEL.nlos_rss_std_db**2 * alike * np.exp(-gap / CORRELATION_M)
    return np.asarray(shadowing + np.diag(seen.white_variance_db2))


def left_db2(covariance: np.ndarray, row: int, given: list[int]) -> float:
    """Variance of ``row`` once ``given`` are known."""
    if not given:
        return float(covariance[row, row])
    toward = covariance[given, row]
    return float(covariance[row, row] - toward @ np.linalg.solve(covariance[np.ix_(given, given)], toward))


def earlier(count: int) -> np.ndarray:
    return np.arange(count) < np.arange(count)[:, None]


def chosen(seen: Observations, count: int, usable: np.ndarray | None = None) -> np.ndarray:
    usable = earlier(seen.count) if usable is None else usable
    return np.asarray(informative_parents(seen, np.arange(seen.count), usable, count, CORRELATION_M, MODEL))


def test_each_parent_is_the_one_that_lessens_the_variance_most() -> None:
    seen = laps(40, links=2)
    covariance = covariance_db2(seen)
    parents = chosen(seen, 3)
    for row in range(seen.count):
        given: list[int] = []
        for parent in parents[row][parents[row] >= 0].tolist():
            reached = min(
                left_db2(covariance, row, [*given, other]) for other in range(row) if other not in given
            )
            assert left_db2(covariance, row, [*given, parent]) <= reached * (1.0 + 1e-9)
            given.append(parent)


def test_chosen_ones_foretell_more_than_the_nearest() -> None:
    """Over laps 5 m apart the nearest repeat each other: information overstated, in natural units."""
    seen = laps(160)
    covariance = covariance_db2(seen)
    whole = sum(np.log(left_db2(covariance, row, list(range(row)))) for row in range(seen.count))

    def overstated(families: list[list[int]]) -> float:
        left = sum(np.log(left_db2(covariance, row, given)) for row, given in enumerate(families))
        return 0.5 * float(left - whole)

    gap = np.linalg.norm(seen.position_enu_m[:, None] - seen.position_enu_m, axis=-1)
    near = [np.argsort(gap[row, :row], kind="stable")[:4].tolist() for row in range(seen.count)]
    few = [[parent for parent in row if parent >= 0] for row in chosen(seen, 4).tolist()]
    assert all(len(row) <= 4 for row in few)
    assert 0.0 <= overstated(few) < 0.5 * overstated(near)


def test_only_usable_rows_become_parents_and_no_row_twice() -> None:
    seen = laps(30)
    usable = earlier(30)
    usable[:, ::3] = False
    parents = chosen(seen, 5, usable)
    for row, given in enumerate(parents.tolist()):
        told = [parent for parent in given if parent >= 0]
        assert len(set(told)) == len(told)
        assert all(usable[row, parent] for parent in told)
    assert (parents[0] == -1).all()


def test_how_many_rows_are_related_at_once_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = laps(170, 2)
    parents = []
    for at_once in (1, 64, 1000):
        monkeypatch.setattr(whitening, "_AT_ONCE", at_once)
        parents.append(chosen(seen, 4))
    assert (parents[0] == parents[1]).all()
    assert (parents[0] == parents[2]).all()
    some = informative_parents(seen, np.arange(150, 170), earlier(170)[150:], 4, CORRELATION_M, MODEL)
    assert (some == parents[0][150:]).all()


def test_vehicles_with_fields_of_their_own_are_no_parents() -> None:
    seen = laps(20, links=2)
    alone = replace(MODEL, shared_shadowing=0.0)
    parents = np.asarray(informative_parents(seen, np.arange(20), earlier(20), 4, CORRELATION_M, alone))
    told = parents >= 0
    assert told.any()
    assert (seen.link[np.where(told, parents, 0)] == seen.link[:, None])[told].all()


def test_what_is_left_is_white() -> None:
    """Drawn from the dense covariance, whitened rows are uncorrelated with unit variance: 4,000 draws."""
    seen = laps(24)
    seen = replace(seen, parents=chosen(seen, 23))
    factor = np.linalg.cholesky(covariance_db2(seen))
    draws = factor @ np.random.default_rng(1).standard_normal((24, 4000))
    flat = replace(MODEL, nlos_bias_max_db=0.0)
    rows = whiten(seen, 0, 1, CORRELATION_M, flat)
    family = np.concatenate([rows.rows[:, None], np.maximum(seen.parents[rows.rows], 0)], axis=1)
    white = np.einsum("rm,rmd->rd", rows.mixing, draws[family])
    np.testing.assert_allclose(np.cov(white), np.eye(24), atol=0.08)


def test_a_window_without_power_stands_in_for_nobody() -> None:
    seen = laps(6)
    seen.rss_dbm[0] = np.nan
    seen = replace(seen, parents=np.array([[-1, -1], [-1, -1], [1, -1], [2, 1], [-1, -1], [4, -1]]))
    rows = whiten(seen, 0, 1, CORRELATION_M, MODEL)
    assert rows.rows.tolist() == [1, 2, 3, 4, 5]
    assert np.isfinite(rows.level).all()
    # Of a row that is related to nobody only its own spread is left.
    alone = whiten(seen.take(np.array([1, 4])), 0, 1, CORRELATION_M, MODEL)
    np.testing.assert_allclose(alone.level, rows.level[[0, 3]])
    np.testing.assert_allclose(alone.loading, rows.loading[[0, 3]])


def test_some_rows_are_whitened_as_all_are() -> None:
    seen = laps(30, links=2)
    seen = replace(seen, parents=chosen(seen, 4))
    every, some = whiten(seen, 0, 2, CORRELATION_M, MODEL), np.arange(2, 30, 5)
    for name in ("rows", "mixing", "level", "loading", "scale"):
        np.testing.assert_allclose(
            getattr(whiten_rows(seen, some, 2, CORRELATION_M, MODEL), name), getattr(every, name)[some]
        )
