from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.localization import SignalModel
from groundstation.localization.baselines.rwls_sdp import rwls_sdp, rwls_sdp_positions, rwls_sdp_program
from groundstation.localization.batch import Batch
from groundstation.localization.interior import minimise
from groundstation.localization.region import Region

MODEL = SignalModel()


def over_z(cp, batch: Batch, row: int, power: float, exponent: np.ndarray) -> tuple[float, np.ndarray]:
    """min Σ w_k τ_k over Z ⪰ 0 as signal-model notes write it: the optimum and the place."""
    unit, area, count = batch.area.radius_m, batch.area, batch.links.count
    los = batch.los()[row]
    shifted = batch.received_dbm()[row] + np.where(los, 0.0, batch.bias_max_db[row] / 2)
    gain = unit * 10 ** ((shifted - power) / (10 * exponent))
    weight = 1.0 - (1.0 / gain) / (1.0 / gain).sum()
    z, tau = cp.Variable((4, 4), PSD=True), cp.Variable(count)
    constraints = [
        z[3, 3] == 1.0,
        cp.norm(z[:2, 3] - area.center_enu_m[:2] / unit) <= 1.0,
        z[2, 3] >= area.height_min_m / unit,
        z[2, 3] <= area.height_max_m / unit,
    ]
    for k in range(count):
        a = batch.place[row, k] / unit
        c = np.block([[np.eye(3), -a[:, None]], [-a[None], np.array([[a @ a]])]])
        low = 10 ** (-batch.bias_max_db[row] / (20 * exponent[k]))
        ends = (1.0,) if los[k] else (low, 1.0 / low)
        constraints += [cp.square((gain[k] * e) ** 2 * cp.trace(c @ z) - 1.0) <= tau[k] for e in ends]
    problem = cp.Problem(cp.Minimize(weight @ tau), constraints)
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    return float(problem.value), unit * z.value[:3, 3]


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
@pytest.mark.parametrize("los", [(0, 0, 0, 0), (1, 0, 0, 0, 0)])
def test_against_the_program_over_z(draw, los: tuple[int, ...]) -> None:
    """Same optimum to 1e-6, same place where vehicles at many heights make it unique."""
    cp = pytest.importorskip("cvxpy")
    drawn = draw(3, los, 81)
    place = drawn.links.position_enu_m.copy()
    place[..., 2] = np.array([30.0, 90.0, 45.0, 60.0, 35.0])[: len(los)]
    batch = Batch.of(replace(drawn.links, position_enu_m=place), drawn.area, MODEL, [6.1, 7.0, 7.9])
    power = np.array([14.0, 15.0, 17.0])
    exponent = np.random.default_rng(1).uniform(2.2, 3.2, (3, len(los)))
    found = minimise(*rwls_sdp_program(batch, Region.of(drawn.area), power, exponent), centred=True)
    answer = rwls_sdp_positions(batch, power, exponent)
    assert found.converged.all()
    for row in range(3):
        value, at = over_z(cp, batch, row, power[row], exponent[row])
        assert found.value[row] == pytest.approx(value, rel=1e-6, abs=1e-8)
        assert answer[row] == pytest.approx(at, abs=0.1)


def test_alternates_67_and_68_unrelaxed(draw) -> None:
    drawn = draw(30, (0, 0, 0, 0), 82)
    batch = Batch.of(drawn.links, drawn.area, MODEL)
    answers = rwls_sdp(batch)
    cost = batch.rss_cost_db2(answers.position_enu_m, answers.transmit_power_dbm, answers.path_loss_exponent)
    assert cost.max() < 1e-18
    assert set(answers.status) <= {"ok", "iteration limit", "diverging"}
    first = rwls_sdp(replace(batch, model=replace(MODEL, maximum_iterations=1)))
    place = rwls_sdp_positions(batch, batch.first_power_dbm(), batch.first_exponents())
    assert (first.position_enu_m == place).all()
    path = 27.0 * np.log10(batch.distances_m(place))
    assert first.transmit_power_dbm == pytest.approx((batch.received_dbm() + path).mean(axis=1))


@pytest.mark.parametrize("los", [(0, 0, 0), (1, 1, 1, 1), (0,) * 50])
def test_any_labels_and_numbers_of_links(draw, los: tuple[int, ...]) -> None:
    drawn = draw(4, los, 83)
    rss = drawn.links.rss_dbm.copy()
    rss[::2, 0] += 30.0
    batch = Batch.of(replace(drawn.links, rss_dbm=rss), drawn.area, replace(MODEL, maximum_iterations=6))
    answers = rwls_sdp(batch)
    assert np.isfinite(answers.position_enu_m).all()
    assert np.allclose(drawn.area.clip(answers.position_enu_m), answers.position_enu_m)
    if all(los):
        assert (answers.path_loss_exponent == MODEL.los_exponent).all()


def test_noise_free_powers_of_line_of_sight_fit_exactly(draw) -> None:
    """Every term can be zero: the degenerate optimum, where residual and multiplier vanish together."""
    drawn = draw(10, (1, 1, 1, 1, 1), 84, rss_std_db=0.0)
    model = replace(MODEL, known_transmit_power_dbm=15.0)
    distance = np.linalg.norm(drawn.links.position_enu_m - drawn.truth_enu_m[:, None], axis=-1)
    links = replace(drawn.links, rss_dbm=15.0 - 25.0 * np.log10(distance))
    answers = rwls_sdp(Batch.of(links, drawn.area, model))
    assert answers.position_enu_m[:, :2] == pytest.approx(drawn.truth_enu_m[:, :2], abs=0.5)
