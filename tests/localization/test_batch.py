from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.domain.errors import InputError
from groundstation.localization import SignalModel
from groundstation.localization.batch import Answers, Batch, scattered, selected

MODEL = SignalModel(receiver_offset_db=3.0)


def test_distances_are_no_shorter_than_a_metre(draw) -> None:
    drawn = draw(2, (0, 0, 0, 0), 71)
    batch = Batch.of(drawn.links, drawn.area, MODEL)
    at = batch.place[:, 1] + [0.0, 0.0, 0.2]
    expected = np.linalg.norm(batch.place - at[:, None], axis=-1)
    expected[:, 1] = 1.0
    assert np.allclose(batch.distances_m(at), expected)


def test_cost_is_69_without_the_receivers_offset(draw) -> None:
    drawn = draw(3, (1, 0, 0, 0), 72)
    batch = Batch.of(drawn.links, drawn.area, MODEL)
    exponent = batch.first_exponents()
    assert exponent[0].tolist() == [2.5, 2.7, 2.7, 2.7]
    distance = np.linalg.norm(batch.place[1] - drawn.truth_enu_m[1], axis=1)
    expected = np.square(drawn.links.rss_dbm[1] - 3.0 - 15.0 + 10.0 * exponent[1] * np.log10(distance)).sum()
    assert batch.rss_cost_db2(drawn.truth_enu_m, np.full(3, 15.0), exponent)[1] == pytest.approx(expected)


def test_known_power_comes_first(draw) -> None:
    drawn = draw(2, (0, 0, 0, 0), 73)
    assert Batch.of(drawn.links, drawn.area, SignalModel()).first_power_dbm().tolist() == [15.0, 15.0]
    known = SignalModel(known_transmit_power_dbm=11.0)
    assert Batch.of(drawn.links, drawn.area, known).first_power_dbm().tolist() == [11.0, 11.0]


def test_rows_take_everything_along(draw) -> None:
    drawn = draw(4, (0, 0, 0, 0), 74)
    power = np.array([13.0, 14.0, 15.0, 16.0])
    batch = Batch.of(drawn.links, drawn.area, MODEL, [6.0, 6.5, 7.0, 8.0], drawn.truth_enu_m, power)
    part = batch.rows([3, 1])
    assert part.bias_max_db.tolist() == [8.0, 6.5]
    assert part.transmit_power_dbm is not None
    assert part.transmit_power_dbm.tolist() == [16.0, 14.0]
    assert np.array_equal(part.truth_enu_m, drawn.truth_enu_m[[3, 1]])
    assert np.array_equal(part.links.rss_dbm, drawn.links.rss_dbm[[3, 1]])


@pytest.mark.parametrize(
    ("given_truth", "given_power", "message"),
    [
        (np.zeros((3, 3)), None, r"true places have shape \(3, 3\); \(2, 3\) is needed"),
        (None, np.zeros(1), r"transmit powers have shape \(1,\); \(2,\) is needed"),
    ],
)
def test_truth_of_another_shape_is_refused(draw, given_truth, given_power, message: str) -> None:
    drawn = draw(2, (0, 0, 0, 0), 75)
    with pytest.raises(InputError, match=message):
        Batch.of(drawn.links, drawn.area, MODEL, None, given_truth, given_power)


@settings(max_examples=50, derandomize=True, deadline=None)
@given(st.lists(st.lists(st.booleans(), min_size=4, max_size=4), min_size=1, max_size=12))
def test_selected_links_are_each_chosen_link_once(rows: list[list[bool]]) -> None:
    which = np.array(rows)
    seen = np.zeros(which.shape, dtype=int)
    for numbers, columns in selected(which):
        assert (np.diff(columns, axis=1) > 0).all()
        for row, chosen in zip(numbers, columns, strict=True):
            seen[row, chosen] += 1
    assert np.array_equal(seen, which.astype(int))


def test_scattered_answers_lie_where_they_belong(draw) -> None:
    drawn = draw(3, (0, 0, 0, 0), 76)
    batch = Batch.of(drawn.links, drawn.area, MODEL)
    part = Answers.closed_form(
        batch.rows([2, 0]), np.array([[1.0, 2, 3], [4, 5, np.nan]]), np.array([7.0, 8.0]), np.ones((2, 4))
    )
    whole = scattered(3, 4, [(np.array([2, 0]), part)])
    assert whole.status == ["no finite answer", "not solved", "ok"]
    assert np.array_equal(whole.transmit_power_dbm, [8.0, np.nan, 7.0], equal_nan=True)
    assert whole.position_enu_m[2].tolist() == [1.0, 2.0, 3.0]
    assert np.isnan(whole.position_enu_m[1]).all()
    assert whole.covariance_m2 is None
