import math

import numpy as np
import pytest

from sim_sitl.dataset.options import DatasetOptions, dataset_sounder
from sim_sitl.dataset.rows import NOISE_DENSITY_DBM_HZ, PROCESSING_GAIN_DB, link_rows
from sim_sitl.studies import end_to_end
from sim_sitl.studies.end_to_end import (
    CLOSE_IN_1M_DB,
    DatasetChannel,
    calibration_rows,
    draw_rows,
    label_odds,
    shipped_classifier,
)

CHANNEL = DatasetChannel(calibration_links=100)


@pytest.fixture(scope="module")
def rows():
    states = np.repeat([[True, False]], 40, axis=0)
    return states, draw_rows(states, np.random.default_rng(1))


def test_the_classifier_tells_the_states_apart(rows):
    states, drawn = rows
    clear, obstructed = drawn.los_probability[states], drawn.los_probability[~states]
    assert ((drawn.los_probability >= 0.0) & (drawn.los_probability <= 1.0)).all()
    ranked = (clear[:, None] > obstructed).mean() + 0.5 * (clear[:, None] == obstructed).mean()
    assert ranked > 0.7


def test_rows_come_from_the_generator_alone():
    states = np.array([[True, False], [False, True]])
    first, again = (draw_rows(states, np.random.default_rng(2), packets=1) for _ in range(2))
    other = draw_rows(states, np.random.default_rng(3), packets=1)
    assert (first.excess_db == again.excess_db).all()
    assert (first.los_probability == again.los_probability).all()
    assert not np.any(first.excess_db == other.excess_db)


def test_offsets_are_the_data_sets(rows):
    _, drawn = rows
    range_m = np.linalg.norm(drawn.offset_m, axis=-1)
    # A link's newest packet is up to 3.3 m from where its distance was drawn.
    assert range_m.min() > 6.0
    assert range_m.max() < 204.0
    assert drawn.offset_m[..., 2].min() >= 0.0
    assert drawn.offset_m[..., 2].max() <= 20.0


def test_power_is_the_signals_of_the_row_itself():
    """Without noise a row's total received power is the signal's."""
    options = DatasetOptions(sounder=dataset_sounder(), packets_per_link=1)
    for seed in range(40):
        row = link_rows(np.random.default_rng(seed), 0, options)
        columns = {name: float(values[0]) for name, values in row.columns.items() if name != "label"}
        signal = (
            end_to_end._excess_db(row, True) + columns["transmit_power_dbm"] - CLOSE_IN_1M_DB
            - 20.0 * math.log10(columns["range_m"])
        )  # fmt: skip
        floor = NOISE_DENSITY_DBM_HZ + 10.0 * math.log10(columns["bandwidth_hz"]) - PROCESSING_GAIN_DB
        if signal > floor + 45.0:
            assert columns["total_received_power_dbm"] == pytest.approx(signal, abs=1.5)
            break
    else:
        pytest.fail("no strong row in forty")


def test_excess_is_that_of_the_calibrations_links(rows):
    states, drawn = rows
    for state in (True, False):
        sample, calibration = drawn.excess_db[states == state], calibration_rows(100)[state].excess_db
        spread = math.sqrt(sample.var() / sample.size + calibration.var() / calibration.size)
        assert abs(sample.mean() - calibration.mean()) < 4.0 * spread


def test_solvers_see_los_links_on_the_scale_of_eq_7():
    offset = np.zeros((200, 2, 3))
    offset[..., 0] = 50.0
    states = np.repeat([[True, False]], 200, axis=0)
    loss = CHANNEL.loss_db(offset, states, np.random.default_rng(4))
    told = CHANNEL.told
    assert told.los_exponent == 2.0
    # Four standard errors of 200 links against the 100 of the calibration.
    error = 4.0 * math.sqrt(1.0 / 200.0 + 1.0 / 100.0)
    assert loss[:, 0].mean() == pytest.approx(20.0 * math.log10(50.0), abs=error * told.rss_std_db)
    obstructed = math.hypot(told.nlos_rss_std_db, told.nlos_bias_max_db / math.sqrt(12.0))
    expected = 29.0 * math.log10(50.0) + 0.5 * told.nlos_bias_max_db
    assert loss[:, 1].mean() == pytest.approx(expected, abs=error * obstructed)
    assert loss[:, 1].std() == pytest.approx(obstructed, rel=0.35)


def test_the_same_rows_lose_more_farther_off(rows):
    states, drawn = rows
    near, far = np.zeros((40, 2, 3)), np.zeros((40, 2, 3))
    near[..., 0], far[..., 0] = 10.0, 100.0
    more = CHANNEL.loss_of(drawn, far, states) - CHANNEL.loss_of(drawn, near, states)
    assert more[states] == pytest.approx(20.0)
    assert more[~states] == pytest.approx(29.0)


def test_labels_are_worth_what_they_show_on_other_links():
    probability = np.array([0.0, 0.01, 0.3, 0.7, 0.99, 1.0])
    odds = label_odds(probability, links=40)
    assert (np.diff(odds) >= 0.0).all()
    assert odds[0] < 0.7
    assert odds[-1] > 1.5
    # Forty links of each state cannot show more than eighty to one.
    assert odds[-1] <= 81.0 + 1e-9


def test_the_bound_told_to_robust_solvers_is_as_wide_as_the_papers():
    low, high = CHANNEL.bias_max_db
    assert high - low == pytest.approx(2.0)
    assert 0.5 * (low + high) == pytest.approx(CHANNEL.told.nlos_bias_max_db)


def test_the_classifier_is_loaded_once():
    assert shipped_classifier() is shipped_classifier()
