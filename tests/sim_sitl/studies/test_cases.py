import pickle
from dataclasses import fields, replace

import numpy as np
import pytest

from groundstation.localization import Links
from sim_sitl.studies.cases import CASES, END_TO_END, ENVIRONMENTS, LOS, MIXED, NLOS, RADII_M, VEHICLES
from sim_sitl.studies.end_to_end import DatasetChannel


def small(case):
    """The case with a calibration that takes no time."""
    if isinstance(case.channel, DatasetChannel):
        return replace(case, channel=DatasetChannel(calibration_links=40))
    return case


def same(first, second):
    return all(
        np.array_equal(getattr(first.links, field.name), getattr(second.links, field.name))
        for field in fields(Links)
    )


@pytest.mark.parametrize("name", CASES)
def test_every_case_draws_what_it_says(name):
    case = small(pickle.loads(pickle.dumps(CASES[name])))
    assert case.name == name
    assert case.environment in ENVIRONMENTS
    trials = case.draw(5, np.random.default_rng(1))
    assert trials.links.rss_dbm.shape == (5, case.vehicles)
    for values in (trials.links.rss_dbm, trials.links.azimuth_rad, trials.links.elevation_rad):
        assert np.isfinite(values).all()
    assert trials.area.radius_m == case.radius_m
    assert trials.area.contains(trials.truth_enu_m[:, 0], trials.truth_enu_m[:, 1]).all()
    assert ((trials.truth_enu_m[:, 2] >= 1.0) & (trials.truth_enu_m[:, 2] <= 20.0)).all()
    assert trials.model.azimuth_std_rad == pytest.approx(case.angles.told_std_rad)
    assert ((trials.transmit_power_dbm >= 13.0) & (trials.transmit_power_dbm <= 18.0)).all()
    if not case.classified:
        assert (trials.links.los_probability == trials.line_of_sight).all()
    if not isinstance(case.channel, DatasetChannel):
        assert ((trials.bias_max_db >= 6.0) & (trials.bias_max_db <= 8.0)).all()


@pytest.mark.parametrize(
    "name", ["los-k5", "nlos-rubble-k4", "mixed-r300", "hard-k2-nlos", "end-to-end-analytic"]
)
def test_the_generator_decides_the_trials(name):
    case = CASES[name]
    first, again, other = (case.draw(4, np.random.default_rng(seed)) for seed in (2, 2, 3))
    assert same(first, again)
    assert (first.truth_enu_m == again.truth_enu_m).all()
    assert not same(first, other)


def test_the_limit_is_decided_by_its_generator_too():
    case = CASES["mixed-k4"]
    trials = case.draw(10, np.random.default_rng(4))
    first, again = (case.limit_square_m2(trials, np.random.default_rng(5)) for _ in range(2))
    assert first.shape == (10,)
    assert (first == again).all()


@pytest.mark.parametrize(("states", "name"), [(LOS, "all"), (NLOS, "none"), (MIXED, "one")])
def test_states_are_all_none_or_exactly_one(states, name):
    drawn = states.draw(400, 4, np.random.default_rng(6)).sum(axis=1)
    assert set(drawn) == {{"all": 4, "none": 0, "one": 1}[name]}


def test_the_one_los_link_is_any_of_them():
    drawn = MIXED.draw(8000, 4, np.random.default_rng(7))
    assert drawn.mean(axis=0) == pytest.approx([0.25] * 4, abs=0.02)


def test_end_to_end_states_are_15_25_60():
    count = END_TO_END.draw(20_000, 4, np.random.default_rng(8)).sum(axis=1)
    shares = [np.mean(count == number) for number in (4, 0, 1)]
    assert shares == pytest.approx([0.15, 0.25, 0.60], abs=0.01)


def test_the_papers_figures_have_their_cases():
    for stem in ("los", "los-3deg", "nlos", "nlos-rubble", "mixed"):
        assert [CASES[f"{stem}-k{count}"].vehicles for count in VEHICLES] == [4, 5, 6, 7]
        assert [CASES[f"{stem}-r{radius:g}"].radius_m for radius in RADII_M] == list(RADII_M)
    assert {case.environment for case in CASES.values()} == set(ENVIRONMENTS)


def test_the_limit_is_named_for_what_it_is():
    assert CASES["los-k4"].limit_name == "CRLB"
    assert CASES["nlos-k4"].limit_name == "exact posterior mean"
    assert "places" in CASES["end-to-end-rows"].limit_name


def test_an_end_to_end_case_has_a_classifiers_labels_and_rounded_angles():
    trials = CASES["end-to-end-analytic"].draw(25, np.random.default_rng(9))
    probability = trials.links.los_probability
    assert np.any((probability > 0.001) & (probability < 0.999))
    assert probability[trials.line_of_sight].mean() > probability[~trials.line_of_sight].mean()
    whole = np.degrees(trials.links.azimuth_rad[trials.line_of_sight])
    assert whole == pytest.approx(np.rint(whole), abs=1e-9)


def test_v_d_puts_the_vehicles_where_the_rows_are():
    case = small(CASES["end-to-end-rows"])
    trials = case.draw(20, np.random.default_rng(10))
    offset = trials.links.position_enu_m - trials.truth_enu_m[:, None, :]
    assert ((offset[..., 2] >= 0.0) & (offset[..., 2] <= 20.0)).all()
    assert np.linalg.norm(offset, axis=-1).max() < 204.0
    zero = small(CASES["end-to-end-rows-zero"]).draw(10, np.random.default_rng(11))
    assert not np.any(zero.links.azimuth_rad[~zero.line_of_sight])


def test_classified_cases_know_the_prior_and_the_worth_of_labels():
    known = CASES["end-to-end-ring"].states.prior(4)
    assert len(known.weight) == 6
    assert CASES["nlos-k4"].knowledge().states is None
    analytic = CASES["end-to-end-analytic"].knowledge(places=True)
    assert analytic.odds is not None
    assert analytic.places is None
