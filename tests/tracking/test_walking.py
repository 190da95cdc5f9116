from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.localization import SERVICE_MODEL, SearchArea, SignalModel
from groundstation.localization.regression import Evidence
from groundstation.localization.whitening import whiten
from groundstation.tracking import Belief, TrackingSettings, TrackObservation, walking
from groundstation.tracking.history import History
from groundstation.tracking.walking import Scored, Walk
from groundstation.tracking.walking_points import Points, drawn, losses_db
from groundstation.tracking.walking_windows import Windows, latest, newest, related

PAPER = SignalModel(nlos_bias_max_db=8.0)
SETTINGS = TrackingSettings(sample_std_db=0.3)
AREA = SearchArea(np.zeros(2), 100.0, 1.0, 20.0)


def heard(
    vehicle: int, east_m: float, north_m: float, rss_dbm: float | None, time_s: float
) -> TrackObservation:
    return TrackObservation(
        vehicle, (east_m, north_m, 50.0), rss_dbm, None, None, None, None, None, 0.0, True, time_s
    )


def flight(seconds: int, vehicles: int = 3) -> list[list[TrackObservation]]:
    rng = np.random.default_rng(8)
    result = []
    for second in range(seconds):
        angle = 0.08 * second + 2.1 * np.arange(vehicles)
        place = 90.0 * np.stack([np.cos(angle), np.sin(angle)])
        level = rng.normal(-45.0, 4.0, vehicles)
        result.append(
            [heard(k + 1, *place[:, k].tolist(), float(level[k]), float(second)) for k in range(vehicles)]
        )
    return result


def test_particles_stay_slow_and_inside() -> None:
    belief = Belief(AREA, PAPER, SETTINGS)
    walk = Walk(AREA, belief.model, replace(SETTINGS, walking_prior=0.9), 1)
    for windows in flight(40):
        belief.update(windows)
        walk.step(windows, belief)
        points = walk.points
        assert (np.hypot(*points.velocity_mps) < SETTINGS.walking_speed_max_mps + 1e-9).all()
        assert (np.hypot(*points.position_enu_m[:2]) < AREA.radius_m + 1e-6).all()
        assert (np.abs(points.position_enu_m[2] - 10.5) <= 9.5).all()
    # Whoever is suspected is followed by more of them.
    assert walk.probability > SETTINGS.walking_suspected
    assert points.count == SETTINGS.walking_particles


def test_nobody_suspected_costs_few_particles() -> None:
    belief = Belief(AREA, PAPER, SETTINGS)
    walk = Walk(AREA, belief.model, replace(SETTINGS, walking_suspected=2.0), 1)
    for windows in flight(12):
        belief.update(windows)
        walk.step(windows, belief)
    assert walk.points.count == SETTINGS.walking_watch_particles < SETTINGS.walking_particles


def test_of_many_vehicles_some_are_listened_to_at_a_step_and_all_in_turn() -> None:
    belief = Belief(AREA, PAPER, SETTINGS)
    settings = replace(SETTINGS, walking_suspected=2.0, walking_watch_vehicles=3)
    walk = Walk(AREA, belief.model, settings, 1)
    heard_at: list[set[int]] = []
    for windows in flight(8, 7):
        belief.update(windows)
        before = dict(zip(walk._past.observations().link, walk._past.time_s, strict=True)) if heard_at else {}
        walk.step(windows, belief)
        after = dict(zip(walk._past.observations().link, walk._past.time_s, strict=True))
        heard_at.append({int(link) for link in after if after[link] != before.get(link)})
        assert set(after) == set(range(7))
    assert [len(some) for some in heard_at] == [7, 3, 3, 3, 3, 3, 3, 3]
    assert set().union(*heard_at[1:4]) == set(range(7))
    # A vehicle that was not heard before is listened to at once.
    late = replace(flight(1, 1)[0][0], vehicle_id=99, time_s=8.0)
    walk.step([replace(w, time_s=8.0) for w in flight(1, 7)[0]] + [late], belief)
    assert walk._past.time_s[-1] == 8.0
    assert walk.vehicles[-1] == 99


def test_whoever_is_suspected_is_listened_to_by_all() -> None:
    belief = Belief(AREA, PAPER, SETTINGS)
    walk = Walk(AREA, belief.model, replace(SETTINGS, walking_prior=0.9, walking_watch_vehicles=3), 1)
    for windows in flight(4, 7):
        belief.update(windows)
        walk.step(windows, belief)
    assert walk.probability > SETTINGS.walking_suspected
    assert (walk._past.time_s == 3.0).all()


def test_of_each_vehicle_the_newest_window_with_power_counts() -> None:
    power, later = (heard(1, 0.0, 0.0, -50.0, time_s) for time_s in (0.0, 1.0))
    mute = replace(power, rss_dbm=None, azimuth_rad=0.1, elevation_rad=0.0, time_s=2.0)
    other = replace(mute, vehicle_id=2)
    assert latest([power, later, other, mute]) == [later, other]
    assert latest([replace(mute, time_s=0.5), mute]) == [mute]


def test_power_foretold_window_by_window_is_the_likelihood_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """The chain rule: of places that do not move, the filter's densities add up to the regression's."""
    monkeypatch.setattr(walking, "_DEGREES", 1e9)
    settings = replace(SETTINGS, parents=1, outlier_std=1e9)
    belief = Belief(AREA, PAPER, settings)
    model = replace(belief.model, shared_shadowing=0.0)
    monkeypatch.setattr(walking, "_PACE_MPS", 0.0)
    walk = Walk(AREA, model, settings)
    place = np.array([[10.0, -50.0], [20.0, 40.0], [5.0, 12.0]])
    orders = np.array([[2.5, 2.5], [2.4, 3.1], [0.0, 0.0]])
    flights = [window for windows in flight(6, 2) for window in windows]
    numbers = History(model, settings)
    past = Windows.of(flights[:2], numbers)
    count = place.shape[1]
    start = Points(
        place, np.zeros((2, count)), orders, np.zeros((3, count)),
        losses_db(place[:, None] - past.observations().position_enu_m.T[:, :, None], False),
        np.zeros((1, count)), np.zeros((2, 2, count)), np.ones((2, 2, count)),
    )  # fmt: skip
    covariance, total, points = np.eye(3), np.zeros(count), start
    walk._past = past
    for first in range(2, len(flights), 2):
        new = Windows.of(flights[first : first + 2], numbers)
        rows = related(walk._past, new, 2, 0.0, model, settings)
        points, angles = walk._bearings_met(points, rows, np.zeros(2))
        points, loss = walk._losses_met(points, rows, np.zeros(2))
        scored = walk._scored(points, loss, angles, covariance, rows)
        total += scored.log_density
        points, covariance = scored.points, scored.covariance
        walk._past = newest(walk._past.then(new), 2)

    # The same rows at once; the first window of each vehicle is only conditioned on, above and here.
    every = Windows.of(flights, numbers).observations()
    parents = np.arange(len(flights))[:, None] - 2
    whole = whiten(replace(every, parents=parents), 2, 2, settings.correlation_m, model)
    losses = Evidence.loss_rows(replace(every, parents=parents), whole, place.T)
    error = whole.level[:, None] + orders[0] * losses[0] + orders[1] * losses[1]
    spread = np.eye(whole.rows.size) + whole.loading @ whole.loading.T
    form = np.einsum("rn,rn->n", error, np.linalg.solve(spread, error))
    assert total[0] - total[1] == pytest.approx(-0.5 * (form[0] - form[1]), rel=1e-4)
    right = whole.loading.T @ error
    mean = np.linalg.solve(np.eye(3) + whole.loading.T @ whole.loading, right)
    np.testing.assert_allclose(points.nuisance, mean, atol=1e-5)


def test_a_level_that_does_not_repeat_itself_costs_a_still_person_little() -> None:
    nobody = Points.none(1, PAPER)

    def scored(*levels: float) -> Scored:
        log, rows = np.array([[level] for level in levels]), len(levels)
        return Scored(log, np.zeros(1), nobody, np.eye(2), np.full(rows, 40.0), np.full(rows, 40.0))

    plain = replace(scored(-2.0, -2.0), misfit=np.full(2, 1.0), typical=np.full(2, 1.5))
    told = scored(-1.0, -60.0).or_else(plain)
    np.testing.assert_allclose(told.power_log[1], -2.0 - np.log(10.0))
    assert -1.2 < told.power_log[0, 0] < -1.0
    # An outlier is judged by whichever explains it better.
    assert told.misfit.tolist() == [1.0, 1.0]
    assert told.typical.tolist() == [1.5, 1.5]


def test_points_drawn_from_a_belief_are_the_belief() -> None:
    belief = Belief(AREA, PAPER, SETTINGS)
    for windows in flight(20):
        belief.update(windows)
    # The walk met the vehicles in another order, and one that the belief does not know.
    links = [3, 9, 1, 2]
    past = np.array([[0.0, 0.0, 50.0]] * 4)
    points, covariance = drawn(belief, belief.model, links, past, 4000, np.random.default_rng(1))
    mean = belief.mass @ belief.mesh.center_enu_m
    np.testing.assert_allclose(points.position_enu_m.mean(axis=1), mean, atol=1.5)
    own = np.linalg.inv(belief.evidence.loading_loading)
    order = [0, 3, 1, 2]
    np.testing.assert_allclose(covariance[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])], own[np.ix_(order, order)])
    assert covariance[2, 2] == 1.0
    assert (points.nuisance[2] == 0.0).all()
    best = int(np.argmax(belief.mass))
    los, nlos, null = belief.evidence.solved(belief.exponents).means_at(best)
    there = belief.evidence.nuisances_at(best, los, nlos, null)
    near = np.linalg.norm(points.position_enu_m.T - belief.mesh.center_enu_m[best], axis=1).argsort()[:40]
    np.testing.assert_allclose(points.nuisance[0, near].mean(), there[0], atol=0.3)


def test_power_changes_its_unit_where_the_belief_knows_it_better() -> None:
    narrow = replace(SERVICE_MODEL, transmit_power_min_dbm=-30.0, transmit_power_max_dbm=-26.0)
    belief = Belief(AREA, narrow, SETTINGS)
    points, covariance = drawn(belief, SERVICE_MODEL, [], np.zeros((0, 3)), 10, np.random.default_rng(1))
    std = SERVICE_MODEL.transmit_power_std_db
    told = SERVICE_MODEL.transmit_power_mean_dbm + std * points.nuisance[0]
    np.testing.assert_allclose(told, -28.0)
    assert std * np.sqrt(covariance[0, 0]) == pytest.approx(4.0 / np.sqrt(12.0))


def test_each_window_is_conditioned_on_the_newest_ones() -> None:
    model = replace(PAPER, shared_shadowing=0.7)
    numbers = History(model, SETTINGS)
    past = newest(
        Windows.of([heard(1, 0, 0, -40, 1.0), heard(2, 50, 0, -41, 1.0), heard(1, 8, 0, -42, 2.0)], numbers),
        2,
    )
    assert past.time_s.tolist() == [2.0, 1.0]
    new = Windows.of(
        [heard(2, 58, 0, -43, 3.0), heard(1, 16, 0, -44, 3.0), heard(1, 24, 0, -45, 4.0)], numbers
    )
    rows = related(past, new, 2, 0.0, model, SETTINGS)
    told = [set(row.tolist()) for row in rows.every.parents[2:]]
    # Of one's own the newest; of the other vehicle what lies nearest.
    assert told == [{1, 0, -1}, {0, 2, 1}, {3, 2, 1}]
    assert rows.late_s.tolist() == [1.0, 1.0, 0.0]
    # With a pace, time counts as distance: what was heard is less alike, each row says more.
    paced = related(past, new, 2, 5.0, model, SETTINGS)
    assert (paced.whitened.scale > rows.whitened.scale).all()


def test_a_window_without_power_does_not_hide_the_newest_with() -> None:
    numbers = History(PAPER, SETTINGS)
    bearing = TrackObservation(1, (9.0, 0.0, 50.0), None, None, 0.3, -0.5, None, None, 0.9, True, 3.0)
    past = newest(Windows.of([heard(1, 0, 0, -40, 1.0), bearing], numbers), 1)
    assert past.time_s.tolist() == [1.0]


def test_bearings_are_met_once_though_an_outlier_is_weighed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    belief = Belief(AREA, PAPER, SETTINGS)
    walk = Walk(AREA, belief.model, SETTINGS, 1)
    told = flight(8)
    # One level that neither a walker nor anybody who stands can explain.
    told[-1][1] = replace(told[-1][1], rss_dbm=40.0)
    met, weighed = [], []
    bearings, scored = Walk._bearings_met, Walk._scored
    monkeypatch.setattr(Walk, "_bearings_met", lambda *given: (met.append(1), bearings(*given))[1])
    monkeypatch.setattr(Walk, "_scored", lambda *given: (weighed.append(1), scored(*given))[1])
    for windows in told:
        belief.update(windows)
        met.clear()
        weighed.clear()
        walk.step(windows, belief)
    assert len(met) == 1
    assert len(weighed) == 4


@pytest.mark.parametrize("count", [1, 2, 5, 8])
def test_medians_are_medians(count: int) -> None:
    values = np.random.default_rng(3).normal(size=(4, count))
    np.testing.assert_array_equal(walking._medians(values), np.median(values, axis=1))


def test_nobody_comes_back_from_lists_and_can_be_joined() -> None:
    nobody = Points.none(0, PAPER)
    again = Points.restore({name: value.tolist() for name, value in nobody.state().items()})
    for name, value in nobody.state().items():
        assert again.state()[name].shape == value.shape, name
    both = Points.joined(again.grown(3, PAPER), Points.none(3, PAPER))
    assert both.bias_rad2.shape == (2, 3, 0)
