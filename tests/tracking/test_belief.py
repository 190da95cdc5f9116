from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely

from groundstation.localization import SERVICE_MODEL, SearchArea, SignalModel
from groundstation.tracking import Belief, TrackingSettings, TrackObservation, containment

PAPER = SignalModel(nlos_bias_max_db=8.0)
SETTINGS = TrackingSettings(sample_std_db=0.3)


def run(fly, trials: int, seed: int, los, seconds: int, model=PAPER, settings=SETTINGS, **world):
    """Horizontal errors and 90 % radii at the end of each run."""
    rng = np.random.default_rng(seed)
    error, radius = [], []
    for _ in range(trials):
        flight = fly(rng, los, seconds, **world)
        belief = Belief(flight.area, model, settings)
        for second in range(0, seconds, 7):
            belief.update([w for windows in flight.seconds[second : second + 7] for w in windows])
        said = containment(belief.mesh, belief.mass)
        error.append(float(np.hypot(*(said.position_enu_m - flight.truth_enu_m)[:2])))
        radius.append(said.radius_90_m)
    return np.array(error), np.array(radius)


def test_nlos_is_calibrated_and_near_the_exact_filter(fly) -> None:
    """4 vehicles, 60 s, 16 runs, seed 71: an exact filter has 16.6 m."""
    error, radius = run(fly, 16, 71, (0, 0, 0, 0), 60)
    assert np.sqrt(np.square(error).mean()) < 21.0
    assert (error <= radius).mean() >= 0.75
    # Honest, not timid: the radius is in proportion to the error.
    assert np.mean(radius) < 2.6 * np.sqrt(np.square(error).mean())


@pytest.mark.parametrize("los", [(1, 0, 0, 0), (1, 1, 1, 1)])
def test_angles_with_a_constant_error_stay_honest(fly, los: tuple[int, ...]) -> None:
    """White 1° plus constant 1° a vehicle, 21 s, 12 runs, seed 72: never sure of a wrong place."""
    error, radius = run(fly, 12, 72, los, 21)
    assert (error <= radius).mean() >= 0.8
    assert np.median(error) < 12.0


def test_wrong_model_stays_honest(fly) -> None:
    """Shadowing 7.5 dB over 37 m, 10 % of windows ruined by 20 dB, the service's σ; 16 runs, seed 73."""
    model = replace(PAPER, nlos_rss_std_db=SERVICE_MODEL.nlos_rss_std_db)
    settings = TrackingSettings()
    error, radius = run(
        fly, 16, 73, (0, 0, 0, 0), 42, model, settings, std_db=7.5, correlation_m=37.5, ruined=0.1
    )
    assert (error <= radius).mean() >= 0.75
    assert np.sqrt(np.square(error).mean()) < 50.0


def test_service_model_with_one_uncalibrated_receiver(fly) -> None:
    """One vehicle, power only, 45 dB off (reference loss, receiver), 60 s, 12 runs, seed 74."""
    error, radius = run(
        fly, 12, 74, (0,), 60, SERVICE_MODEL, TrackingSettings(), offset_db=-45.0, with_angles=False
    )
    assert (error <= radius).mean() >= 0.75
    assert np.median(error) < 60.0


def test_works_from_one_window_on(fly) -> None:
    flight = fly(np.random.default_rng(1), (0,), 1)
    belief = Belief(flight.area, PAPER, SETTINGS)
    update = belief.update(flight.seconds[0])
    assert update.taken == 1
    assert 50.0 < containment(belief.mesh, belief.mass).radius_90_m < 110.0


def observation(**changed: object) -> TrackObservation:
    plain = TrackObservation(1, (0.0, 0.0, 50.0), -40.0, None, None, None, None, None, 0.0)
    return replace(plain, **changed)  # type: ignore[arg-type]


def belief_here(**changed: object) -> Belief:
    return Belief(SearchArea(np.zeros(2), 100.0, 0.0, 20.0), PAPER, replace(SETTINGS, **changed))  # type: ignore[arg-type]


def test_each_window_has_a_named_fate() -> None:
    belief = belief_here()
    first = belief.update([observation() for _ in range(7)])
    assert (first.taken, first.redundant) == (SETTINGS.windows_per_place, 7 - SETTINGS.windows_per_place)
    nothing = belief.update([observation(rss_dbm=None), observation(rss_dbm=math.nan)])
    assert (nothing.taken, nothing.empty) == (0, 2)
    assert belief.update([]).taken == 0


def test_hovering_does_not_make_it_surer() -> None:
    """A vehicle that hangs in one place learns next to nothing after the first second."""
    belief = belief_here()
    radius = []
    for _ in range(30):
        belief.update([observation(position_enu_m=(60.0, 0.0, 50.0), rss_dbm=-35.0)])
        radius.append(containment(belief.mesh, belief.mass).radius_90_m)
    assert radius[-1] > 0.97 * radius[0]


def test_an_outlier_is_counted_and_weighs_little(fly) -> None:
    flight = fly(np.random.default_rng(4), (0, 0, 0, 0), 40)
    clean, spoilt = (Belief(flight.area, PAPER, SETTINGS) for _ in range(2))
    outliers = 0
    for second, windows in enumerate(flight.seconds):
        clean.update(windows)
        ruined = [
            replace(w, rss_dbm=w.rss_dbm + 30.0) if second == 30 and w.vehicle_id == 1 else w for w in windows
        ]
        outliers += spoilt.update(ruined).outliers
    assert outliers >= 1
    places = [containment(b.mesh, b.mass).position_enu_m for b in (clean, spoilt)]
    assert np.linalg.norm(places[0] - places[1]) < 6.0


def test_memory_is_bounded_and_the_belief_survives(fly) -> None:
    flight = fly(np.random.default_rng(5), (0, 0, 0, 0), 60)
    settings = replace(SETTINGS, maximum_windows=60, maximum_cells=900)
    belief = Belief(flight.area, PAPER, settings)
    forgotten = 0
    for windows in flight.seconds:
        forgotten += belief.update(windows).forgotten
        assert belief.windows <= 60
        assert belief.mesh.count <= 900 + 7
    assert forgotten == 240 - belief.windows
    said = containment(belief.mesh, belief.mass)
    assert np.hypot(*(said.position_enu_m - flight.truth_enu_m)[:2]) < 2.0 * said.radius_90_m


def test_another_area_loses_no_evidence(fly) -> None:
    flight = fly(np.random.default_rng(6), (1, 0, 0, 0), 30)
    square = SearchArea.of_polygon(shapely.box(-120, -120, 120, 120), 0.0, 20.0)
    moved, fresh = Belief(flight.area, PAPER, SETTINGS), Belief(square, PAPER, SETTINGS)
    for windows in flight.seconds:
        moved.update(windows)
        fresh.update(windows)
    moved.set_area(square)
    one, two = (containment(b.mesh, b.mass) for b in (moved, fresh))
    # Outliers are weighed on arrival, against what was believed then: close, not equal.
    assert np.linalg.norm(one.position_enu_m - two.position_enu_m) < 0.3 * two.radius_90_m
    assert moved.windows == fresh.windows == 120


def test_restored_belief_continues_bit_for_bit(fly) -> None:
    flight = fly(np.random.default_rng(7), (1, 0, 0), 24)
    whole = Belief(flight.area, PAPER, SETTINGS)
    for windows in flight.seconds[:11]:
        whole.update(windows)
    again = Belief.restore(whole.state(), flight.area, PAPER, SETTINGS)
    for windows in flight.seconds[11:]:
        whole.update(windows)
        again.update(windows)
        assert (whole.mass == again.mass).all()
    for name, value in whole.state().items():
        np.testing.assert_array_equal(np.asarray(value), np.asarray(again.state()[name]), name)


def test_unclassified_angles_do_not_mislead(fly) -> None:
    """A wrong bearing of a link that nobody judged, prior 0.3: the belief is not captured by it."""
    flight = fly(np.random.default_rng(8), (0, 0, 0, 0), 30)
    belief = Belief(flight.area, PAPER, SETTINGS)
    for windows in flight.seconds:
        lying = [
            replace(w, azimuth_rad=0.3, elevation_rad=-0.5, los_probability=0.3, classified=False)
            for w in windows
        ]
        belief.update(lying)
    said = containment(belief.mesh, belief.mass)
    assert np.hypot(*(said.position_enu_m - flight.truth_enu_m)[:2]) < 1.5 * said.radius_90_m


def test_bearings_that_agree_are_believed_though_nobody_judged(fly) -> None:
    """No classifier at all: true bearings meet in one place and are found out to be line of sight."""
    flight = fly(np.random.default_rng(10), (1, 1, 1, 1), 20)
    belief = Belief(flight.area, SERVICE_MODEL, TrackingSettings())
    for windows in flight.seconds:
        belief.update([replace(w, classified=False, los_probability=0.3) for w in windows])
    said = containment(belief.mesh, belief.mass)
    assert np.hypot(*(said.position_enu_m - flight.truth_enu_m)[:2]) < 1.5 * said.radius_90_m < 5.0


def test_misjudged_bearings_do_not_capture_the_belief(fly) -> None:
    """Every tenth obstructed window is called LOS at 0.95, its bearing stable over 25 m; 8 runs, seed 75."""
    rng = np.random.default_rng(75)
    ratio = []
    for _ in range(8):
        flight = fly(rng, (0, 0, 0, 0), 28)
        belief = Belief(flight.area, SERVICE_MODEL, TrackingSettings())
        for first in range(0, 28, 3):
            liar = int(rng.integers(1, 5))
            azimuth, elevation = float(rng.uniform(-math.pi, math.pi)), float(rng.uniform(-1.4, 0.0))
            batch = []
            for second, windows in enumerate(flight.seconds[first : first + 3]):
                for w in windows:
                    lies = w.vehicle_id == liar and second < 2
                    batch.append(
                        replace(
                            w,
                            azimuth_rad=azimuth if lies else float(rng.uniform(-math.pi, math.pi)),
                            elevation_rad=elevation if lies else float(rng.uniform(-1.4, 0.0)),
                            los_probability=0.95 if lies else 0.1,
                        )
                    )
            belief.update(batch)
        said = containment(belief.mesh, belief.mass)
        ratio.append(np.hypot(*(said.position_enu_m - flight.truth_enu_m)[:2]) / max(said.radius_90_m, 5.0))
    # A captured belief is 5 to 20 radii off. Of 24 runs 18 are inside, the worst at 3.2.
    assert max(ratio) < 4.0
    assert np.count_nonzero(np.array(ratio) <= 1.0) >= 5


def test_belief_kept_with_other_settings_is_related_anew(fly) -> None:
    flight = fly(np.random.default_rng(11), (0, 0, 0), 15)
    old = Belief(flight.area, PAPER, SETTINGS)
    shared = replace(PAPER, shared_shadowing=0.7)
    fresh = Belief(flight.area, shared, SETTINGS)
    for windows in flight.seconds:
        old.update(windows)
        fresh.update(windows)
    again = Belief.restore(old.state(), flight.area, shared, SETTINGS)
    assert again.windows == fresh.windows
    one, two = (containment(b.mesh, b.mass) for b in (again, fresh))
    assert np.linalg.norm(one.position_enu_m - two.position_enu_m) < 0.3 * two.radius_90_m
    assert again.update(flight.seconds[0]).taken + again.update(flight.seconds[0]).redundant >= 3


def test_power_estimate_follows(fly) -> None:
    flight = fly(np.random.default_rng(9), (1, 1, 1, 1), 40)
    belief = Belief(flight.area, SERVICE_MODEL, TrackingSettings())
    for windows in flight.seconds:
        belief.update(windows)
    assert 5.0 < belief.transmit_power_dbm() < 26.0


def eastern(center_enu_m: np.ndarray, half_m: np.ndarray) -> np.ndarray:
    """A prior map: a Gaussian of 8 m about (60, 0)."""
    assert half_m.shape == (center_enu_m.shape[0], 2)
    return -0.5 * np.square((center_enu_m[:, :2] - [60.0, 0.0]) / 8.0).sum(axis=1)


def southern(center_enu_m: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.where(center_enu_m[:, 1] > 0.0, -20.0, 0.0)


def test_fields_count_from_the_start_and_can_be_taken_away(fly) -> None:
    belief = belief_here()
    belief.set_field("prior", eastern)
    said = containment(belief.mesh, belief.mass)
    # The circle that holds 90 % of a Gaussian: 2.146 σ; the boxes are laid finer where it is.
    assert said.radius_90_m == pytest.approx(2.146 * 8.0, rel=0.05)
    assert np.hypot(*(said.position_enu_m[:2] - [60.0, 0.0])) < 1.0
    flight = fly(np.random.default_rng(12), (0, 0), 10)
    with_field, without = belief_here(), belief_here()
    with_field.set_field("prior", eastern)
    for windows in flight.seconds:
        with_field.update(windows)
        without.update(windows)
    with_field.set_area(without.area)
    without.set_area(without.area)
    assert np.abs(containment(with_field.mesh, with_field.mass).position_enu_m[:2] - [60.0, 0.0]).max() < 30.0
    with_field.set_field("prior", None)
    with_field.set_area(without.area)
    np.testing.assert_allclose(
        containment(with_field.mesh, with_field.mass).position_enu_m,
        containment(without.mesh, without.mass).position_enu_m,
        atol=3.0,
    )


def test_restored_belief_with_fields_continues_bit_for_bit(fly) -> None:
    flight = fly(np.random.default_rng(13), (0, 0, 0), 20)
    whole = belief_here()
    whole.set_field("prior", eastern)
    whole.set_field("silence", southern)
    for windows in flight.seconds[:11]:
        whole.update(windows)
    again = Belief.restore(whole.state(), whole.area, PAPER, SETTINGS)
    again.set_field("silence", southern)
    again.set_field("prior", eastern)
    assert (whole.mass == again.mass).all()
    for windows in flight.seconds[11:]:
        whole.update(windows)
        again.update(windows)
        assert (whole.mass == again.mass).all()
    assert whole.mass[whole.mesh.center_enu_m[:, 1] > 5.0].sum() < 1e-6


def test_no_box_is_finer_than_the_vehicles_know_where_they_are(fly) -> None:
    """Four lines of sight, 20 s: the boxes get as small as they may, and no smaller."""
    flight = fly(np.random.default_rng(8), (1, 1, 1, 1), 20)
    smallest = {}
    for std_m in (0.0, 1.0):
        belief = Belief(flight.area, replace(PAPER, vehicle_position_std_m=std_m), SETTINGS)
        for windows in flight.seconds:
            belief.update(windows)
        smallest[std_m] = float(belief.mesh.half_m[:, 0].min())
    assert SETTINGS.minimum_half_m <= smallest[0.0] < 0.25 <= smallest[1.0] < 0.6


def test_a_belief_that_rested_goes_on_bit_for_bit(fly) -> None:
    flight = fly(np.random.default_rng(8), (1, 0, 0, 0), 30)
    awake, rested = (Belief(flight.area, SERVICE_MODEL, TrackingSettings()) for _ in range(2))
    for second, windows in enumerate(flight.seconds):
        if second % 7 == 3:
            rested.rest()
        awake.update(windows)
        rested.update(windows)
        np.testing.assert_array_equal(rested.mass, awake.mass)


def test_masses_follow_fields_and_windows_and_are_nobodys_to_change(fly) -> None:
    flight = fly(np.random.default_rng(7), (0, 0, 0, 0), 6)
    belief = Belief(flight.area, PAPER, SETTINGS)
    before = belief.mass
    belief.update(flight.seconds[0])
    after = belief.mass
    assert before.shape != after.shape or (before != after).any()
    after[:] = 0.0
    assert belief.mass.sum() == pytest.approx(1.0)
    plain = belief.mass
    belief.set_field("east", lambda center, half: 0.05 * center[:, 0])
    assert (belief.mass @ belief.mesh.center_enu_m)[0] > (plain @ belief.mesh.center_enu_m)[0] + 1.0
    belief.set_field("east", None)
    np.testing.assert_allclose(belief.mass, plain, rtol=1e-12)


def test_a_level_of_which_nothing_is_known_yet_is_no_outlier() -> None:
    """The phone may send with any power: how well it is known counts, at each of the first windows."""
    belief = Belief(SearchArea(np.zeros(2), 100.0, 1.0, 20.0), SERVICE_MODEL, TrackingSettings())

    def heard(vehicle: int, rss_dbm: float) -> TrackObservation:
        place = (60.0 * math.cos(vehicle), 60.0 * math.sin(vehicle), 50.0)
        return TrackObservation(vehicle, place, rss_dbm, None, None, None, None, None, 0.0)

    assert belief.update([heard(1, 20.0)]).outliers == 0
    assert belief.update([heard(2, 20.0), heard(3, 17.0)]).outliers == 0
    # By then it is known.
    assert belief.update([heard(4, -80.0)]).outliers == 1
