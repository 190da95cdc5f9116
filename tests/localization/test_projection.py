from __future__ import annotations

import numpy as np
import pytest
import shapely

from groundstation.localization import Links, SearchArea, SignalModel, locate
from groundstation.localization.batch import Batch
from groundstation.localization.lsre_literal import lsre_socp, lsre_socp_iterative
from groundstation.localization.projection import (
    REFUSED,
    projection_label_aware,
    projection_label_aware_literal,
)
from groundstation.localization.rays import Rays
from groundstation.localization.refit import refit_power_and_exponent

MODEL = SignalModel()


def batch_of(drawn) -> Batch:
    return Batch.of(drawn.links, drawn.area, MODEL)


def wrongly_labelled(draw, trials: int, seed: int):
    """All links NLOS; the first is labelled LOS and points anywhere under the horizon."""
    drawn = draw(trials, (0, 0, 0, 0), seed)
    rng = np.random.default_rng(seed)
    drawn.links.los_probability[:, 0] = 1.0
    drawn.links.azimuth_rad[:, 0] = rng.uniform(-np.pi, np.pi, trials)
    drawn.links.elevation_rad[:, 0] = rng.uniform(-np.pi / 2, 0.0, trials)
    return drawn


def rmse_m(position: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.square(position - truth).sum(axis=1).mean()))


def off_the_ray_m(batch: Batch, position: np.ndarray) -> np.ndarray:
    rays = Rays.of(batch)
    return np.linalg.norm(position - rays.at(rays.along_m(position)), axis=1)


def test_literal_test_accepts_nothing(draw) -> None:
    """Defect of (76): (68) on every link leaves J of (69) zero, wherever the free solution is."""
    batch = batch_of(draw(2000, (1, 0, 0, 0), 44))
    free = lsre_socp_iterative(batch, every_link=True)
    cost = batch.rss_cost_db2(free.position_enu_m, free.transmit_power_dbm, free.path_loss_exponent)
    # An exponent held at its floor is the only way to a residual.
    assert cost[(free.path_loss_exponent > 0.1).all(axis=1)].max() < 1e-12
    assert (free.path_loss_exponent > 0.1).all(axis=1).mean() > 0.99
    literal = projection_label_aware_literal(batch)
    assert (literal.position_enu_m == free.position_enu_m).all()
    assert (off_the_ray_m(batch, literal.position_enu_m) > 0.01).mean() > 0.99


def test_with_a_fixed_los_exponent_only_that_link_is_left_in_j(draw) -> None:
    """The other reading: β_LOS kept. J is one residual, and (70) decides whether it is large."""
    batch = batch_of(draw(200, (1, 0, 0, 0), 45))
    free = lsre_socp_iterative(batch)
    assert (free.path_loss_exponent[:, 0] == MODEL.los_exponent).all()
    expected = free.transmit_power_dbm[:, None] - 10 * free.path_loss_exponent * np.log10(
        batch.distances_m(free.position_enu_m)
    )
    residual = batch.links.rss_dbm - expected
    refitted = free.path_loss_exponent[:, 1:] > 0.1
    assert np.abs(residual[:, 1:][refitted]).max() < 1e-9
    assert np.median(np.abs(residual[:, 0])) > 0.5


def test_literal_test_is_76_where_a_residual_is_left(draw) -> None:
    """Powers above a known P_t hold every exponent at its floor: only then do the two J differ."""
    drawn = draw(200, (1, 0, 0, 0), 46)
    model = SignalModel(known_transmit_power_dbm=15.0)
    drawn.links.rss_dbm[:] = 14.0 + np.random.default_rng(46).standard_normal(drawn.links.rss_dbm.shape)
    batch = Batch.of(drawn.links, drawn.area, model)
    free = lsre_socp_iterative(batch, every_link=True)
    rays = Rays.of(batch)
    projected = rays.at(rays.along_m(free.position_enu_m))

    def cost(place: np.ndarray, row: int) -> float:
        distance = np.maximum(np.linalg.norm(place - batch.place[row], axis=1), 1.0)
        expected = 15.0 - 10.0 * free.path_loss_exponent[row] * np.log10(distance)
        return float(np.square(batch.links.rss_dbm[row] - expected).sum())

    answers = projection_label_aware_literal(batch)
    taken = 0
    for row in range(200):
        accept = cost(projected[row], row) <= 1.05 * cost(free.position_enu_m[row], row)
        expected = projected[row] if accept else free.position_enu_m[row]
        assert np.allclose(answers.position_enu_m[row], expected)
        taken += accept
    assert 10 < taken < 190


def test_power_and_exponent_are_those_of_the_answer(draw) -> None:
    batch = batch_of(draw(50, (1, 0, 0, 0), 47))
    answers = projection_label_aware(batch)
    power, exponent = refit_power_and_exponent(batch, answers.position_enu_m)
    taken = np.array([status == "ok" for status in answers.status])
    assert np.allclose(answers.transmit_power_dbm[taken], power[taken])
    assert np.allclose(answers.path_loss_exponent[taken], exponent[taken])


def test_answers_stay_in_a_bent_polygon(draw) -> None:
    drawn = draw(300, (1, 0, 0, 0), 48)
    corners = [(-100, -100), (100, -100), (100, 100), (0, 0), (-100, 100)]
    area = SearchArea.of_polygon(shapely.Polygon(corners), 1.0, 20.0)
    found = projection_label_aware(Batch.of(drawn.links, area, MODEL)).position_enu_m
    assert np.allclose(found, area.clip(found), atol=1e-6)


def test_right_label_is_used(draw) -> None:
    """1,000 trials: nearly every projection is taken, and it halves the free solution's error."""
    drawn = draw(1000, (1, 0, 0, 0), 1)
    batch = batch_of(drawn)
    answers = projection_label_aware(batch)
    taken = np.array([status == "ok" for status in answers.status])
    assert taken.mean() > 0.985
    free = rmse_m(lsre_socp(batch).position_enu_m, drawn.truth_enu_m)
    assert rmse_m(answers.position_enu_m, drawn.truth_enu_m) < 0.5 * free
    assert off_the_ray_m(batch, answers.position_enu_m)[taken].max() < 10.0
    assert np.median(off_the_ray_m(batch, answers.position_enu_m)) < 1e-6


def test_wrong_label_is_mostly_refused(draw) -> None:
    """1,000 trials: the error stays near the free solution's; projecting always would double it."""
    drawn = wrongly_labelled(draw, 1000, 2)
    batch = batch_of(drawn)
    answers = projection_label_aware(batch)
    refused = np.array([status == REFUSED for status in answers.status])
    assert refused.mean() > 0.7
    free = lsre_socp(batch).position_enu_m
    rays = Rays.of(batch)
    always = rays.at(rays.along_m(free))
    error = rmse_m(answers.position_enu_m, drawn.truth_enu_m)
    assert error < 1.1 * rmse_m(free, drawn.truth_enu_m)
    assert error < 0.6 * rmse_m(always, drawn.truth_enu_m)


def test_a_refused_label_is_taken_for_nlos(draw) -> None:
    drawn = wrongly_labelled(draw, 100, 3)
    answers = projection_label_aware(batch_of(drawn))
    drawn.links.los_probability[:] = 0.0
    without = lsre_socp(batch_of(drawn))
    refused = [row for row, status in enumerate(answers.status) if status == REFUSED]
    assert refused
    for row in refused:
        assert np.allclose(answers.position_enu_m[row], without.position_enu_m[row])
        assert np.ptp(answers.path_loss_exponent[row]) == 0.0


def test_answers_stay_in_the_area_and_between_the_heights(draw) -> None:
    for drawn in (draw(300, (1, 0, 0, 0), 42), wrongly_labelled(draw, 300, 42)):
        found = projection_label_aware(batch_of(drawn)).position_enu_m
        assert np.allclose(found, drawn.area.clip(found))


@pytest.mark.parametrize("bearing_deg", [(11.5, -68.8), (0.0, 40.0)], ids=["elsewhere", "into the sky"])
def test_refuses_a_bearing_that_powers_or_area_forbid(bearing_deg: tuple[float, float]) -> None:
    """A strong vehicle nearby says west; the 'LOS' bearing of a far one says east, or up."""
    place = np.array([[-60.0, 0, 50], [80.0, 0, 50], [80.0, 40, 50], [80.0, -40, 50]])
    truth = np.array([-60.0, 5, 5])
    rss = 15.0 - 27.0 * np.log10(np.linalg.norm(place - truth, axis=1)) - 3.0
    nothing = np.full(4, np.nan)
    azimuth, elevation = nothing.copy(), nothing.copy()
    azimuth[1], elevation[1] = np.radians(bearing_deg)
    model = SignalModel(nlos_rss_std_db=2.0, rss_std_db=2.0)
    area = SearchArea(np.zeros(2), 120.0, 0.0, 20.0)
    links = Links(place, rss, azimuth, elevation, np.array([0.1, 0.8, 0.1, 0.1]))
    estimate = locate(links, area, "projection-label-aware", model, covariance=False)
    assert estimate.status == REFUSED
    assert estimate.position_enu_m[0] < 0
