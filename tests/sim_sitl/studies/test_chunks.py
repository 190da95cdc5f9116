"""A piece of a study: its trials are its own, the truth stays hidden, regions are checked rightly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from groundstation.localization import METHODS
from groundstation.localization.solvers import SOLVERS
from sim_sitl.studies import chunks as module
from sim_sitl.studies.cases import CASES
from sim_sitl.studies.chunks import (
    ADAPTIVE,
    CENTRE,
    Chunk,
    ChunkResult,
    chunks_of,
    joined_by_case,
    run_chunk,
    run_method,
    schedule,
)

CASE = CASES["los-k4"]


def test_chunks_cover_all_trials_once() -> None:
    assert [(c.number, c.count) for c in chunks_of(CASE, ["centre"], 520, 3, 250)] == [
        (0, 250), (1, 250), (2, 20),
    ]  # fmt: skip
    assert [c.count for c in chunks_of(CASE, ["centre"], 250, 3, 250)] == [250]


def test_a_chunk_says_which_trials_it_is() -> None:
    assert str(chunks_of(CASE, ["centre"], 300, 9)[1]) == "case los-k4, trials 250 to 299, seed 9"


def test_cases_are_interleaved() -> None:
    order = schedule({"los-k4": ["centre"], "nlos-k4": ["centre"]}, 300, 1)
    assert [(c.case.name, c.number) for c in order] == [
        ("los-k4", 0), ("nlos-k4", 0), ("los-k4", 1), ("nlos-k4", 1),
    ]  # fmt: skip


def test_trials_do_not_depend_on_the_methods_or_the_other_chunks() -> None:
    alone = run_chunk(Chunk(CASE, ("wls-taylor",), 1, 12, 5))
    among = run_chunk(Chunk(CASE, (CENTRE, "wls-taylor-bounded", "wls-taylor"), 1, 12, 5))
    np.testing.assert_array_equal(
        alone.outcomes["wls-taylor"].error_enu_m, among.outcomes["wls-taylor"].error_enu_m
    )
    np.testing.assert_array_equal(alone.limit_square_m2, among.limit_square_m2)
    for other in (Chunk(CASE, ("wls-taylor",), 0, 12, 5), Chunk(CASE, ("wls-taylor",), 1, 12, 6)):
        elsewhere = run_chunk(other).outcomes["wls-taylor"].error_enu_m
        assert not np.allclose(elsewhere, alone.outcomes["wls-taylor"].error_enu_m)


def test_chunks_join_in_their_order_whatever_order_they_come_in() -> None:
    pieces = chunks_of(CASE, [CENTRE], 30, 2, 10)
    results = [run_chunk(piece) for piece in pieces]
    joined = joined_by_case(pieces[::-1], results[::-1])["los-k4"]
    expected = ChunkResult.joined(results)
    np.testing.assert_array_equal(joined.outcomes[CENTRE].error_enu_m, expected.outcomes[CENTRE].error_enu_m)
    assert joined.limit_square_m2.shape == (30,)
    assert set(joined.stages_cpu_s) == {"draw", "score", "limit"}


def test_centre_answers_the_middle_of_the_area() -> None:
    trials = CASE.draw(6, np.random.default_rng(1))
    found = run_method(CENTRE, trials)
    np.testing.assert_allclose(found.error_enu_m + trials.truth_enu_m, np.tile([0.0, 0.0, 10.5], (6, 1)))
    assert found.answered.all()


def test_what_cannot_be_answered_counts_as_the_centre() -> None:
    trials = CASES["hard-k2-nlos"].draw(5, np.random.default_rng(1))
    found = run_method("adaptive", trials)
    assert not found.answered.any()
    np.testing.assert_array_equal(found.error_enu_m, run_method(CENTRE, trials).error_enu_m)
    assert np.isnan(found.in_ellipse).all()


@pytest.mark.parametrize("method", ["wls-taylor", "adaptive-sound", "wls-ideal"])
def test_only_the_ideal_reference_is_told_the_truth(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    told: dict[str, Any] = {}
    real = module.locate_batch

    def spy(*arguments: Any, **named: Any) -> Any:
        told.update(named)
        return real(*arguments, **named)

    monkeypatch.setattr(module, "locate_batch", spy)
    trials = CASE.draw(4, np.random.default_rng(1))
    run_method(method, trials)
    assert ("truth_enu_m" in told) == ("transmit_power_dbm" in told) == (method == "wls-ideal")
    np.testing.assert_array_equal(told["bias_max_db"], trials.bias_max_db)


def test_both_readings_of_algorithm_1_are_there() -> None:
    assert set(ADAPTIVE) == {"adaptive", "adaptive-sound"}
    trials = CASES["mixed-k4"].draw(8, np.random.default_rng(1))
    literal, sound, posterior = (
        run_method(name, trials).error_enu_m for name in ("adaptive", "adaptive-sound", "posterior")
    )
    np.testing.assert_allclose(sound, posterior)
    assert not np.allclose(literal, sound)


def test_ellipsoids_of_normal_errors_hold_nine_in_ten() -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(3, 3))
    covariance = np.tile(root @ root.T, (4000, 1, 1))
    error = rng.normal(size=(4000, 3)) @ root.T
    everywhere = np.ones(4000, dtype=bool)
    for size, radius in ((2, module._ELLIPSE), (3, module._ELLIPSOID)):
        held = module._held(error[:, :size], covariance[:, :size, :size], everywhere, radius)
        assert held.mean() == pytest.approx(0.9, abs=0.015)


def test_an_ellipsoid_without_thickness_or_without_covariance_is_no_error() -> None:
    flat = np.diag([1.0, 1.0, 0.0])
    error = np.array([[0.1, 0.1, 0.0], [0.1, 0.1, 1.0], [0.1, 0.1, 0.0], [0.1, 0.1, 0.0]])
    covariance = np.array([flat, flat, np.full((3, 3), np.nan), flat])
    held = module._held(error, covariance, np.array([True, True, True, False]), module._ELLIPSOID)
    np.testing.assert_array_equal(held, [1.0, 0.0, np.nan, np.nan])


def test_the_posterior_has_regions_and_ellipses_and_lsre_has_none() -> None:
    trials = CASES["nlos-k4"].draw(40, np.random.default_rng(2))
    found = run_method("posterior", trials)
    assert set(found.in_region) <= {0.0, 1.0}
    assert 0.6 <= found.in_region.mean() <= 1.0
    assert 0.6 <= found.in_ellipse.mean() <= 1.0
    assert np.isnan(run_method("lsre-socp", trials).in_region).all()


def test_the_truth_of_a_region_is_the_beliefs_own_word(monkeypatch: pytest.MonkeyPatch) -> None:
    from groundstation.localization.posterior import PosteriorAnswer

    levels = iter([0.2, 0.9, 0.900001, 1.0])
    monkeypatch.setattr(PosteriorAnswer, "credible_level", lambda self, points: np.array([next(levels)]))
    trials = CASES["nlos-k4"].draw(4, np.random.default_rng(2))
    np.testing.assert_array_equal(run_method("posterior", trials).in_region, [1.0, 1.0, 0.0, 0.0])


def test_adaptive_is_a_method_and_no_solver() -> None:
    assert "adaptive" in METHODS
    assert "adaptive" not in SOLVERS
