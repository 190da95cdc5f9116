import math
from dataclasses import replace

import numpy as np
import pytest

from groundstation.localization import Links, SearchArea, SignalModel, crlb
from sim_sitl.studies.cases import CASES, END_TO_END, LOS, MIXED, NLOS, Case
from sim_sitl.studies.channels import AngleReport
from sim_sitl.studies.geometry import DatasetRows, Ring, draw_targets, ring_enu_m
from sim_sitl.studies.laws import Law, law_of
from sim_sitl.studies.limits import (
    Knowledge,
    StatePrior,
    crlb_square_m2,
    posterior_moments,
    posterior_square_m2,
)
from sim_sitl.studies.trials import Trials


def rmse(square):
    return math.sqrt(np.mean(square))


def blind_law():
    """Received power that says nothing."""
    table = np.full(16_001, 1e-3)
    return Law(
        np.array([15.0]), np.array([15.0]), np.ones(1), np.ones(1), np.array([2.0]), table[None, None], 2.0,
        table,
    )  # fmt: skip


def test_without_evidence_the_limit_is_always_the_centre():
    trials = CASES["nlos-k4"].draw(100, np.random.default_rng(1))
    mean, trace = posterior_moments(trials, Knowledge(blind_law(), AngleReport()), np.random.default_rng(2))
    assert np.abs(mean - [0.0, 0.0, 10.5]).max() < 1.0
    # √(R²/2 + 19²/12): 70.7 m horizontally, 5.5 m in height.
    assert np.sqrt(trace) == pytest.approx(math.hypot(70.711, 5.485), rel=0.01)


def test_one_bearing_gives_the_posterior_of_its_beam():
    """Against a fine grid over azimuth, elevation and height, with power that says nothing."""
    vehicle, std = np.array([100.0, 0.0, 50.0]), math.radians(1.0)
    azimuth, elevation = math.radians(165.0), math.radians(-20.0)
    one = np.ones((1, 1))
    links = Links(vehicle[None, None], -40.0 * one, azimuth * one, elevation * one, one)
    area = SearchArea(np.zeros(2), 100.0, 1.0, 20.0)
    trials = Trials(
        links, np.zeros((1, 3)), area, SignalModel(), np.array([15.0]), np.array([7.0]), np.ones((1, 1), bool)
    )
    mean, trace = posterior_moments(
        trials, Knowledge(blind_law(), AngleReport()), np.random.default_rng(3), 10_000
    )
    axis = np.arange(-100.0, 100.0, 1.0) + 0.5
    east, north, up = np.meshgrid(axis, axis, np.arange(1.25, 20.0, 0.5), indexing="ij")
    gap = np.stack([east, north, up], axis=-1) - vehicle
    seen = np.arctan2(gap[..., 2], np.hypot(gap[..., 0], gap[..., 1]))
    off = np.angle(np.exp(1j * (np.arctan2(gap[..., 1], gap[..., 0]) - azimuth)))
    weight = np.exp(-0.5 * (off**2 + (seen - elevation) ** 2) / std**2) * (np.hypot(east, north) <= 100.0)
    weight /= weight.sum()
    place = np.stack([east, north, up], axis=-1)
    expected = np.einsum("abc,abcd->d", weight, place)
    spread = np.einsum("abc,abcd->", weight, np.square(place - expected))
    assert mean[0] == pytest.approx(expected, abs=0.25)
    assert trace[0] == pytest.approx(spread, rel=0.03)


def test_the_limit_meets_the_bound_where_the_prior_says_little():
    """LOS, K = 7: the exact posterior and the CRLB are two ways to the same figure."""
    case = CASES["los-k7"]
    trials = case.draw(120, np.random.default_rng(4))
    exact = rmse(posterior_square_m2(trials, case.knowledge(), np.random.default_rng(5), 1024))
    assert exact == pytest.approx(rmse(crlb_square_m2(trials)), rel=0.12)


def test_the_bound_is_the_trace_of_the_crlb():
    trials = CASES["los-k4"].draw(20, np.random.default_rng(6))
    square = crlb_square_m2(trials)
    assert square[7] == pytest.approx(
        np.trace(crlb(trials.truth_enu_m[7], trials.links.position_enu_m[7], trials.model))
    )


def test_the_los_bound_is_that_of_the_paper_geometry():
    trials = CASES["los-k4"].draw(4000, np.random.default_rng(7))
    assert rmse(crlb_square_m2(trials)) == pytest.approx(1.88, abs=0.02)


@pytest.mark.parametrize("name", ["nlos-k4", "mixed-k4", "nlos-k7", "nlos-rubble-k4", "nlos-per-link-k4"])
def test_the_posterior_is_right_about_itself(name):
    """Bayes: over trials that came about as it believes, its squared error is its variance."""
    case = CASES[name]
    trials = case.draw(60 if "rubble" in name else 200, np.random.default_rng(8))
    mean, trace = posterior_moments(trials, case.knowledge(), np.random.default_rng(9), 192)
    excess = np.square(mean - trials.truth_enu_m).sum(axis=1) - trace
    assert abs(excess.mean()) < 3.5 * excess.std() / math.sqrt(trials.count)


def test_half_the_candidates_give_the_same_limit():
    case = CASES["mixed-k4"]
    trials = case.draw(120, np.random.default_rng(10))
    half, whole = (
        rmse(posterior_square_m2(trials, case.knowledge(), np.random.default_rng(11), count))
        for count in (256, 512)
    )
    assert half == pytest.approx(whole, rel=0.02)


def test_more_information_never_makes_the_limit_worse():
    """The same trials: no power, power, power with the one true bearing."""
    case = Case("test", "", "mixed", MIXED)
    trials = case.draw(150, np.random.default_rng(12))
    known = case.knowledge()
    hidden = replace(trials, links=replace(trials.links, los_probability=np.zeros_like(trials.links.rss_dbm)))
    blind = rmse(np.square(trials.truth_enu_m - [0.0, 0.0, 10.5]).sum(axis=1))
    power = rmse(posterior_square_m2(hidden, known, np.random.default_rng(13), 256))
    bearing = rmse(posterior_square_m2(trials, known, np.random.default_rng(13), 256))
    assert bearing < 0.5 * power < 0.5 * blind


def test_sure_labels_are_worth_what_true_labels_are():
    case = Case("test", "", "end to end", END_TO_END)
    trials = case.draw(40, np.random.default_rng(14))
    known = case.knowledge()

    def sure(probability):
        return np.where(probability > 0.5, 1e7, 1e-7)

    told = posterior_moments(trials, known, np.random.default_rng(15), 1024)[0]
    weighed = posterior_moments(
        trials, replace(known, states=END_TO_END.prior(4), odds=sure), np.random.default_rng(15), 2048
    )[0]
    assert rmse(np.square(told - weighed).sum(axis=1)) < 1.5


def test_bearings_alone_tell_most_of_the_states():
    """With labels that say nothing the limit loses little: angles that agree are line of sight."""
    case = Case("test", "", "end to end", END_TO_END)
    trials = case.draw(100, np.random.default_rng(16))
    known = case.knowledge()
    blind = replace(known, states=END_TO_END.prior(4), odds=np.ones_like)
    told = rmse(posterior_square_m2(trials, known, np.random.default_rng(17), 768))
    untold = rmse(posterior_square_m2(trials, blind, np.random.default_rng(17), 768))
    assert told < untold < 1.35 * told


def test_rounded_angles_are_weighed_as_rounded():
    case = Case("test", "", "mixed", MIXED, angles=AngleReport(0.0, 1.0))
    trials = case.draw(150, np.random.default_rng(18))
    mean, trace = posterior_moments(trials, case.knowledge(), np.random.default_rng(19), 256)
    excess = np.square(mean - trials.truth_enu_m).sum(axis=1) - trace
    assert abs(excess.mean()) < 3.5 * excess.std() / math.sqrt(trials.count)


def test_where_vehicles_stand_tells_where_the_target_is_in_v_d():
    case = Case("test", "", "NLOS", NLOS, DatasetRows())
    trials = case.draw(100, np.random.default_rng(20))
    without = rmse(posterior_square_m2(trials, case.knowledge(), np.random.default_rng(21), 256))
    with_places = rmse(
        posterior_square_m2(trials, case.knowledge(places=True), np.random.default_rng(21), 1024)
    )
    assert with_places < 0.75 * without


def test_bearings_that_miss_the_area_leave_the_priors_mean():
    target = draw_targets(3, 100.0, np.random.default_rng(22))
    vehicles = np.broadcast_to(ring_enu_m(4, 100.0), (3, 4, 3))
    up = np.full((3, 4), 0.8)
    probability = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    trials = Trials(
        Links(vehicles, np.full((3, 4), -40.0), up, up, probability), target,
        SearchArea(np.zeros(2), 100.0, 1.0, 20.0), SignalModel(), np.full(3, 15.0), np.full(3, 7.0),
        probability > 0.5,
    )  # fmt: skip
    mean, trace = posterior_moments(
        trials, Case("t", "", "mixed", MIXED).knowledge(), np.random.default_rng(0)
    )
    assert mean.tolist() == [[0.0, 0.0, 10.5]] * 3
    assert trace.tolist() == [0.0] * 3


def test_prior_over_states_is_the_cases():
    prior = END_TO_END.prior(4)
    assert isinstance(prior, StatePrior)
    assert prior.weight.sum() == pytest.approx(1.0)
    assert prior.line_of_sight.sum(axis=1).tolist() == [4, 0, 1, 1, 1, 1]
    assert prior.weight.tolist() == pytest.approx([0.15, 0.25, 0.15, 0.15, 0.15, 0.15])
    assert LOS.prior(3).line_of_sight.tolist() == [[True] * 3]
    assert law_of(Case("t", "", "LOS", LOS, Ring()).channel).los_exponent == 2.5
