"""Scores against figures worked out by hand, and intervals that hold what they say."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sim_sitl.studies.scoring import Outcome, case_key, resampled_means, score_case


def outcome(error_m: Any, answered: Any = None, settled: Any = None, **changes: Any) -> Outcome:
    """Errors (N,) along east."""
    error = np.zeros((len(error_m), 3))
    error[:, 0] = error_m
    yes = np.ones(len(error_m), dtype=bool)
    nothing = np.full(len(error_m), np.nan)
    return Outcome(
        error,
        yes if answered is None else np.array(answered),
        yes if settled is None else np.array(settled),
        changes.get("in_ellipse", nothing),
        changes.get("in_ellipsoid", nothing),
        changes.get("in_region", nothing),
        changes.get("cpu_s", 0.0),
    )


def test_rmse_median_and_percentile_by_hand() -> None:
    score = score_case("a", {"m": outcome([3.0, 4.0, 0.0, 0.0], cpu_s=2.0)}, None, seed=1)[0]
    assert score.rmse_m.value == pytest.approx(2.5)
    assert score.median_m == pytest.approx(1.5)
    assert score.p90_m == pytest.approx(3.7)
    assert score.cpu_s_per_solve == pytest.approx(0.5)
    assert score.trials == 4
    assert math.isnan(score.limit_ratio.value)
    assert math.isnan(score.reference_ratio.value)
    assert math.isnan(score.in_ellipse)


def test_horizontal_error_leaves_the_height_out() -> None:
    found = outcome([3.0, 3.0])
    error = found.error_enu_m.copy()
    error[:, 2] = 4.0
    tall = Outcome(
        error, found.answered, found.settled, found.in_ellipse, found.in_ellipsoid, found.in_region, 0.0
    )
    score = score_case("a", {"m": tall}, None, seed=1)[0]
    assert score.rmse_m.value == pytest.approx(5.0)
    assert score.rmse_horizontal_m == pytest.approx(3.0)


def test_failures_count_in_the_rmse_and_are_told() -> None:
    score = score_case("a", {"m": outcome([1.0, 7.0], [True, False], [True, False])}, None, seed=1)[0]
    assert score.failed == 1
    assert score.rmse_m.value == pytest.approx(5.0)
    assert score.excluded == 1
    assert score.rmse_kept_m.value == pytest.approx(1.0)
    assert score.unsettled == 0


def test_the_papers_rule_drops_what_is_above_500_m_and_says_how_many() -> None:
    score = score_case("a", {"m": outcome([500.0, 500.1, 10.0, 2000.0])}, None, seed=1)[0]
    assert score.excluded == 2
    assert score.rmse_kept_m.value == pytest.approx(math.sqrt((500.0**2 + 100.0) / 2))
    assert score.rmse_m.value > 1000.0
    assert score.failed == 0


def test_nothing_left_under_the_papers_rule_is_no_figure() -> None:
    score = score_case("a", {"m": outcome([600.0, 700.0])}, None, seed=1)[0]
    assert score.excluded == 2
    assert math.isnan(score.rmse_kept_m.value)
    assert math.isnan(score.rmse_kept_m.low)


def test_unsettled_answers_are_counted() -> None:
    score = score_case("a", {"m": outcome([1.0, 1.0, 1.0], settled=[True, False, False])}, None, seed=1)[0]
    assert score.unsettled == 2


def test_ratio_to_a_proportional_limit_has_no_spread() -> None:
    error = np.random.default_rng(3).exponential(10.0, 200)
    rows = score_case("a", {"m": outcome(2.0 * error)}, error**2, seed=1)
    assert [row.method for row in rows] == ["m", "limit"]
    for figure in (rows[0].limit_ratio.value, rows[0].limit_ratio.low, rows[0].limit_ratio.high):
        assert figure == pytest.approx(2.0, rel=1e-12)
    # The RMSE itself does vary over trials: only pairing takes the spread away.
    assert rows[0].rmse_m.high > 1.1 * rows[0].rmse_m.low


def test_posterior_beside_each_other_method() -> None:
    error = np.random.default_rng(3).exponential(10.0, 100)
    rows = score_case("a", {"posterior": outcome(error), "m": outcome(4.0 * error)}, None, seed=1)
    assert rows[1].reference_ratio.value == pytest.approx(0.25)
    assert rows[1].reference_ratio.high == pytest.approx(0.25)
    assert rows[0].reference_ratio.value == pytest.approx(1.0)


def test_shares_of_regions_leave_out_what_has_none() -> None:
    inside = np.array([1.0, 0.0, 1.0, np.nan])
    score = score_case("a", {"m": outcome([1.0] * 4, in_region=inside)}, None, seed=1)[0]
    assert score.in_region == pytest.approx(2.0 / 3.0)


def test_the_interval_holds_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(300):
        square = rng.exponential(1.0, (120, 1))
        low, high = np.percentile(resampled_means(square, rng, 400), (2.5, 97.5))
        held += bool(low <= 1.0 <= high)
    # 95 % less the percentile bootstrap's known shortfall at N = 120; ± 3 standard errors.
    assert 0.89 <= held / 300 <= 0.98


def test_resampled_means_weigh_rows_alike_in_all_columns() -> None:
    values = np.random.default_rng(1).normal(size=(50, 2))
    values[:, 1] = 3.0 * values[:, 0] + 1.0
    drawn = resampled_means(values, np.random.default_rng(2), 130)
    assert drawn.shape == (130, 2)
    np.testing.assert_allclose(drawn[:, 1], 3.0 * drawn[:, 0] + 1.0)
    assert drawn[:, 0].std() == pytest.approx(values[:, 0].std() / math.sqrt(50), rel=0.3)


def test_the_same_seed_gives_the_same_interval_whatever_else_is_scored() -> None:
    error = np.random.default_rng(3).exponential(10.0, 60)
    alone = score_case("a", {"m": outcome(error)}, None, seed=1)[0]
    among = score_case("a", {"n": outcome(error + 1.0), "m": outcome(error)}, error**2, seed=1)[1]
    assert among.rmse_m.low == pytest.approx(alone.rmse_m.low, rel=1e-12)
    other = score_case("a", {"m": outcome(error)}, None, seed=2)[0]
    assert other.rmse_m.low != alone.rmse_m.low


def test_every_case_has_a_key_of_its_own() -> None:
    from sim_sitl.studies.cases import CASES

    assert len({case_key(name) for name in CASES}) == len(CASES)
