"""The tracking study's runs: what they are drawn from, and that nothing else decides them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_sitl.studies.tracking.cases import CASES, LOS, MIXED, NLOS
from sim_sitl.studies.tracking.paths import Path, Shape
from sim_sitl.studies.tracking.trackers import windows_of
from sim_sitl.studies.tracking.world import Labels, draw_run

TIME_S = np.arange(121.0)
TARGET = np.array([30.0, -45.0, 8.0])


@pytest.mark.parametrize("shape", list(Shape))
def test_vehicles_keep_speed_and_height(shape: Shape) -> None:
    fine_s = np.arange(0.0, 120.0, 0.01)
    places = Path(shape).positions(fine_s, TARGET)
    speed = np.linalg.norm(np.diff(places, axis=0), axis=-1) / 0.01
    np.testing.assert_allclose(speed, 8.0, rtol=1e-3)
    assert (places[..., 2] == 50.0).all()
    start = places[0, :, :2]
    np.testing.assert_allclose(np.hypot(*start.T), 100.0)
    np.testing.assert_allclose(start.sum(axis=0), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("shape", "center"), [(Shape.CONTRACTING, (0.0, 0.0)), (Shape.ORACLE, (30.0, -45.0))]
)
def test_spirals_end_close_to_their_centre(shape: Shape, center: tuple[float, float]) -> None:
    places = Path(shape).positions(TIME_S, TARGET)
    np.testing.assert_allclose(np.hypot(*(places[-1, :, :2] - center).T), 20.0)


def test_an_orbit_stays_on_its_circle_and_knows_no_target() -> None:
    places = Path(Shape.ORBIT).positions(TIME_S, TARGET)
    np.testing.assert_allclose(np.hypot(*np.moveaxis(places[..., :2], -1, 0)), 100.0)
    np.testing.assert_array_equal(places, Path(Shape.ORBIT).positions(TIME_S, -TARGET))


def test_cases_that_differ_in_what_is_told_have_the_same_runs() -> None:
    base, other = CASES["nlos-orbit"], CASES["wrong-sigma-high"]
    assert other.told.model.nlos_rss_std_db == pytest.approx(1.5 * base.told.model.nlos_rss_std_db)
    runs = [draw_run(case.world, case.path, TIME_S[:5], 4, 2) for case in (base, other)]
    np.testing.assert_array_equal(runs[0].rss_dbm, runs[1].rss_dbm)
    soft, ruined = CASES["mixed-soft"], CASES["wrong-ruined"]
    labelled = draw_run(soft.world, soft.path, TIME_S[:5], 4, 2)
    plain = draw_run(MIXED, soft.path, TIME_S[:5], 4, 2)
    np.testing.assert_array_equal(labelled.azimuth_rad, plain.azimuth_rad)
    assert (labelled.los_probability != plain.los_probability).all()
    spoilt = draw_run(ruined.world, ruined.path, TIME_S, 4, 2)
    clean = draw_run(NLOS, ruined.path, TIME_S, 4, 2)
    off = np.abs(spoilt.rss_dbm - clean.rss_dbm)
    assert set(off.round(6).ravel()) == {0.0, 20.0}
    assert 0.06 < (off > 1.0).mean() < 0.14


def test_runs_differ_by_number_and_seed() -> None:
    path = Path(Shape.ORBIT)
    runs = [draw_run(NLOS, path, TIME_S[:1], seed, n) for seed in (1, 2) for n in (0, 1)]
    assert len({tuple(run.truth_enu_m[0]) for run in runs}) == 4


def test_power_is_that_of_the_equations() -> None:
    quiet = replace(
        MIXED, shadowing_db=0.0, power_dbm=(15.0, 15.0), nlos_exponent=(3.0, 3.0), bias_max_db=0.0
    )
    run = draw_run(quiet, Path(Shape.ORBIT), TIME_S, 1, 0)
    distance = np.linalg.norm(run.truth_enu_m[:, None] - run.position_enu_m, axis=-1)
    exponent = np.array([2.5, 3.0, 3.0, 3.0])
    np.testing.assert_allclose(run.rss_dbm, 15.0 - 10.0 * exponent * np.log10(distance))
    biased = draw_run(replace(quiet, bias_max_db=8.0), Path(Shape.ORBIT), TIME_S, 1, 0)
    loss = run.rss_dbm - biased.rss_dbm
    assert (loss[:, 0] == 0.0).all()
    np.testing.assert_allclose(loss, np.broadcast_to(loss[:1], loss.shape), atol=1e-9)
    assert (loss[0, 1:] > 0.0).all()
    assert (loss[0, 1:] < 8.0).all()


def test_shadowing_is_correlated_along_a_flight_and_each_vehicles_own() -> None:
    path = Path(Shape.ORBIT)
    quiet = replace(NLOS, power_dbm=(15.0, 15.0), nlos_exponent=(3.0, 3.0), bias_max_db=0.0)
    near, far = [], []
    for number in range(60):
        run = draw_run(quiet, path, TIME_S[:30], 5, number)
        distance = np.linalg.norm(run.truth_enu_m[:, None] - run.position_enu_m, axis=-1)
        shadow = run.rss_dbm - 15.0 + 30.0 * np.log10(distance)
        near += [shadow[1:] * shadow[:-1]]
        far += [shadow[:, :-1] * shadow[:, 1:]]
    assert np.mean(near) / 25.0 == pytest.approx(np.exp(-8.0 / 25.0), abs=0.09)
    assert np.mean(far) / 25.0 == pytest.approx(0.0, abs=0.09)


def test_angles_have_a_white_and_a_constant_error() -> None:
    white, between = [], []
    for number in range(40):
        run = draw_run(LOS, Path(Shape.ORBIT), TIME_S, 3, number)
        offset = run.truth_enu_m[:, None] - run.position_enu_m
        error = run.azimuth_rad - np.arctan2(offset[..., 1], offset[..., 0])
        error = np.degrees(np.remainder(error + np.pi, 2.0 * np.pi) - np.pi)
        white.append(error.std(axis=0))
        between.append(error.mean(axis=0))
    assert np.mean(white) == pytest.approx(1.0, abs=0.03)
    assert np.std(between) == pytest.approx(1.0, abs=0.15)


def test_soft_labels_are_calibrated_and_wrong_ones_are_wrong() -> None:
    rng = np.random.default_rng(1)
    states = (rng.random(40_000) < 0.25).astype(float)
    soft = Labels("soft").probabilities(states, rng)
    for low, high in ((0.05, 0.2), (0.4, 0.6), (0.8, 0.95)):
        inside = (soft > low) & (soft < high)
        assert states[inside].mean() == pytest.approx(soft[inside].mean(), abs=0.04)
    wrong = Labels("wrong").probabilities(states, rng)
    assert ((wrong > 0.5) != (states > 0.5)).mean() == pytest.approx(0.2, abs=0.01)
    assert set(wrong.round(6)) == {0.05, 0.95}


def test_a_walker_keeps_his_speed_and_stays_in_the_area_and_the_still_are_not_touched() -> None:
    path, moving = Path(Shape.ORBIT), replace(LOS, walking_m_s=1.5)
    time_s = np.arange(301.0)
    run = draw_run(moving, path, time_s, 3, 1)
    step = np.linalg.norm(np.diff(run.truth_enu_m, axis=0), axis=-1)
    np.testing.assert_allclose(step, 1.5)
    assert np.ptp(run.truth_enu_m[:, 2]) == 0.0
    assert np.hypot(*run.truth_enu_m[:, :2].T).max() <= path.radius_m
    assert np.hypot(*np.ptp(run.truth_enu_m[:, :2], axis=0)) > 50.0
    still = draw_run(LOS, path, time_s, 3, 1)
    assert (still.truth_enu_m == run.truth_enu_m[0]).all()
    # What is heard follows him: the bearings point at where he is.
    offset = run.truth_enu_m[:, None] - run.position_enu_m
    error = run.azimuth_rad - np.arctan2(offset[..., 1], offset[..., 0])
    assert np.abs(np.remainder(error + np.pi, 2.0 * np.pi) - np.pi).max() < np.radians(10.0)


def test_vehicles_that_say_how_vague_their_places_are_fly_the_same_runs() -> None:
    """5 m, 10 m in height; assumed is what satellite receivers usually reach."""
    said, unsaid = CASES["mixed-vague"], CASES["mixed-vague-unsaid"]
    told, silent = (draw_run(case.world, case.path, np.arange(3.0), 4, 7) for case in (said, unsaid))
    np.testing.assert_array_equal(told.position_enu_m, silent.position_enu_m)
    np.testing.assert_array_equal(told.azimuth_rad, silent.azimuth_rad)
    assert (told.place_std_m, silent.place_std_m) == ((5.0, 10.0), None)
    assert {(w.position_std_m, w.height_std_m) for w in windows_of(told, 1)} == {(5.0, 10.0)}
    assert {(w.position_std_m, w.height_std_m) for w in windows_of(silent, 1)} == {(None, None)}
    assert said.told.model == unsaid.told.model == CASES["mixed-misplaced"].told.model


def test_told_places_are_off_for_minutes_and_half_alike() -> None:
    """200 runs: 1 m on each horizontal axis, 2 m in height; what is heard is the same."""
    plain, off = CASES["mixed-orbit"], CASES["mixed-misplaced"]
    assert off.told.model.vehicle_position_std_m == 1.0
    assert off.told.model.vehicle_height_std_m == 2.0
    time_s = np.array([0.0, 1.0, 300.0])
    errors = []
    for number in range(200):
        one, two = (draw_run(case.world, case.path, time_s, 4, number) for case in (plain, off))
        np.testing.assert_array_equal(one.azimuth_rad, two.azimuth_rad)
        np.testing.assert_array_equal(one.rss_dbm, two.rss_dbm)
        errors.append(two.position_enu_m - one.position_enu_m)
    error = np.array(errors)
    np.testing.assert_allclose(error.std(axis=(0, 1, 2)), [1.0, 1.0, 2.0], rtol=0.12)

    def correlation(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])

    assert correlation(error[:, 0], error[:, 1]) > 0.98
    assert correlation(error[:, 0], error[:, 2]) == pytest.approx(np.exp(-1.0), abs=0.12)
    assert correlation(error[:, 0, 0, :2], error[:, 0, 1, :2]) == pytest.approx(0.5, abs=0.12)
