from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from groundstation.localization import bearings
from groundstation.localization.bearings import Bearings, angle_log_likelihood
from groundstation.localization.mesh import Mesh
from groundstation.localization.problem import SignalModel
from groundstation.localization.whitening import Observations

CERTAIN = SignalModel(angle_outlier_probability=0.0, angle_bias_std_rad=0.02, los_shares=(0.5,))
WHITE = 0.015
TRUTH = np.array([12.0, -7.0, 4.0])


def flight(
    count: int,
    vehicles: int = 1,
    error_rad: float = 0.0,
    p: float = 1.0,
    weight: float = 1.0,
    noise_rad: float = WHITE,
) -> Observations:
    """Vehicles in turn on a ring, bearings to TRUTH: white noise plus ``error_rad``."""
    rng = np.random.default_rng(3)
    turn = np.linspace(0.0, 4.0, count)
    place = np.stack([90 * np.cos(turn), 90 * np.sin(turn), np.full(count, 50.0)], axis=1)
    offset = TRUTH - place
    noise = error_rad + noise_rad * rng.standard_normal((2, count))
    none = np.full(count, np.nan)
    return Observations(
        place, np.arange(count) % vehicles, none, np.zeros(count), np.ones(count),
        np.arctan2(offset[:, 1], offset[:, 0]) + noise[0],
        np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1])) + noise[1],
        np.full((count, 2), WHITE), np.full(count, p), np.full(count, weight), np.full((count, 1), -1),
        np.zeros((count, 2)),
    )  # fmt: skip


def shown(seen: Observations, count: int) -> Observations:
    return Observations(*(getattr(seen, name)[:count] for name in Observations.__dataclass_fields__))


def points(count: int, spread: float, seed: int = 5) -> np.ndarray:
    return TRUTH + spread * np.random.default_rng(seed).standard_normal((count, 3)) * [1, 1, 0.3]


def small(count: int) -> np.ndarray:
    return np.full((count, 2), 1e-3)


@pytest.mark.parametrize("vehicles", [1, 2])
def test_certain_bearings_are_the_multivariate_normal(vehicles: int) -> None:
    """White and constant errors as one covariance a vehicle: differences agree to 1e-4."""
    seen = flight(9, vehicles, error_rad=0.02)
    candidates = points(6, 1.5)
    ours = angle_log_likelihood(seen, 0, candidates, small(6), CERTAIN)[0]
    same = seen.link[:, None] == seen.link
    covariance = WHITE**2 * np.eye(9) + CERTAIN.angle_bias_std_rad**2 * same
    dense = []
    for x in candidates:
        offset = x - seen.position_enu_m
        turn = seen.azimuth_rad - np.arctan2(offset[:, 1], offset[:, 0])
        lift = seen.elevation_rad - np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1]))
        residuals = np.arctan2(np.sin(turn), np.cos(turn)), lift
        dense.append(sum(multivariate_normal(np.zeros(9), covariance).logpdf(r) for r in residuals))
    assert np.allclose(ours - ours[0], np.array(dense) - dense[0], atol=1e-4)


def test_a_vehicle_that_is_not_where_it_says_turns_near_bearings_most() -> None:
    """One bearing a vehicle, 1 m and 3 m off: a Gaussian of white, constant and turned by the place."""
    seen = flight(6, 6)
    seen.position_enu_m[:] *= np.array([0.1, 0.2, 0.4, 0.6, 0.8, 1.0])[:, None]
    offset = TRUTH - seen.position_enu_m
    turned = np.arctan2(offset[:, 1], offset[:, 0])
    lifted = np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1]))
    seen.azimuth_rad[:], seen.elevation_rad[:] = turned + 0.01, lifted - 0.02
    flat2 = (offset[:, :2] ** 2).sum(axis=1)
    all2 = flat2 + offset[:, 2] ** 2
    own = WHITE**2 + CERTAIN.angle_bias_std_rad**2
    turn2 = own + 1.0 / flat2
    lift2 = own + (1.0 * offset[:, 2] ** 2 + 9.0 * flat2) / all2**2
    expected = -0.5 * (0.01**2 / turn2 + 0.02**2 / lift2) - np.log(2.0 * np.pi * np.sqrt(turn2 * lift2))
    for row in range(6):
        one = Observations(*(getattr(seen, name)[[row]] for name in Observations.__dataclass_fields__))
        one.link[:] = 0
        both = [
            angle_log_likelihood(
                replace(one, place_variance_m2=np.array([place])), 0, TRUTH[None], small(1), CERTAIN
            )[0, 0]
            for place in ((1.0, 9.0), (0.0, 0.0))
        ]
        plain = -0.5 * (0.01**2 + 0.02**2) / own - np.log(2.0 * np.pi * own)
        # What a bearing may claim is the same for both, its density is not.
        assert both[0] - both[1] == pytest.approx(expected[row] - plain, abs=2e-3)
    sides = TRUTH + np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    first = shown(seen, 1)
    vague = replace(first, place_variance_m2=np.array([[1.0, 9.0]]))
    told = [angle_log_likelihood(one, 0, sides, small(2), CERTAIN)[0] for one in (vague, first)]
    assert told[0][0] - told[0][1] < 0.2 * (told[1][0] - told[1][1])


def test_a_constant_error_shows_itself_when_the_geometry_changes() -> None:
    """0.05 rad off, σ 0.02: after an arc of 4 rad the truth is likelier than where the first ray goes."""
    seen = flight(40, error_rad=0.05)
    spots = TRUTH + np.array([[0.0, 0.0, 0.0], [0.0, 4.5, 0.0], [0.0, -4.5, 0.0]])
    mesh = Mesh(spots, small(3), np.zeros(3))
    log, errors = np.zeros((1, 3)), Bearings.empty(3, 1, CERTAIN)
    errors.add(seen, 0, mesh, CERTAIN, log)
    assert log[0, 0] > log[0, 1:].max() + 5.0
    np.testing.assert_allclose(errors.mean[:, 0, 0], 0.05, atol=0.01)
    assert (errors.variance[:, 0, 0] < 0.2 * CERTAIN.angle_bias_std_rad**2).all()


def test_batches_and_vehicles_that_come_later_do_not_matter() -> None:
    seen = flight(12, 3, error_rad=0.01, p=0.8)
    model = replace(CERTAIN, angle_outlier_probability=0.05, los_shares=(0.2, 0.8))
    candidates = points(5, 1.0)
    mesh = Mesh(candidates, small(5), np.zeros(5))
    log, errors = np.zeros((2, 5)), Bearings.empty(5, 0, model)
    for first, last in [(0, 1), (1, 5), (5, 12)]:
        part = shown(seen, last)
        errors.grow(int(part.link.max()) + 1, model)
        errors.add(part, first, mesh, model, log)
    whole = angle_log_likelihood(seen, 0, candidates, small(5), model)
    # The order in which vehicles speak up moves the weights of π a little, and nothing else.
    np.testing.assert_allclose(log - log[:, :1], whole - whole[:, :1], atol=0.05)


def test_rounds_worked_out_together_are_those_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Vehicles with windows more or fewer, places on and off the rays: the same bits."""
    seen = flight(17, 3, error_rad=0.01, p=0.8)
    seen.link[:] = [0, 1, 1, 2, 0, 0, 1, 0, 2, 1, 0, 0, 0, 1, 0, 2, 0]
    seen.azimuth_rad[3] += 1.0
    model = replace(CERTAIN, angle_outlier_probability=0.05, los_shares=(0.2, 0.8))
    mesh = Mesh(points(40, 30.0), np.full((40, 2), 2.0), np.zeros(40))
    told = []
    for at_once in (1, 200, 100_000):
        monkeypatch.setattr(bearings, "_PAIRS", at_once)
        log, errors = np.zeros((2, 40)), Bearings.empty(40, 3, model)
        errors.add(seen, 0, mesh, model, log)
        told.append((log, errors.mean, errors.variance))
    for other in told[1:]:
        for one, two in zip(told[0], other, strict=True):
            np.testing.assert_allclose(two, one, rtol=1e-5, atol=1e-6)
    # And as if every vehicle's windows had come one batch at a time.
    log, errors = np.zeros((2, 40)), Bearings.empty(40, 3, model)
    turns = np.array([(seen.link[:row] == seen.link[row]).sum() for row in range(17)])
    for turn in range(turns.max() + 1):
        chosen = np.flatnonzero(turns == turn)
        part = Observations(*(getattr(seen, name)[chosen] for name in Observations.__dataclass_fields__))
        errors.add(part, 0, mesh, model, log)
    np.testing.assert_allclose(log, told[0][0], rtol=1e-5)
    np.testing.assert_allclose(errors.mean, told[0][1], rtol=1e-5, atol=1e-7)


def test_a_stray_bearing_teaches_nothing_about_the_compass() -> None:
    seen = flight(10, error_rad=0.01, p=0.95)
    seen.azimuth_rad[6] += 1.5
    model = replace(CERTAIN, angle_outlier_probability=0.05)
    mesh = Mesh(TRUTH[None], small(1), np.zeros(1))
    errors = [Bearings.empty(1, 1, model) for _ in range(2)]
    errors[0].add(shown(seen, 6), 0, mesh, model, np.zeros((1, 1)))
    before = errors[0].mean.copy()
    errors[0].add(shown(seen, 7), 6, mesh, model, np.zeros((1, 1)))
    np.testing.assert_allclose(errors[0].mean, before, atol=1e-6)


def test_a_bearing_that_may_be_a_stray_leaves_the_spread_of_both_cases() -> None:
    """About as likely a reflection as not: mean and variance of the compass are the mixture's."""
    seen = flight(1, p=0.5, noise_rad=0.0)
    seen.azimuth_rad[0] += 0.1
    model = replace(CERTAIN, angle_outlier_probability=0.05)
    log, errors = np.zeros((1, 1)), Bearings.empty(1, 1, model)
    errors.add(seen, 0, Mesh(TRUTH[None], small(1), np.zeros(1)), model, log)
    prior = CERTAIN.angle_bias_std_rad**2
    total, gain = WHITE**2 + prior, prior / (WHITE**2 + prior)
    density = multivariate_normal([0.0, 0.0], total * np.eye(2)).pdf([0.1, 0.0])
    right, stray = 0.5 * 0.95 * density, (0.5 * 0.05 + 0.5) / (2.0 * np.pi**2)
    genuine = right / (right + stray)
    assert 0.3 < genuine < 0.9
    moved = gain * 0.1
    second = (1.0 - genuine) * prior + genuine * (prior * (1.0 - gain) + moved**2)
    np.testing.assert_allclose(errors.mean[0, 0, 0], genuine * moved, rtol=1e-4)
    np.testing.assert_allclose(errors.variance[0, 0, 0], second - (genuine * moved) ** 2, rtol=1e-4)


def test_bearings_from_one_place_claim_little_but_keep_their_shape() -> None:
    """Weight 0.02 each: ten claim a third over a far place, and say the same near the ray."""
    model = replace(CERTAIN, angle_outlier_probability=0.05)
    spots = TRUTH + np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-60.0, 30.0, 0.0]])

    def claims(weight: float) -> np.ndarray:
        seen = flight(10, p=0.95, weight=weight, noise_rad=0.0)
        log = angle_log_likelihood(seen, 0, spots, small(3), model)[0]
        return log[0] - log[1:]

    near, far = claims(0.02) / claims(1.0)
    assert near > 0.7
    assert far < 0.4


def test_state_goes_and_comes_back() -> None:
    model = replace(CERTAIN, los_shares=(0.5,))
    mesh = Mesh(points(4, 3.0), small(4), np.zeros(4))
    errors = Bearings.empty(4, 1, model)
    errors.add(flight(5), 0, mesh, model, np.zeros((1, 4)))
    again = Bearings.restore(errors.state())
    assert (again.mean == errors.mean).all()
    assert (again.variance == errors.variance).all()
    both = Bearings.gathered([errors, again], np.array([6, 1]))
    assert (both.mean == errors.mean[..., [2, 1]]).all()
