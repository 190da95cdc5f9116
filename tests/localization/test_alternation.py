from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.localization import SignalModel
from groundstation.localization.alternation import (
    SMALLEST_EXPONENT,
    alternate,
    updated_power_and_exponents,
)
from groundstation.localization.batch import Batch
from groundstation.localization.lsre_literal import literal_positions

MODEL = SignalModel()
EAGER = replace(MODEL, position_tolerance_m=1e-9, transmit_power_tolerance_db=1e-9, exponent_tolerance=1e-12)


@pytest.fixture
def batch(draw) -> Batch:
    drawn = draw(30, (1, 0, 0, 0, 0), 41)
    return Batch.of(drawn.links, drawn.area, MODEL)


def test_67_68_70_by_hand(batch: Batch) -> None:
    place = np.tile([12.0, -30.0, 7.0], (30, 1))
    power, exponent = batch.first_power_dbm(), batch.first_exponents()
    got_power, got_exponent = updated_power_and_exponents(batch, place, power, exponent)
    for row in (0, 17):
        d = [np.linalg.norm(a - place[row]) for a in batch.place[row]]
        p = batch.links.rss_dbm[row]
        mean = sum(p[k] + 10 * exponent[row, k] * np.log10(d[k]) for k in range(5)) / 5
        relaxed = 15.0 + 0.5 * (mean - 15.0)
        assert got_power[row] == pytest.approx(relaxed)
        fitted = [(relaxed - p[k]) / (10 * np.log10(d[k])) for k in range(1, 5)]
        assert got_exponent[row] == pytest.approx([MODEL.los_exponent, *fitted])
    unrelaxed, _ = updated_power_and_exponents(batch, place, power, exponent, relaxation=1.0)
    assert unrelaxed - 15.0 == pytest.approx(2.0 * (got_power - 15.0))


def test_after_68_every_residual_is_zero(batch: Batch) -> None:
    """Defect: wherever the place."""
    for place in ([0.0, 0, 10], [60.0, -30, 3], [500.0, 10, 0]):
        at = np.tile(place, (30, 1))
        power, exponent = updated_power_and_exponents(
            batch, at, batch.first_power_dbm(), batch.first_exponents(), every_link=True
        )
        assert batch.rss_cost_db2(at, power, exponent).max() < 1e-20


def test_at_one_metre_68_does_not_divide_by_zero(batch: Batch) -> None:
    for gap in (1.0, 0.3, 0.0):
        at = batch.place[:, 1] - [0.0, 0.0, gap]
        power, exponent = updated_power_and_exponents(
            batch, at, batch.first_power_dbm(), batch.first_exponents()
        )
        assert np.isfinite(power).all()
        assert np.isfinite(exponent).all()
        assert (exponent[:, 1] == MODEL.first_exponent).all()


def test_exponent_stays_positive_where_more_arrives_than_was_sent(batch: Batch) -> None:
    loud = replace(batch, links=replace(batch.links, rss_dbm=batch.links.rss_dbm + 200.0))
    _, exponent = updated_power_and_exponents(
        loud, np.zeros((30, 3)), np.full(30, -500.0), loud.first_exponents()
    )
    assert (exponent[:, 1:] == SMALLEST_EXPONENT).all()


def test_known_power_stays(batch: Batch) -> None:
    known = replace(batch, model=replace(MODEL, known_transmit_power_dbm=16.5))
    answers = alternate(known, literal_positions)
    assert (answers.transmit_power_dbm == 16.5).all()


def test_stops_where_the_place_settles(batch: Batch) -> None:
    still = alternate(
        replace(batch, model=replace(EAGER, position_tolerance_m=0.1)), lambda b, p, x: np.zeros((b.size, 3))
    )
    assert (still.iterations == 2).all()
    assert set(still.status) == {"ok"}


def test_stops_where_the_parameters_settle(batch: Batch) -> None:
    loose = replace(EAGER, transmit_power_tolerance_db=100.0, exponent_tolerance=100.0)
    assert (alternate(replace(batch, model=loose), literal_positions).iterations == 1).all()
    half = replace(loose, exponent_tolerance=1e-12)
    assert (alternate(replace(batch, model=half), literal_positions).iterations > 1).all()


def test_stops_at_the_limit(batch: Batch) -> None:
    few = replace(EAGER, maximum_iterations=3, diverging_rounds=99)
    answers = alternate(replace(batch, model=few), literal_positions)
    assert (answers.iterations == 3).all()
    assert set(answers.status) == {"iteration limit"}


def test_stops_where_the_cost_rises_three_times_running(draw) -> None:
    """Powers that fit the ring's middle, and places that walk from there to a vehicle: J rises each round."""
    drawn = draw(4, (1, 1, 1, 1), 42)
    middle = np.array([0.0, 0.0, 10.0])
    gap = np.linalg.norm(drawn.links.position_enu_m - middle, axis=-1)
    links = replace(drawn.links, rss_dbm=15.0 - 25.0 * np.log10(gap))
    never = replace(
        MODEL, known_transmit_power_dbm=15.0, position_tolerance_m=0.0, transmit_power_tolerance_db=0.0
    )
    batch = Batch.of(links, drawn.area, never)
    reach = iter([0.0, 0.1, 0.2, 0.5, 0.6, 0.7])

    def walk(part: Batch, power: np.ndarray, exponent: np.ndarray) -> np.ndarray:
        return middle + next(reach) * (part.place[:, 0] - middle)

    answers = alternate(batch, walk)
    assert set(answers.status) == {"diverging"}
    assert (answers.iterations == 1 + MODEL.diverging_rounds).all()


def test_what_the_program_cannot_answer_is_marked_and_left(batch: Batch) -> None:
    def half(part: Batch, power: np.ndarray, exponent: np.ndarray) -> np.ndarray:
        place = literal_positions(part, power, exponent)
        return np.where(part.links.rss_dbm[:, :1] > np.median(batch.links.rss_dbm[:, 0]), np.nan, place)

    answers = alternate(batch, half)
    lost = np.isnan(answers.position_enu_m).any(axis=1)
    assert lost.sum() == 15
    assert [answers.status[row] for row in np.flatnonzero(lost)] == ["no finite answer"] * 15
    whole = alternate(batch, literal_positions)
    assert (answers.position_enu_m[~lost] == whole.position_enu_m[~lost]).all()


def test_batch_is_the_loop(batch: Batch) -> None:
    """Problems that stop early do not disturb the others."""
    whole = alternate(batch, literal_positions)
    assert len(set(whole.iterations)) > 2
    for row in range(batch.size):
        one = alternate(batch.rows([row]), literal_positions)
        assert one.position_enu_m[0] == pytest.approx(whole.position_enu_m[row], abs=1e-9)
        assert one.iterations[0] == whole.iterations[row]
        assert one.status[0] == whole.status[row]
