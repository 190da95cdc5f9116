from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.localization import SignalModel
from groundstation.tracking import TrackingSettings, TrackObservation
from groundstation.tracking.history import History

MODEL = SignalModel(shared_shadowing=0.5)
SETTINGS = TrackingSettings(parents=3)


def window(vehicle: int, east: float, north: float = 0.0, **changed: object) -> TrackObservation:
    plain = TrackObservation(vehicle, (east, north, 50.0), -40.0, None, 0.1, -0.4, None, None, 0.7)
    return replace(plain, **changed)  # type: ignore[arg-type]


def history(*windows: TrackObservation, settings: TrackingSettings = SETTINGS) -> History:
    made = History(MODEL, settings)
    if windows:
        made.take(np.array([made.row(one) for one in windows]))
    return made


def test_a_window_is_conditioned_on_what_foretells_most_of_it_of_whatever_vehicle() -> None:
    made = history(*(window(v, e) for v, e in [(7, 0), (9, 1), (7, 10), (7, 40), (9, 39), (7, 12)]))
    assert made.vehicles == [7, 9]
    parents = made.observations().parents.tolist()
    assert parents[0] == [-1, -1, -1]
    # Vehicle 9 was 1 m away, its field is half the same.
    assert parents[1] == [0, -1, -1]
    # The one 2 m away, then the own ones further off, then those of the other vehicle.
    assert parents[5] == [2, 0, 3]


def test_nothing_is_conditioned_on_what_has_no_power() -> None:
    made = history(window(1, 0.0, rss_dbm=None), window(1, 8.0), window(1, 16.0))
    assert made.observations().parents.tolist() == [[-1, -1, -1], [-1, -1, -1], [1, -1, -1]]


def test_one_at_a_time_or_all_at_once_is_the_same() -> None:
    rng = np.random.default_rng(2)
    windows = [window(int(v), *rng.uniform(-60, 60, 2)) for v in rng.integers(1, 5, 60)]
    whole, single = history(*windows), history()
    for one in windows:
        single.take(np.array([single.row(one)]))
    for name, value in whole.state().items():
        np.testing.assert_array_equal(np.asarray(value), np.asarray(single.state()[name]), name)


def test_one_place_has_only_so_many_windows_and_the_rest_is_counted() -> None:
    made = history(*(window(3, 0.1 * (i % 3)) for i in range(7)), window(3, 30.0))
    limit = SETTINGS.windows_per_place
    assert made.count == limit + 1
    assert (made.counts[0].taken, made.counts[0].redundant) == (limit + 1, 7 - limit)
    assert made.observations().parents.max() < made.count
    assert made.observations().parents[-1, 0] >= 0


def test_bearings_from_near_by_are_less_news_and_less_sharp() -> None:
    made = history(window(1, 0.0), window(1, 8.0), window(1, 8.5), window(2, 8.6))
    seen = made.observations()
    fresh = -np.expm1(-2.0 * np.array([8.0, 0.5]) / SETTINGS.correlation_m)
    np.testing.assert_allclose(seen.angle_weight, [1.0, *fresh, 1.0], rtol=1e-6)
    own = MODEL.azimuth_std_rad
    assert seen.angle_std_rad[0, 0] == pytest.approx(own)
    assert seen.angle_std_rad[1, 0] == pytest.approx(own, rel=0.01)
    assert seen.angle_std_rad[2, 0] == pytest.approx(own / np.sqrt(-np.expm1(-0.5)), rel=1e-6)


def test_windows_without_content_are_refused() -> None:
    made = history()
    assert made.row(window(1, 0.0, rss_dbm=None, azimuth_rad=None)) is None
    assert made.row(window(1, 0.0, rss_dbm=None, los_probability=0.0)) is None
    assert made.row(window(1, float("nan"))) is None
    assert made.vehicles == []


def test_forgetting_keeps_the_newest_and_every_vehicle() -> None:
    settings = replace(SETTINGS, maximum_windows=40)
    made = history(*(window(1 + i % 2, 9.0 * i, time_s=float(i)) for i in range(44)), settings=settings)
    before = made.observations().position_enu_m
    dropped = made.forget()
    assert dropped.size == 44 - made.count
    np.testing.assert_array_equal(np.delete(before, dropped, axis=0), made.observations().position_enu_m)
    seen = made.observations()
    assert made.count <= 40
    assert made.forget().size == 0
    assert (seen.position_enu_m[-12:, 0] == 9.0 * np.arange(32, 44)).all()
    assert set(seen.link.tolist()) == {0, 1}
    assert (seen.parents < np.arange(made.count)[:, None]).all()


def test_after_forgetting_windows_are_related_again_when_asked() -> None:
    settings = replace(SETTINGS, maximum_windows=40)
    windows = [window(1 + i % 2, 9.0 * i, time_s=float(i)) for i in range(44)]
    made = history(*windows, settings=settings)
    made.forget()
    assert (made.observations().parents == -1).all()
    kept = made.observations().position_enu_m[:, 0]
    fresh = history(*(w for w in windows if w.position_enu_m[0] in kept), settings=settings)
    # Looking changes nothing …
    np.testing.assert_array_equal(made.related().parents, fresh.observations().parents)
    assert (made.observations().parents == -1).all()
    # … what comes is related to all that are left, and a restart forgets nothing of it.
    for both in (made, fresh):
        both.take(np.array([both.row(window(1, 9.0 * 44))]))
    again = History(MODEL, settings)
    assert again.restore(made.state())
    for one in (made, again):
        assert one.observations().parents[-1].tolist() == fresh.observations().parents[-1].tolist()
        one.relate_again()
        np.testing.assert_array_equal(one.observations().parents, fresh.observations().parents)
        np.testing.assert_array_equal(one.observations().angle_weight, fresh.observations().angle_weight)


def test_some_windows_are_related_as_all_are() -> None:
    settings = replace(SETTINGS, maximum_windows=40)
    made = history(*(window(1 + i % 2, 7.0 * i, time_s=float(i)) for i in range(44)), settings=settings)
    made.forget()
    some = np.arange(0, made.count, 3)
    kept = made.state()
    found, all_of_them = made.related_some(some), made.related()
    assert (found.parents[some] >= 0).any()
    for name in ("parents", "angle_weight", "angle_std_rad"):
        np.testing.assert_array_equal(getattr(found, name)[some], getattr(all_of_them, name)[some], name)
    # The others are as they were, and nothing changes.
    others = np.delete(np.arange(made.count), some)
    assert (found.parents[others] == -1).all()
    for name, value in made.state().items():
        np.testing.assert_array_equal(np.asarray(value), np.asarray(kept[name]), name)


def test_absorbing_is_hearing_both_in_order_of_time() -> None:
    windows = [window(1 + i % 3, 9.0 * i, time_s=float(i)) for i in range(12)]
    whole = history(*windows)
    odd, even = history(*windows[1::2]), history(*windows[::2])
    kept = odd.state()
    assert even.absorb(odd) == 0
    assert even.vehicles == [1, 3, 2]
    np.testing.assert_array_equal(even.observations().position_enu_m, whole.observations().position_enu_m)
    np.testing.assert_array_equal(even.observations().parents, whole.observations().parents)
    assert sum(count.taken for count in even.counts) == 12
    assert odd.state()["vehicles"] == kept["vehicles"]


def test_state_goes_and_comes_back_and_older_ones_are_related_anew() -> None:
    made = history(*(window(1 + i % 2, 9.0 * i) for i in range(9)))
    again = History(MODEL, SETTINGS)
    assert again.restore(made.state())
    for name, value in made.state().items():
        np.testing.assert_array_equal(np.asarray(value), np.asarray(again.state()[name]), name)
    younger = made.state()
    younger["rows"] = younger["rows"][:, :15]
    assert not again.restore(younger)
    for name, value in made.state().items():
        np.testing.assert_array_equal(np.asarray(value), np.asarray(again.state()[name]), name)
    old = made.state()
    old["rows"], old["parents"] = old["rows"][:, :13], old["parents"][:, :1]
    del old["counts"]
    assert not again.restore(old)
    np.testing.assert_array_equal(again.observations().parents, made.observations().parents)


def test_what_vehicles_say_of_their_places_goes_with_their_windows() -> None:
    model = SignalModel(vehicle_position_std_m=1.0, vehicle_height_std_m=2.0)
    made = History(model, SETTINGS)
    assert made.vehicle_variance_m2() == (1.0, 4.0)
    said = window(2, 40.0, position_std_m=8.0, height_std_m=12.0)
    made.take(np.array([made.row(one) for one in (window(1, 0.0), window(1, 20.0), said)]))
    np.testing.assert_array_equal(
        made.observations().place_variance_m2, [[1.0, 4.0], [1.0, 4.0], [64.0, 144.0]]
    )
    # One vague vehicle among others makes the answer a little vaguer, not as vague as itself.
    flat, upright = made.vehicle_variance_m2()
    assert 1.0 < flat < 4.0 < upright < 16.0
    # By power alone a vehicle's place hardly moves anything: with bearings about it does not count.
    mute = window(3, 60.0, azimuth_rad=None, elevation_rad=None, position_std_m=30.0, height_std_m=30.0)
    made.take(np.array([made.row(mute)]))
    assert made.vehicle_variance_m2() == (flat, upright)
    # Nor does one whose bearing is of no line of sight.
    hidden = window(4, 80.0, los_probability=0.01, position_std_m=30.0, height_std_m=30.0)
    made.take(np.array([made.row(hidden)]))
    assert made.vehicle_variance_m2()[0] == pytest.approx(flat, rel=0.02)
