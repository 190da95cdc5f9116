"""Weights and residuals: what each vehicle brought, and who is wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from groundstation.localization import SearchArea, SignalModel
from groundstation.localization.mesh import masses, moments
from groundstation.tracking import Belief, TrackingSettings, TrackObservation, explanation
from groundstation.tracking.explanation import LinkExplanation, explain, thinned

TRUTH = np.array([30.0, -20.0, 2.0])
AREA = SearchArea(np.array([0.0, 0.0]), 150.0, 0.0, 10.0)
MODEL = SignalModel(receiver_offset_std_db=3.0)
SETTINGS = TrackingSettings(base_cells=12, maximum_cells=700)


def place_of(vehicle: int, second: int, radius_m: float = 90.0) -> np.ndarray:
    turn = math.pi / 2 * vehicle + 0.09 * second
    return np.array([radius_m * math.cos(turn), radius_m * math.sin(turn), 45.0])


def heard(
    vehicle: int,
    second: int,
    rng: np.random.Generator,
    *,
    extra_db: float = 0.0,
    turned_rad: float | None = None,
    lifted_rad: float = 0.0,
    los: float = 0.05,
    classified: bool = True,
) -> TrackObservation:
    place = place_of(vehicle, second)
    away = TRUTH - place
    exponent = 2.5 if los > 0.5 else 2.8
    level = (
        15.5 - 10.0 * exponent * math.log10(float(np.linalg.norm(away))) + 3.0 * float(rng.standard_normal())
    )
    azimuth = elevation = None
    if turned_rad is not None:
        azimuth = math.atan2(away[1], away[0]) + turned_rad + 0.01 * float(rng.standard_normal())
        elevation = math.atan2(away[2], math.hypot(away[0], away[1])) + lifted_rad
    return TrackObservation(
        vehicle, (float(place[0]), float(place[1]), float(place[2])), level + extra_db, 0.3,
        azimuth, elevation, 0.01, 0.01, los, classified, float(second),
    )  # fmt: skip


def believed(windows: list[TrackObservation], tick: int = 4, model: SignalModel = MODEL) -> Belief:
    belief = Belief(AREA, model, SETTINGS)
    for start in range(0, len(windows), tick):
        belief.update(windows[start : start + tick])
    return belief


def story(seconds: int = 30, **of_third: float) -> list[TrackObservation]:
    rng = np.random.default_rng(5)
    return [
        heard(vehicle, second, rng, **(of_third if vehicle == 3 else {}))  # type: ignore[arg-type]
        for second in range(seconds)
        for vehicle in (1, 2, 3, 4)
    ]


def by_vehicle(belief: Belief) -> dict[int, LinkExplanation]:
    return {link.vehicle_id: link for link in explain(belief)}


def test_an_empty_belief_needs_no_explanation() -> None:
    assert explain(Belief(AREA, MODEL, SETTINGS)) == ()


def test_weights_add_up_and_the_same_belief_has_the_same_reasons() -> None:
    belief = believed(story())
    links = explain(belief)
    assert [link.vehicle_id for link in links] == [1, 2, 3, 4]
    assert sum(link.weight for link in links) == pytest.approx(1.0)
    assert all(link.weight >= 0.0 for link in links)
    assert [link.windows for link in links] == [30, 30, 30, 30]
    assert explain(belief) == links
    for link in links:
        assert link.azimuth_residual_rad is None
        assert link.los_probability == pytest.approx(0.05)
        assert abs(link.power_score or 0.0) < 2.5


def test_a_right_bearing_brings_most() -> None:
    links = by_vehicle(believed(story(turned_rad=0.0, los=0.97)))
    assert links[3].weight > 0.8
    assert links[3].area_factor > 5.0
    assert max(links[vehicle].weight for vehicle in (1, 2, 4)) < 0.1
    assert abs(links[3].azimuth_score or 9.0) < 2.0


def spread_m2(belief: Belief) -> float:
    _, covariance = moments(belief.mesh, belief.mass)
    return math.sqrt(float(np.linalg.det(covariance[:2, :2])))


@pytest.mark.parametrize("bearings", [{}, {"turned_rad": 0.0, "los": 0.97}])
def test_without_a_vehicle_is_without_its_windows(bearings: dict[str, float]) -> None:
    """The area factors against beliefs that never heard the vehicle.

    Not the same numbers: there the rows of others are not conditioned on the windows that are
    left out, the boxes differ, and spread is not entropy. But the same vehicles matter as much.
    """
    windows = story(**bearings)
    whole = believed(windows)
    told, seen = [], []
    for vehicle, link in by_vehicle(whole).items():
        rest = believed([window for window in windows if window.vehicle_id != vehicle], tick=3)
        told.append(math.log(link.area_factor))
        seen.append(math.log(spread_m2(rest) / spread_m2(whole)))
    assert np.argmax(told) == np.argmax(seen)
    assert max(seen) > 0.3
    for one, other in zip(told, seen, strict=True):
        assert abs(one - other) < 0.3 + 0.15 * abs(other)


@pytest.mark.parametrize("extra_db", [9.0, -9.0])
def test_a_receiver_that_is_wrong_shows_with_its_sign(extra_db: float) -> None:
    def residuals(extra: float) -> dict[int, LinkExplanation]:
        rng = np.random.default_rng(7)
        # Bearings of the others hold the estimate where the beacon is.
        windows = [
            heard(
                vehicle, second, rng,
                extra_db=extra if vehicle == 2 else 0.0,
                turned_rad=0.0 if vehicle in (1, 4) else None,
                los=0.97 if vehicle in (1, 4) else 0.05,
            )
            for second in range(25)
            for vehicle in (1, 2, 3, 4)
        ]  # fmt: skip
        return by_vehicle(believed(windows))

    right, wrong = residuals(0.0), residuals(extra_db)
    moved = {v: (wrong[v].power_residual_db or 0.0) - (right[v].power_residual_db or 0.0) for v in wrong}
    assert moved[2] == pytest.approx(extra_db, abs=3.5)
    assert max(abs(moved[vehicle]) for vehicle in (1, 4)) < 1.5
    change = (wrong[2].power_score or 0.0) - (right[2].power_score or 0.0)
    assert change * math.copysign(1.0, extra_db) > 1.0


def test_a_bearing_that_is_turned_shows_on_its_side() -> None:
    rng = np.random.default_rng(8)
    windows = [
        heard(vehicle, second, rng, turned_rad=0.12 if vehicle == 3 else 0.0,
              lifted_rad=-0.07 if vehicle == 3 else 0.0, los=0.9)
        for second in range(20)
        for vehicle in (1, 2, 3, 4)
    ]  # fmt: skip
    links = by_vehicle(believed(windows))
    assert links[3].azimuth_residual_rad == pytest.approx(0.12, abs=0.04)
    assert links[3].elevation_residual_rad == pytest.approx(-0.07, abs=0.03)
    assert (links[3].azimuth_score or 0.0) > 2.0
    assert (links[3].elevation_score or 0.0) < -1.0
    for vehicle in (1, 2, 4):
        assert abs(links[vehicle].azimuth_residual_rad or 9.0) < 0.05


def test_residuals_weigh_less_where_the_place_is_not_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    """20 m of doubt in the place are 20 m/d of doubt in a bearing, and 10 β/(d ln 10) dB a metre.

    So are 20 m of doubt in the vehicles' own places.
    """
    rng = np.random.default_rng(10)
    windows = [
        heard(vehicle, second, rng, turned_rad=0.02, lifted_rad=0.02, los=0.9)
        for second in range(12)
        for vehicle in (1, 2)
    ]
    belief = believed(windows)
    lost = believed(windows, model=replace(MODEL, vehicle_position_std_m=20.0, vehicle_height_std_m=20.0))

    def stds(link: LinkExplanation) -> tuple[float, ...]:
        told = (
            (link.power_residual_db, link.power_score),
            (link.azimuth_residual_rad, link.azimuth_score),
            (link.elevation_residual_rad, link.elevation_score),
        )
        return tuple((residual or math.nan) / (score or math.nan) for residual, score in told)

    def told(std_m: float, belief: Belief = belief) -> dict[int, LinkExplanation]:
        spread = np.eye(3) * std_m**2
        monkeypatch.setattr(explanation, "moments", lambda mesh, mass: (TRUTH, spread))
        return by_vehicle(belief)

    sure, unsure = told(0.0), told(20.0)
    for vehicle, link in told(0.0, lost).items():
        assert stds(link) == pytest.approx(stds(unsure[vehicle]), rel=0.02)
    for vehicle, link in unsure.items():
        assert link.power_residual_db == sure[vehicle].power_residual_db
        grown = [
            math.sqrt(after**2 - before**2)
            for after, before in zip(stds(link), stds(sure[vehicle]), strict=True)
        ]
        away = [TRUTH - place_of(vehicle, second) for second in range(12)]
        flat_m = float(np.mean([np.hypot(vector[0], vector[1]) for vector in away]))
        slant_m = float(np.mean([np.linalg.norm(vector) for vector in away]))
        expected = (20.0 * 10.0 * 2.5 / (math.log(10.0) * slant_m), 20.0 / flat_m, 20.0 / slant_m)
        assert grown == pytest.approx(expected, rel=0.2)


def test_a_vehicle_without_power_and_one_that_nobody_judged() -> None:
    rng = np.random.default_rng(9)
    windows = story(10)
    bare = heard(5, 3, rng, turned_rad=0.0, los=0.9)
    windows.append(
        TrackObservation(
            5,
            bare.position_enu_m,
            None,
            None,
            bare.azimuth_rad,
            bare.elevation_rad,
            0.01,
            0.01,
            0.9,
            True,
            3.0,
        )
    )
    windows.append(heard(6, 4, rng, classified=False))
    links = by_vehicle(believed(windows))
    assert (links[5].power_residual_db, links[5].power_score) == (None, None)
    assert links[5].azimuth_residual_rad is not None
    assert links[6].los_probability is None
    assert links[6].power_residual_db is not None


def test_what_no_vehicle_said_stays_when_a_vehicle_goes() -> None:
    """With a prior as narrow as this no vehicle brings anything, and none is missed."""
    belief = believed(story(8))
    wide = by_vehicle(belief)
    belief.set_field(
        "prior", lambda center, _: -0.5 * np.square(center[:, :2] - TRUTH[:2]).sum(axis=1) / 3.0**2
    )
    narrow = by_vehicle(belief)
    assert all(0.7 < link.area_factor < 1.4 for link in narrow.values())
    assert max(link.area_factor for link in wide.values()) > max(link.area_factor for link in narrow.values())


def test_few_boxes_stand_for_all() -> None:
    belief = believed(story())
    mesh, mass = belief.mesh, belief.mass
    chosen, log_volume = thinned(mesh, mass, 160)
    assert chosen.size <= 160
    # What they stand for adds up: the volume roughly, the belief closely.
    log_density = np.log(np.maximum(mass, 1e-300)) - mesh.log_volume
    assert np.exp(log_density[chosen] + log_volume).sum() == pytest.approx(1.0, abs=0.05)
    assert np.exp(log_volume).sum() == pytest.approx(np.exp(mesh.log_volume).sum(), rel=0.35)
    few, _ = thinned(mesh, mass, mesh.count)
    assert few.size == mesh.count
    assert masses(log_density, mesh).sum() == pytest.approx(1.0)
