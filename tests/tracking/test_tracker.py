"""The mixture of a still and a walking person, in a radio world of the tests' own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely

from groundstation.localization import SearchArea, SignalModel
from groundstation.tracking import Belief, Tracker, TrackingSettings, TrackObservation, containment

PAPER = SignalModel(nlos_bias_max_db=8.0)
SETTINGS = TrackingSettings(sample_std_db=0.3)
AREA = SearchArea(np.zeros(2), 100.0, 1.0, 20.0)


def walk(
    seed: int, seconds: int, speed_mps: float, stops_s: float = math.inf, los: tuple[int, ...] = (1, 0, 0)
) -> tuple[list[list[TrackObservation]], np.ndarray]:
    """Windows of vehicles at 8 m/s on a circle, second by second, and where the person was (seconds, 3)."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(0.0, 2.0 * math.pi)
    way = speed_mps * np.minimum(np.arange(seconds), stops_s) - 0.5 * speed_mps * min(seconds, stops_s)
    truth = np.stack([way * math.cos(heading), way * math.sin(heading), np.full(seconds, 6.0)], axis=1)
    heard: list[list[TrackObservation]] = [[] for _ in range(seconds)]
    exponent, power = rng.uniform(2.2, 3.2), rng.uniform(13.0, 18.0)
    for vehicle, is_los in enumerate(los):
        angle = 2.0 * math.pi * vehicle / len(los) + 0.08 * np.arange(seconds)
        place = np.stack([100.0 * np.cos(angle), 100.0 * np.sin(angle), np.full(seconds, 50.0)], axis=1)
        gap = np.linalg.norm(place[:, None] - place, axis=2) + np.linalg.norm(truth[:, None] - truth, axis=2)
        shadow = 5.0 * np.linalg.cholesky(np.exp(-gap / 25.0) + 1e-6 * np.eye(seconds))
        offset = truth - place
        distance = np.linalg.norm(offset, axis=1)
        rss = power - 10.0 * (2.5 if is_los else exponent) * np.log10(distance)
        rss = rss + shadow @ rng.standard_normal(seconds) - (0.0 if is_los else rng.uniform(0.0, 8.0))
        noise = np.radians(1.0) * (rng.standard_normal((2, seconds)) + rng.standard_normal((2, 1)))
        azimuth = np.arctan2(offset[:, 1], offset[:, 0]) + noise[0]
        elevation = np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1])) + noise[1]
        for second in range(seconds):
            angles = (float(azimuth[second]), float(elevation[second])) if is_los else (None, None)
            heard[second].append(
                TrackObservation(
                    vehicle + 1, tuple(place[second]), float(rss[second]), None, *angles, None, None,
                    float(is_los), True, 1000.0 + second,
                )
            )  # fmt: skip
    return heard, truth


def error_m(tracker: Tracker | Belief, truth: np.ndarray) -> float:
    said = containment(tracker.mesh, tracker.mass)
    return float(np.hypot(*(said.position_enu_m - truth)[:2]))


def test_of_a_still_person_the_answer_is_the_still_beliefs_bit_for_bit() -> None:
    heard, _ = walk(1, 50, 0.0)
    tracker, still = Tracker(AREA, PAPER, SETTINGS, 7), Belief(AREA, PAPER, SETTINGS)
    for windows in heard:
        assert tracker.update(windows) == still.update(windows)
        assert (tracker.mass == still.mass).all()
        assert (tracker.mesh.center_enu_m == still.mesh.center_enu_m).all()
    assert 0.0 < tracker.walking_probability < 0.1
    assert tracker.transmit_power_dbm() == still.transmit_power_dbm()


def test_vehicles_that_are_not_where_they_say_do_not_make_the_answer_too_sure() -> None:
    """Told places 1.5 m off, the same way for 60 s, one line of sight: 6 flights, each told so or not."""
    told = replace(PAPER, vehicle_position_std_m=1.0, vehicle_height_std_m=2.0)
    inside = {PAPER: 0, told: 0}
    for seed in range(6):
        heard, truth = walk(20 + seed, 60, 0.0)
        turn = 1.0 * seed
        off = np.array([1.5 * math.cos(turn), 1.5 * math.sin(turn), 0.0])
        trackers = {model: Tracker(AREA, model, SETTINGS, seed) for model in inside}
        for windows in heard:
            moved = [replace(w, position_enu_m=tuple(np.array(w.position_enu_m) + off)) for w in windows]
            for tracker in trackers.values():
                tracker.update(moved)
        for model, tracker in trackers.items():
            said = containment(tracker.mesh, tracker.mass, shift=model.vehicle_variance_m2)
            inside[model] += np.hypot(*(said.position_enu_m - truth[-1])[:2]) <= said.radius_90_m
    assert inside[told] >= 5
    assert inside[PAPER] <= 3


def test_what_vehicles_say_of_their_places_counts_as_if_it_were_assumed() -> None:
    """All say ± 3 m and ± 4 m: the belief is that of a model which has it so, no 90 % radius under 6.4 m."""
    heard, _ = walk(21, 20, 0.0)
    assumed = Tracker(AREA, replace(PAPER, vehicle_position_std_m=3.0, vehicle_height_std_m=4.0), SETTINGS, 3)
    said = Tracker(AREA, PAPER, SETTINGS, 3)
    for windows in heard:
        assumed.update(windows)
        said.update([replace(window, position_std_m=3.0, height_std_m=4.0) for window in windows])
    assert (said.mass == assumed.mass).all()
    assert said.vehicle_variance_m2 == pytest.approx((9.0, 16.0))
    shown = containment(said.mesh, said.mass, shift=said.vehicle_variance_m2)
    assert shown.radius_90_m > 2.146 * 3.0


def test_a_vehicle_that_says_how_vague_its_place_is_misleads_nobody() -> None:
    """Four lines of sight, one vehicle 15 m off its place: told so, the others' bearings decide."""
    heard, truth = walk(22, 30, 0.0, los=(1, 1, 1, 1))
    error = {}
    for says in (None, 15.0):
        tracker = Tracker(
            AREA, replace(PAPER, vehicle_position_std_m=1.0, vehicle_height_std_m=2.0), SETTINGS, 3
        )
        for windows in heard:
            east, north, up = windows[0].position_enu_m
            off = replace(
                windows[0], position_enu_m=(east, north + 15.0, up), position_std_m=says, height_std_m=says
            )
            tracker.update([off, *windows[1:]])
        error[says] = error_m(tracker, truth[-1])
    assert error[15.0] < 1.5
    assert error[15.0] < 0.5 * error[None]


def test_a_walker_is_found_out_and_followed() -> None:
    """1.2 m/s, one vehicle in line of sight, 60 s: he comes 72 m far."""
    heard, truth = walk(2, 60, 1.2)
    tracker = Tracker(AREA, PAPER, SETTINGS, 2)
    for second in range(0, 60, 2):
        tracker.update(heard[second] + heard[second + 1])
    assert tracker.walking_probability > 0.9
    assert tracker.mass.sum() == pytest.approx(1.0)
    said = containment(tracker.mesh, tracker.mass)
    assert error_m(tracker, truth[-1]) < min(10.0, 2.0 * said.radius_90_m)


def test_by_power_alone_a_walker_is_found_out_where_vehicles_come_again() -> None:
    """A lap takes 79 s. One who stands is heard as before; one who walks is not, and no bearing tells."""
    for speed_mps in (0.0, 1.2):
        heard, _ = walk(3, 120, speed_mps, los=(0, 0, 0, 0))
        tracker = Tracker(AREA, PAPER, SETTINGS, 3)
        for second in range(0, 76, 2):
            tracker.update(heard[second] + heard[second + 1])
        assert 0.005 < tracker.walking_probability < 0.2
        for second in range(76, 92, 2):
            tracker.update(heard[second] + heard[second + 1])
        if speed_mps:
            assert tracker.walking_probability > 0.9
        else:
            assert tracker.walking_probability < 0.002


def test_windows_that_are_far_off_do_not_make_a_still_person_walk_on_a_second_lap() -> None:
    """One in ten 20 dB off: a level need not repeat itself at every window."""
    heard, _ = walk(3, 120, 0.0, los=(0, 0, 0, 0))
    rng = np.random.default_rng(3)
    tracker = Tracker(AREA, PAPER, SETTINGS, 3)
    for second in range(0, 120, 2):
        batch = []
        for window in heard[second] + heard[second + 1]:
            off_db = rng.choice([-20.0, 20.0]) * (rng.random() < 0.1)
            batch.append(replace(window, rss_dbm=float(window.rss_dbm or 0.0) + off_db))
        tracker.update(batch)
        assert tracker.walking_probability < 0.5


def test_a_walkers_region_does_not_shrink_onto_a_wrong_bearing() -> None:
    """The particles must not grow sure of a vehicle's error of bearing, each of its own."""
    heard, truth = walk(6, 100, 0.8)
    tracker = Tracker(AREA, PAPER, SETTINGS, 6)
    for second in range(0, 100, 2):
        tracker.update(heard[second] + heard[second + 1])
        if second in (58, 68, 78, 88, 98):
            points = tracker._walk.points
            off = (points.position_enu_m.mean(axis=1) - truth[second + 1])[:2]
            # Inside the ellipse that holds 90 % of a normal distribution.
            assert off @ np.linalg.solve(np.cov(points.position_enu_m[:2]), off) < 4.61
            spread = points.bias_rad2[:, 0].mean(axis=1) + points.bias_rad[:, 0].var(axis=1)
            assert (np.sqrt(spread) > 0.6 * SETTINGS.angle_bias_std_rad).all()


def test_with_few_vehicles_nobody_is_taken_to_walk() -> None:
    """An antenna or a model that is off looks like a walk to one or two receivers."""
    heard, _ = walk(2, 30, 1.2, los=(1, 0))
    tracker, still = Tracker(AREA, PAPER, SETTINGS, 2), Belief(AREA, PAPER, SETTINGS)
    for second in range(0, 30, 5):
        windows = [window for each in heard[second : second + 5] for window in each]
        tracker.update(windows)
        still.update(windows)
    assert tracker.walking_probability == 0.0
    assert (tracker.mass == still.mass).all()


def test_one_who_stops_is_a_still_person_again() -> None:
    """Walks 40 s, then stands 50 s: old places pull no more and the answer sharpens where he is."""
    heard, truth = walk(4, 90, 1.2, stops_s=40.0)
    tracker = Tracker(AREA, PAPER, SETTINGS, 4)
    first = tracker.still
    for second in range(0, 90, 2):
        tracker.update(heard[second] + heard[second + 1])
    assert tracker.still is not first
    assert error_m(tracker.still, truth[-1]) < 6.0
    assert error_m(tracker, truth[-1]) < 6.0


def test_without_times_nobody_walks() -> None:
    heard, _ = walk(2, 30, 1.2)
    tracker, still = Tracker(AREA, PAPER, SETTINGS, 2), Belief(AREA, PAPER, SETTINGS)
    for windows in heard:
        timeless = [replace(window, time_s=0.0) for window in windows]
        tracker.update(timeless)
        still.update(timeless)
    assert tracker.walking_probability == 0.0
    assert (tracker.mass == still.mass).all()


def test_switched_off_nobody_walks() -> None:
    heard, _ = walk(2, 40, 1.2)
    tracker = Tracker(AREA, PAPER, replace(SETTINGS, walking_prior=0.0, walking_rate_per_s=0.0))
    for windows in heard:
        tracker.update(windows)
    assert tracker.walking_probability == 0.0


@pytest.mark.parametrize("after_s", [5, 33, 52])
def test_restored_tracker_continues_bit_for_bit(after_s: int) -> None:
    """Before anybody is suspected, while one walks, and after the still belief was begun anew."""
    heard, _ = walk(1, after_s + 12, 1.2)
    whole = Tracker(AREA, PAPER, SETTINGS, 5)
    for windows in heard[:after_s]:
        whole.update(windows)
    again = Tracker.restore(whole.state(), AREA, PAPER, SETTINGS, 5)
    for windows in heard[after_s:]:
        whole.update(windows)
        again.update(windows)
        assert whole.walking_probability == again.walking_probability
        assert (whole.mass == again.mass).all()
    if after_s == 52:
        assert whole.state()["left"] is not None


def test_restored_on_a_second_lap_it_continues_bit_for_bit() -> None:
    heard, _ = walk(1, 96, 0.0, los=(0, 0, 0))
    whole = Tracker(AREA, PAPER, SETTINGS, 5)
    for second in range(0, 86, 2):
        whole.update(heard[second] + heard[second + 1])
    again = Tracker.restore(whole.state(), AREA, PAPER, SETTINGS, 5)
    told = []
    for windows in heard[86:]:
        whole.update(windows)
        again.update(windows)
        told.append(whole.walking_probability)
        assert again.walking_probability == told[-1]
    assert len(set(told)) > 2


def test_the_same_windows_give_the_same_numbers_and_another_beacon_others() -> None:
    heard, _ = walk(3, 24, 1.2)
    trackers = [Tracker(AREA, PAPER, SETTINGS, seed) for seed in (5, 5, 6)]
    for windows in heard:
        for tracker in trackers:
            tracker.update(windows)
    told = [tracker.walking_probability for tracker in trackers]
    assert told[0] == told[1] != told[2]


def test_a_state_from_before_there_were_walkers() -> None:
    heard, _ = walk(3, 10, 0.0)
    still = Belief(AREA, PAPER, SETTINGS)
    for windows in heard:
        still.update(windows)
    tracker = Tracker.restore(still.state(), AREA, PAPER, SETTINGS)
    assert (tracker.mass == still.mass).all()
    assert tracker.update(heard[-1]).taken == 3


def test_another_area_keeps_a_walker_inside_it() -> None:
    heard, truth = walk(1, 66, 1.2)
    tracker = Tracker(AREA, PAPER, SETTINGS, 1)
    for second in range(0, 60, 2):
        tracker.update(heard[second] + heard[second + 1])
    assert tracker.walking_probability > 0.5
    east, north = truth[60, :2]
    square = SearchArea.of_polygon(shapely.box(east - 30, north - 30, east + 30, north + 30), 1.0, 20.0)
    tracker.set_area(square)
    for windows in heard[60:]:
        tracker.update(windows)
    held = tracker.mesh.center_enu_m[tracker.mass > 0.0]
    assert (np.abs(held[:, :2] - (east, north)) < 31.0).all()
    assert error_m(tracker, truth[-1]) < 12.0
    # Where none of his places is left, nobody walks.
    tracker.set_area(SearchArea(np.array([900.0, 0.0]), 50.0, 1.0, 20.0))
    assert tracker.walking_probability == 0.0


def test_fields_say_where_a_still_person_is() -> None:
    """A last known place bends the still belief; once it is begun anew, it says nothing any more."""

    def west(center_enu_m: np.ndarray, half_m: np.ndarray) -> np.ndarray:
        return np.where(center_enu_m[:, 0] < 0.0, 0.0, -20.0)

    heard, _ = walk(1, 60, 1.2)
    tracker = Tracker(AREA, PAPER, SETTINGS, 1)
    tracker.update(heard[0])
    tracker.set_field("prior", west)
    assert tracker.mass @ (tracker.mesh.center_enu_m[:, 0] < 0.0) > 0.95
    tracker.set_field("prior", None)
    for windows in heard[1:]:
        tracker.update(windows)
    before = tracker.still.mass
    tracker.set_field("prior", west)
    assert (tracker.still.mass == before).all()


def test_two_ids_of_one_phone() -> None:
    heard, truth = walk(6, 40, 0.0)
    one, other, whole = (Tracker(AREA, PAPER, SETTINGS, 6) for _ in range(3))
    for second, windows in enumerate(heard):
        (one if second < 20 else other).update(windows)
        whole.update(windows)
    one.absorb(other)
    assert one.windows == whole.windows
    assert abs(error_m(one, truth[-1]) - error_m(whole, truth[-1])) < 2.0
    assert one.walking_probability == 0.0


def test_of_a_walker_with_two_ids_the_one_heard_last_counts() -> None:
    heard, truth = walk(1, 70, 1.2)
    early, late = (Tracker(AREA, PAPER, SETTINGS, 6) for _ in range(2))
    for windows in heard[:12]:
        early.update(windows)
    for windows in heard[12:]:
        late.update(windows)
    assert late.walking_probability > 0.5
    early.absorb(late)
    assert early.walking_probability == late.walking_probability
    assert error_m(early, truth[-1]) == error_m(late, truth[-1]) < 12.0
