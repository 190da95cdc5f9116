from __future__ import annotations

import numpy as np
import pytest
import shapely

from groundstation.localization import SearchArea, SignalModel
from groundstation.localization.lsre import (
    convex_concave,
    first_exponents,
    lsre_ccp,
    lsre_criterion,
    lsre_socp,
    lsre_socp_iterative,
    refit_power_and_exponent,
    rss_cost_db2,
    update_power_and_exponents,
    weighted_centroid,
)

MODEL = SignalModel()


def test_literal_program_is_the_weighted_centroid(draw) -> None:
    """Defect of (64): 1e-6 of the area's radius, NLOS and mixed labels; z ends on the cap."""
    for los in ((0, 0, 0, 0), (1, 0, 0, 0, 0)):
        drawn = draw(15, los, 31)
        for index in range(15):
            links = drawn.links.problem(index)
            found = lsre_socp(links, drawn.area, MODEL).position_enu_m
            centroid = weighted_centroid(links, drawn.area, MODEL)
            assert np.abs(found - centroid).max() < 1e-6 * drawn.area.radius_m
            assert found[2] == pytest.approx(drawn.area.height_max_m, abs=1e-4)


def test_after_68_every_residual_is_zero(draw) -> None:
    """Defect of (68): J of (69) cannot tell one place from another."""
    drawn = draw(10, (0, 0, 0, 0), 32)
    for index in range(10):
        links = drawn.links.problem(index)
        for position in (np.array([0.0, 0, 10]), np.array([60.0, -30, 3])):
            power, exponent = update_power_and_exponents(
                links, position, 15.0, first_exponents(links, MODEL), MODEL
            )
            assert rss_cost_db2(links, position, power, exponent, MODEL) < 1e-20
        assert lsre_socp_iterative(links, drawn.area, MODEL).rss_cost_db2 < 1e-18


def test_update_at_one_metre_does_not_divide_by_zero(draw) -> None:
    links = draw(1, (0, 0, 0, 0), 1).links.problem(0)
    at_vehicle = links.position_enu_m[0] + [0, 0, -1.0]
    _, exponent = update_power_and_exponents(links, at_vehicle, 15.0, first_exponents(links, MODEL), MODEL)
    assert np.isfinite(exponent).all()
    assert exponent[0] == MODEL.first_exponent


def test_criterion_never_rises(draw) -> None:
    for los in ((0, 0, 0, 0), (1, 0, 0, 0), (0,) * 7):
        drawn = draw(10, los, 33)
        for index in range(10):
            links = drawn.links.problem(index)
            power, exponent = refit_power_and_exponent(links, drawn.truth_enu_m[index], MODEL)
            start = np.array([10.0, 5.0, 8.0])
            end, values, _ = convex_concave(links, start, power, exponent, drawn.area, MODEL)
            assert len(values) > 1
            assert (np.diff(values) <= 0.0).all()
            assert values[-1] == pytest.approx(lsre_criterion(links, end, power, exponent, MODEL))


def test_converges_to_a_stationary_point(draw) -> None:
    """At the end no neighbour inside the area is better by more than a hair."""
    drawn = draw(10, (0, 0, 0, 0, 0), 34)
    rng = np.random.default_rng(0)
    for index in range(10):
        links = drawn.links.problem(index)
        power, exponent = refit_power_and_exponent(links, drawn.truth_enu_m[index], MODEL)
        start = np.array([1.0, 2.0, 8.0])
        end, values, _ = convex_concave(links, start, power, exponent, drawn.area, MODEL)
        near = drawn.area.clip(end + 0.5 * rng.standard_normal((200, 3)))
        best = min(lsre_criterion(links, place, power, exponent, MODEL) for place in near)
        assert best > values[-1] * (1.0 - 1e-4)


def test_sound_version_finds_the_truth_without_noise() -> None:
    """Seven links, known power and exponent, no bias: the criterion's minimum is the truth."""
    from groundstation.localization import Links

    model = SignalModel(
        known_transmit_power_dbm=15.0,
        nlos_bias_max_db=0.0,
        first_exponent=2.7,
        nlos_exponent_min=2.699,
        nlos_exponent_max=2.701,
    )
    turn = 2 * np.pi * np.arange(7) / 7
    reach = np.where(np.arange(7) % 2, 60.0, 110.0)
    place = np.stack([reach * np.cos(turn), reach * np.sin(turn), 30.0 + 5 * np.arange(7)], axis=1)
    truth = np.array([25.0, -14.0, 6.0])
    rss = 15.0 - 27.0 * np.log10(np.linalg.norm(place - truth, axis=1))
    nothing = np.full(7, np.nan)
    links = Links(place, rss, nothing, nothing, np.zeros(7))
    area = SearchArea(np.zeros(2), 100.0, 0.0, 20.0)
    answer = lsre_ccp(links, area, model)
    assert np.linalg.norm(answer.position_enu_m - truth) < 0.3


def test_polygon_areas_hold(draw) -> None:
    drawn = draw(5, (0, 0, 0, 0), 35)
    wedge = SearchArea.of_polygon(shapely.Polygon([(20, -60), (90, 0), (20, 60), (45, 0)]), 0.0, 20.0)
    for index in range(5):
        links = drawn.links.problem(index)
        for solver in (lsre_socp, lsre_ccp):
            place = solver(links, wedge, MODEL).position_enu_m
            assert shapely.distance(wedge.polygon_en_m, shapely.Point(place[:2])) < 1e-6


def test_same_bits_twice(draw) -> None:
    links = draw(1, (0, 0, 0, 0), 36).links.problem(0)
    area = SearchArea(np.zeros(2), 100.0, 0.0, 20.0)
    for solver in (lsre_socp, lsre_socp_iterative, lsre_ccp):
        first = solver(links, area, MODEL).position_enu_m
        assert (first == solver(links, area, MODEL).position_enu_m).all()
