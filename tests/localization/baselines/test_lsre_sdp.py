from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.localization import Links, SearchArea, SignalModel
from groundstation.localization.baselines.lifting import lifted_constraints
from groundstation.localization.baselines.lsre_sdp import (
    lsre_sdp,
    lsre_sdp_iterative,
    lsre_sdp_positions,
    lsre_sdp_program,
)
from groundstation.localization.batch import Batch
from groundstation.localization.interior import minimise
from groundstation.localization.region import Region

MODEL = SignalModel()
TIGHT = {"tol_gap_abs": 1e-9, "tol_gap_rel": 1e-9, "tol_feas": 1e-9}


def printed_62(
    cp,
    batch: Batch,
    row: int,
    power: float,
    exponent: np.ndarray,
    *,
    fixed: bool = True,
    bounded: bool = True,
) -> tuple[float, np.ndarray]:
    """(62) over Z ⪰ 0 with its four terms a link: the optimum and (63). Lengths in area radii.

    ``fixed``: Z₄₄ = 1/m_t² (here 1: the gains are m_k/m_t); ``bounded``: heights and disc.
    """
    unit, area = batch.area.radius_m, batch.area
    z = cp.Variable((4, 4), PSD=True)
    terms, constraints = [], [z[3, 3] == 1.0] if fixed else []
    if bounded:
        constraints += [
            cp.norm(z[:2, 3] - area.center_enu_m[:2] / unit) <= 1.0,
            z[2, 3] >= area.height_min_m / unit,
            z[2, 3] <= area.height_max_m / unit,
        ]
    for k in range(batch.links.count):
        a, los = batch.place[row, k] / unit, batch.los()[row, k]
        c = np.block([[np.eye(3), -a[:, None]], [-a[None], np.array([[a @ a]])]])
        shift = 0.0 if los else batch.bias_max_db[row] / 2
        m = unit * 10 ** ((batch.received_dbm()[row, k] + shift - power) / (10 * exponent[k]))
        low = 10 ** (-batch.bias_max_db[row] / (20 * exponent[k]))
        for e in (1.0,) if los else (low, 1.0 / low):
            square = cp.trace(c @ z) * (m * e) ** 2
            terms += [square, cp.inv_pos(square)]
    problem = cp.Problem(cp.Minimize(cp.sum(cp.hstack(terms))), constraints)
    problem.solve(solver=cp.CLARABEL, **TIGHT)
    return float(problem.value), unit * z.value[:3, 3] / z.value[3, 3]


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
@pytest.mark.parametrize("los", [(0, 0, 0, 0), (1, 0, 0, 0, 0)])
def test_against_the_program_over_z(draw, los: tuple[int, ...]) -> None:
    """Same optimum to 1e-6; same place in the plane, where it is unique, and in height about the same."""
    cp = pytest.importorskip("cvxpy")
    drawn = draw(3, los, 71)
    batch = Batch.of(drawn.links, drawn.area, MODEL, [6.1, 7.0, 7.9])
    region, power = Region.of(drawn.area), np.array([14.0, 15.0, 17.0])
    exponent = np.random.default_rng(1).uniform(2.2, 3.2, (3, len(los)))
    program, start, scale = lsre_sdp_program(batch, region, power, exponent)
    found = minimise(program, lifted_constraints(region), start, centred=True)
    place = lsre_sdp_positions(batch, power, exponent)
    assert found.converged.all()
    for row in range(3):
        value, at = printed_62(cp, batch, row, power[row], exponent[row])
        assert found.value[row] * scale[row] == pytest.approx(value, rel=1e-6)
        assert place[row, :2] == pytest.approx(at[:2], abs=0.02)
        assert place[row, 2] == pytest.approx(at[2], abs=6.0)


def test_place_to_a_centimetre_where_vehicles_fly_at_many_heights(draw) -> None:
    cp = pytest.importorskip("cvxpy")
    drawn = draw(2, (0,) * 7, 72)
    place = drawn.links.position_enu_m.copy()
    place[..., 2] = [30.0, 90.0, 45.0, 60.0, 35.0, 80.0, 55.0]
    batch = Batch.of(replace(drawn.links, position_enu_m=place), drawn.area, MODEL)
    answers = lsre_sdp(batch)
    for row in range(2):
        _, at = printed_62(cp, batch, row, 15.0, np.full(7, 2.7))
        assert answers.position_enu_m[row] == pytest.approx(at, abs=0.05)


def noise_free() -> Batch:
    turn = 2.0 * np.pi * np.arange(4) / 4
    place = np.stack([100 * np.cos(turn), 100 * np.sin(turn), np.full(4, 50.0)], axis=-1)
    truth = np.array([30.0, -40.0, 8.0])
    rss = 15.0 - 27.0 * np.log10(np.linalg.norm(place - truth, axis=1))
    nothing = np.full((1, 4), np.nan)
    links = Links(place[None], rss[None], nothing, nothing, np.zeros((1, 4)))
    return Batch.of(links, SearchArea(np.zeros(2), 100.0, 1.0, 20.0), replace(MODEL, nlos_bias_max_db=0.0))


def test_noise_free_ring_what_the_relaxation_loses() -> None:
    """(30, −40, 8) from four vehicles of one height, all known, no noise.

    With Z₄₄ = 1/m_t² the plane is exact, and the height anywhere: s and z trade places. With Z₄₄
    free, as (62) is printed, the ring leaves Z₄₄ itself open too: the bearing is right and the
    range is not.
    """
    cp = pytest.importorskip("cvxpy")
    batch, exponent = noise_free(), np.full(4, 2.7)
    answer = lsre_sdp(batch).position_enu_m[0]
    assert answer[:2] == pytest.approx([30.0, -40.0], abs=0.01)
    assert abs(answer[2] - 8.0) > 1.0
    value, free = printed_62(cp, batch, 0, 15.0, exponent, fixed=False, bounded=False)
    assert value == pytest.approx(16.0, abs=1e-6)
    assert free[1] / free[0] == pytest.approx(-40.0 / 30.0, abs=1e-3)
    assert np.linalg.norm(free[:2] - [30.0, -40.0]) > 1.0


def test_iterative_alternates_67_to_70(draw) -> None:
    drawn = draw(40, (0, 0, 0, 0), 73)
    batch = Batch.of(drawn.links, drawn.area, MODEL)
    answers = lsre_sdp_iterative(batch)
    cost = batch.rss_cost_db2(answers.position_enu_m, answers.transmit_power_dbm, answers.path_loss_exponent)
    assert cost.max() < 1e-18
    assert answers.iterations.min() >= 2
    assert answers.iterations.max() <= MODEL.maximum_iterations
    assert set(answers.status) <= {"ok", "iteration limit", "diverging"}
    alone = lsre_sdp_iterative(batch.rows([11]))
    assert alone.iterations[0] == answers.iterations[11]
    assert alone.position_enu_m[0] == pytest.approx(answers.position_enu_m[11], abs=0.02)
    once = lsre_sdp(batch)
    assert (once.iterations == 1).all()
    assert (once.transmit_power_dbm == 15.0).all()
    assert (once.path_loss_exponent == 2.7).all()


@pytest.mark.parametrize("los", [(0, 0, 0), (1, 1, 1, 1), (0,) * 50])
def test_any_labels_and_numbers_of_links(draw, los: tuple[int, ...]) -> None:
    drawn = draw(6, los, 74)
    rss = drawn.links.rss_dbm.copy()
    rss[::2, 0] += 30.0
    batch = Batch.of(replace(drawn.links, rss_dbm=rss), drawn.area, MODEL)
    for solver in (lsre_sdp, lsre_sdp_iterative):
        answers = solver(batch)
        assert np.isfinite(answers.position_enu_m).all()
        assert np.allclose(drawn.area.clip(answers.position_enu_m), answers.position_enu_m)
        if all(los):
            assert (answers.path_loss_exponent == MODEL.los_exponent).all()
