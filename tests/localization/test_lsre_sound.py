from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from groundstation.localization import Links, SearchArea, SignalModel
from groundstation.localization.batch import Batch
from groundstation.localization.lsre_literal import lsre_socp
from groundstation.localization.lsre_sound import (
    best_power,
    clear_of_vehicles,
    convex_concave,
    convex_concave_step,
    lsre_ccp,
    majoriser,
)
from groundstation.localization.lsre_terms import criterion, log_end_weights, log_gains
from groundstation.localization.refit import refit_power_and_exponent
from groundstation.localization.region import Region

MODEL = SignalModel()
WEDGE = shapely.Polygon([(20, -60), (90, 0), (20, 60), (45, 0)])


def hard(draw, name: str) -> Batch:
    """Geometries where a step may go wrong."""
    labels = {
        "plain": (0,) * 4,
        "mixed": (1, 0, 0, 0),
        "seven": (0,) * 7,
        "three": (0,) * 3,
        "fifty": (0,) * 50,
    }
    los = labels.get(name, (0, 0, 0, 0, 0))
    size = 6 if name == "fifty" else 12
    kwargs = {"ring": np.linspace(-0.6, 0.6, len(los)), "shift_m": -150.0} if name == "one side" else {}
    drawn = draw(size, los, 61, radius_m=400.0 if name == "far" else 100.0, **kwargs)
    links, area = drawn.links, drawn.area
    place, rss = links.position_enu_m.copy(), links.rss_dbm.copy()
    if name == "outlier":
        rss[:, 0] += np.where(np.arange(size) % 2, 30.0, -30.0)
    if name == "at a vehicle":
        place[:, 0], rss[:, 0] = drawn.truth_enu_m, 12.0
    if name == "vehicle at the centroid":
        place[:, 0], rss[:, 0] = [0.0, 0.0, 20.0], 25.0
    if name == "collinear":
        place[:, :, 1] = 0.0
    if name == "polygon":
        area = SearchArea.of_polygon(WEDGE, 0.0, 20.0)
    if name == "one height":
        area = SearchArea(np.zeros(2), 100.0, 5.0, 5.0)
    bias = np.random.default_rng(2).uniform(6.0, 8.0, size)
    return Batch.of(replace(links, position_enu_m=place, rss_dbm=rss), area, MODEL, bias)


NAMES = (
    "plain", "mixed", "seven", "three", "fifty", "far", "one side", "outlier", "at a vehicle",
    "vehicle at the centroid", "collinear", "polygon", "one height",
)  # fmt: skip


def start_of(batch: Batch, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    reach = batch.area.radius_m
    wild = np.column_stack([rng.uniform(-reach, reach, (batch.size, 2)), rng.uniform(0, 20, batch.size)])
    return batch.area.clip(wild)


@pytest.mark.parametrize("name", NAMES)
def test_criterion_never_rises(draw, name: str) -> None:
    """At fixed P_t and β; and over both x and ζ at fixed β."""
    batch = hard(draw, name)
    start = start_of(batch)
    power, exponent = refit_power_and_exponent(batch, start)
    for free in (False, True):
        run = convex_concave(batch, Region.of(batch.area), start, power, exponent, free_power=free)
        assert (np.diff(run.history, axis=0) <= 0.0).all()
        assert (run.history[-1] < run.history[0]).mean() > 0.6
        assert np.allclose(batch.area.clip(run.position_enu_m), run.position_enu_m, atol=1e-9)
        last = criterion(batch, run.position_enu_m, run.transmit_power_dbm, exponent)
        assert last == pytest.approx(run.history[-1])
        if not free:
            assert (run.transmit_power_dbm == power).all()


@pytest.mark.parametrize("name", ["plain", "mixed", "seven", "one side", "one height"])
def test_ends_where_no_neighbour_is_better(draw, name: str) -> None:
    batch = hard(draw, name)
    start = start_of(batch, 1)
    power, exponent = refit_power_and_exponent(batch, start)
    run = convex_concave(batch, Region.of(batch.area), start, power, exponent)
    rng = np.random.default_rng(0)
    best = run.history[-1].copy()
    for _ in range(200):
        near = batch.area.clip(run.position_enu_m + rng.standard_normal((batch.size, 3)))
        best = np.minimum(best, criterion(batch, near, power, exponent))
    assert (best > run.history[-1] * (1.0 - 2e-4)).all()


def test_bound_touches_and_lies_above(draw) -> None:
    batch = hard(draw, "mixed")
    region, start = Region.of(batch.area), start_of(batch)
    power, exponent = batch.first_power_dbm(), batch.first_exponents()
    bound, value = majoriser(batch, region, start, power, exponent)
    at, slope, _ = bound.evaluate(region.scaled(start))
    assert at * value == pytest.approx(criterion(batch, start, power, exponent), rel=1e-10)
    for step in 1e-5 * np.eye(3):
        ahead, back = (
            criterion(batch, start + sign * region.scale_m * step, power, exponent) for sign in (1, -1)
        )
        assert slope @ step * value == pytest.approx(0.5 * (ahead - back), rel=1e-5, abs=1e-12)
    rng = np.random.default_rng(3)
    for _ in range(50):
        other = batch.area.clip(start + 40.0 * rng.standard_normal((batch.size, 3)))
        above = bound.evaluate(region.scaled(other))[0] * value
        assert (above >= criterion(batch, other, power, exponent) * (1.0 - 1e-12)).all()


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
@pytest.mark.parametrize("name", ["mixed", "one side", "outlier", "polygon"])
def test_step_against_a_conic_solver(draw, name: str) -> None:
    """The bound written with cones, Clarabel at 1e-9: value to 1e-6, place to a centimetre."""
    cp = pytest.importorskip("cvxpy")
    batch = hard(draw, name).rows(np.arange(2))
    start = start_of(batch, 4)
    power, exponent = batch.first_power_dbm(), batch.first_exponents()
    region, unit = Region.of(batch.area), batch.area.radius_m
    found = convex_concave_step(batch, region, start, power, exponent)
    gain = np.exp(log_gains(batch, power, exponent)) * unit
    weight = np.exp(log_end_weights(batch, exponent))
    hull = None if batch.area.polygon_en_m is None else shapely.convex_hull(batch.area.polygon_en_m)

    def value(row: int, at: np.ndarray) -> float:
        offset = start[row] - batch.place[row]
        ahead = (offset * (at - batch.place[row])).sum(axis=1) / np.linalg.norm(offset, axis=1) / unit
        far = np.linalg.norm(at - batch.place[row], axis=1) / unit
        return float((weight[row] * (1 / (gain[row] * ahead) ** 2 + (gain[row] * far) ** 2)).sum())

    for row in range(2):
        x, t = cp.Variable(3), cp.Variable(batch.links.count)
        place = batch.place[row] / unit
        offset = start[row] / unit - place
        tangent = offset / np.linalg.norm(offset, axis=1, keepdims=True)
        v = cp.multiply(gain[row], tangent @ x - (tangent * place).sum(axis=1))
        far = sum(
            w * g**2 * cp.sum_squares(x - a) for w, g, a in zip(weight[row], gain[row], place, strict=True)
        )
        inside = [x[2] >= batch.area.height_min_m / unit, x[2] <= batch.area.height_max_m / unit]
        if hull is None:
            inside += [cp.norm(x[:2] - batch.area.center_enu_m[:2] / unit) <= 1.0]
        else:
            mix = cp.Variable(len(hull.exterior.coords), nonneg=True)
            inside += [cp.sum(mix) == 1, np.array(hull.exterior.coords).T / unit @ mix == x[:2]]
        problem = cp.Problem(cp.Minimize(far + weight[row] @ cp.square(t)), [*inside, t >= cp.inv_pos(v)])
        problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
        assert value(row, found[row]) == pytest.approx(value(row, unit * x.value), rel=1e-6)
        assert found[row] == pytest.approx(unit * x.value, abs=0.02)


def test_best_power_is_the_least_over_a_grid(draw) -> None:
    batch = hard(draw, "mixed")
    place, exponent = start_of(batch), batch.first_exponents()
    power = best_power(batch, place, batch.first_power_dbm(), exponent)
    value = criterion(batch, place, power, exponent)
    for shift in (-3.0, -0.1, 0.1, 3.0):
        assert (criterion(batch, place, power + shift, exponent) > value).all()
    again = best_power(batch, place, power - 60.0, exponent)
    assert again == pytest.approx(power, abs=1e-4)


def test_starts_leave_a_vehicle(draw) -> None:
    batch = hard(draw, "vehicle at the centroid")
    moved = clear_of_vehicles(batch, batch.place[:, 0])
    assert np.linalg.norm(moved - batch.place[:, 0], axis=1).min() > 0.5
    assert (clear_of_vehicles(batch, moved) == moved).all()


def test_finds_the_truth_without_noise() -> None:
    """Seven links, known power and exponent, no bias: the criterion's minimum is the truth."""
    model = replace(
        MODEL,
        known_transmit_power_dbm=15.0,
        nlos_bias_max_db=0.0,
        nlos_exponent_min=2.699,
        nlos_exponent_max=2.701,
    )
    turn = 2 * np.pi * np.arange(7) / 7
    reach = np.where(np.arange(7) % 2, 60.0, 110.0)
    place = np.stack([reach * np.cos(turn), reach * np.sin(turn), 30.0 + 5 * np.arange(7)], axis=1)
    truth = np.array([25.0, -14.0, 6.0])
    rss = 15.0 - 27.0 * np.log10(np.linalg.norm(place - truth, axis=1))
    nothing = np.full((1, 7), np.nan)
    links = Links(place[None], rss[None], nothing, nothing, np.zeros((1, 7)))
    answer = lsre_ccp(Batch.of(links, SearchArea(np.zeros(2), 100.0, 0.0, 20.0), model))
    assert np.linalg.norm(answer.position_enu_m[0] - truth) < 0.3
    assert answer.transmit_power_dbm[0] == pytest.approx(15.0, abs=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_answers_are_finite_inside_and_each_its_own(draw, name: str) -> None:
    batch = hard(draw, name)
    answers = lsre_ccp(batch)
    for values in (answers.position_enu_m, answers.transmit_power_dbm, answers.path_loss_exponent):
        assert np.isfinite(values).all()
    assert np.allclose(batch.area.clip(answers.position_enu_m), answers.position_enu_m, atol=1e-9)
    assert set(answers.status) <= {"ok", "iteration limit"}
    for row in (0, 5, 11) if name == "plain" else (0,):
        alone = lsre_ccp(batch.rows([row]))
        assert alone.position_enu_m[0] == pytest.approx(answers.position_enu_m[row], abs=1e-3)


def test_beats_the_centroid_outside_the_ring(draw) -> None:
    drawn = draw(150, (0, 0, 0, 0), 62, ring=np.array([-0.6, -0.2, 0.2, 0.6]), shift_m=-150.0)
    batch = Batch.of(drawn.links, drawn.area, MODEL)
    error = [
        np.linalg.norm(f(batch).position_enu_m - drawn.truth_enu_m, axis=1) for f in (lsre_ccp, lsre_socp)
    ]
    assert np.square(error[0]).mean() < np.square(error[1]).mean()
