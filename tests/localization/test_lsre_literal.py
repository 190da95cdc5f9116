from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from groundstation.localization import SearchArea, SignalModel
from groundstation.localization.batch import Batch
from groundstation.localization.lsre_literal import literal_positions, lsre_socp, lsre_socp_iterative
from groundstation.localization.lsre_terms import weighted_centroid

# The program's infimum is not attained (y grows without end), and the conic solver says so.
pytestmark = pytest.mark.filterwarnings("ignore:Solution may be inaccurate")

MODEL = SignalModel()
TURN = 2.0 * np.pi * np.arange(4) / 4


def printed_64(cp, batch: Batch, row: int, power_dbm: float, exponent: np.ndarray) -> np.ndarray:
    """(64) with every variable and cone as printed, ζ = 1/m_t; heights and disc as constraints."""
    unit, area = batch.area.radius_m, batch.area
    place, los = batch.place[row] / unit, batch.los()[row]
    shifted = batch.received_dbm()[row] + np.where(los, 0.0, 0.5 * batch.bias_max_db[row])
    # m_t differs from link to link once β does; in units of ζ = 1/m_t,k the gain is m_k/m_t,k.
    m = unit * 10.0 ** ((shifted - power_dbm) / (10.0 * exponent))
    low = 10.0 ** (-batch.bias_max_db[row] / (20.0 * exponent))
    ends = [(k, r) for k in range(len(los)) for r in ((1.0,) if los[k] else (low[k], 1.0 / low[k]))]
    chi = cp.Variable(3)
    s, y, tau1, tau2 = (cp.Variable(len(ends)) for _ in range(4))

    def rotated(a, b, c):
        return cp.SOC(a + b, cp.hstack([a - b, np.sqrt(2.0) * c]))

    constraints = [
        cp.norm(chi[:2] - area.center_enu_m[:2] / unit) <= 1.0,
        chi[2] >= area.height_min_m / unit,
        chi[2] <= area.height_max_m / unit,
    ]
    for i, (k, r) in enumerate(ends):
        constraints += [
            rotated(tau1[i], y[i], np.sqrt(2.0)),
            rotated(y[i], 0.5, m[k] * r * s[i]),
            rotated(tau2[i], 0.5, m[k] * r * s[i]),
            cp.norm(place[k] - chi) <= s[i],
        ]
    tight = {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12}
    cp.Problem(cp.Minimize(cp.sum(tau1 + tau2)), constraints).solve(solver=cp.CLARABEL, **tight)
    return unit * chi.value


@pytest.mark.parametrize("los", [(0, 0, 0, 0), (1, 0, 0, 0, 0), (1, 1, 1)])
def test_printed_program_is_the_projected_weighted_centroid(draw, los: tuple[int, ...]) -> None:
    """Defect of (64): 1e-6 of the area's radius; with one β and with one for each link."""
    cp = pytest.importorskip("cvxpy")
    drawn = draw(2, los, 31)
    batch = Batch.of(drawn.links, drawn.area, MODEL, bias_max_db=[6.2, 7.7])
    power = batch.first_power_dbm() + 1.5
    for exponent in (batch.first_exponents(), np.linspace(2.1, 3.3, 2 * len(los)).reshape(2, -1)):
        found = literal_positions(batch, power, exponent)
        for row in range(2):
            conic = printed_64(cp, batch, row, power[row], exponent[row])
            assert np.abs(found[row] - conic).max() < 1e-6 * drawn.area.radius_m


def test_printed_program_on_the_areas_edge(draw) -> None:
    """Vehicles on one side and far: disc and height cap bind, in the closed form as in the cone."""
    cp = pytest.importorskip("cvxpy")
    drawn = draw(2, (0, 0, 0, 0), 32, ring=0.4 * TURN - 0.6, shift_m=-180.0)
    batch = Batch.of(drawn.links, drawn.area, MODEL)
    power, exponent = batch.first_power_dbm(), batch.first_exponents()
    found = literal_positions(batch, power, exponent)
    assert (
        np.hypot(*(weighted_centroid(batch, power, exponent)[:, :2] - drawn.area.center_enu_m).T) > 100.0
    ).all()
    for row in range(2):
        assert np.abs(found[row] - printed_64(cp, batch, row, power[row], exponent[row])).max() < 1e-4


def test_height_ends_on_the_cap(draw) -> None:
    drawn = draw(50, (0, 0, 0, 0), 31)
    answers = lsre_socp(Batch.of(drawn.links, drawn.area, MODEL))
    assert (answers.position_enu_m[:, 2] == drawn.area.height_max_m).all()


def test_place_does_not_depend_on_the_power(draw) -> None:
    """With one common β P̂_t scales all weights alike."""
    drawn = draw(20, (0, 0, 0, 0), 33)
    low, high = (
        lsre_socp(Batch.of(drawn.links, drawn.area, replace(MODEL, first_transmit_power_dbm=p)))
        for p in (5.0, 25.0)
    )
    assert np.allclose(low.position_enu_m, high.position_enu_m, atol=1e-9)


def test_weights_beyond_any_float_still_give_a_place() -> None:
    from groundstation.localization import Links

    place = np.array([[[50.0, 0, 50], [-50, 0, 50], [0, 50, 50]]])
    nothing = np.full((1, 3), np.nan)
    links = Links(place, np.array([[-60.0, -60, -400]]), nothing, nothing, np.zeros((1, 3)))
    batch = Batch.of(links, SearchArea(np.zeros(2), 100.0, 0.0, 20.0), MODEL)
    found = literal_positions(batch, batch.first_power_dbm(), np.full((1, 3), 0.1))
    assert np.allclose(found, [[0.0, 0.0, 20.0]])


def test_iterative_leaves_no_residual(draw) -> None:
    """Defect of (68): J of (69) is zero at every answer, so it cannot tell one place from another."""
    drawn = draw(30, (0, 0, 0, 0), 34)
    batch = Batch.of(drawn.links, drawn.area, MODEL)
    answers = lsre_socp_iterative(batch)
    cost = batch.rss_cost_db2(answers.position_enu_m, answers.transmit_power_dbm, answers.path_loss_exponent)
    assert cost.max() < 1e-20
    error = [
        np.square(a.position_enu_m - drawn.truth_enu_m).sum(axis=1).mean()
        for a in (lsre_socp(batch), answers)
    ]
    assert error[1] > error[0]


def test_every_link_refits_line_of_sight_too(draw) -> None:
    drawn = draw(10, (1, 0, 0, 0), 35)
    batch = Batch.of(drawn.links, drawn.area, MODEL)
    kept, refitted = lsre_socp_iterative(batch), lsre_socp_iterative(batch, every_link=True)
    assert (kept.path_loss_exponent[:, 0] == MODEL.los_exponent).all()
    assert (refitted.path_loss_exponent[:, 0] != MODEL.los_exponent).all()
    cost = batch.rss_cost_db2(
        refitted.position_enu_m, refitted.transmit_power_dbm, refitted.path_loss_exponent
    )
    assert cost.max() < 1e-20


def test_bent_polygon_gets_the_nearest_place_inside(draw) -> None:
    """The objective is isotropic: the nearest place inside is its least over a non-convex area too."""
    drawn = draw(20, (0, 0, 0, 0), 36)
    bent = shapely.Polygon([(-80, -60), (90, 0), (-80, 60), (30, 0)])
    batch = Batch.of(drawn.links, SearchArea.of_polygon(bent, 0.0, 20.0), MODEL)
    power, exponent = batch.first_power_dbm(), batch.first_exponents()
    free, found = weighted_centroid(batch, power, exponent), literal_positions(batch, power, exponent)
    assert shapely.distance(bent, shapely.points(found[:, :2])).max() < 1e-9
    moved = np.hypot(*(found - free)[:, :2].T)
    assert moved == pytest.approx(shapely.distance(bent, shapely.points(free[:, :2])), abs=1e-9)
