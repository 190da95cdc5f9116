from __future__ import annotations

import numpy as np
import pytest

from groundstation.domain.errors import InputError
from groundstation.localization import SearchArea, SignalModel, crlb, locate, locate_batch
from groundstation.localization.batch import Batch
from groundstation.localization.wls import WlsInput, positions, wls_taylor

IN_90 = 6.2514
"""χ² of three degrees of freedom, 90 %."""


def places(estimates: list) -> np.ndarray:
    return np.array([e.position_enu_m for e in estimates])


def rmse(estimates: list, truth: np.ndarray) -> float:
    return float(np.sqrt(np.square(places(estimates) - truth).sum(axis=1).mean()))


def share_in_90(estimates: list, truth: np.ndarray) -> float:
    error = places(estimates) - truth
    inverse = np.linalg.inv(np.array([e.covariance_m2 for e in estimates]))
    return float((np.einsum("ni,nij,nj->n", error, inverse, error) < IN_90).mean())


def inputs(links, **more: np.ndarray) -> WlsInput:
    return WlsInput(links.position_enu_m, links.rss_dbm, links.azimuth_rad, links.elevation_rad, **more)


def dense(links, row: int, at: np.ndarray, model: SignalModel, measured_angles: bool) -> np.ndarray:
    """(41)–(50) of the paper as matrices, strongest link first, Jacobians at ``at``."""
    order = np.argsort(-links.rss_dbm[row])
    a = links.position_enu_m[row][order]
    p, az, el = links.rss_dbm[row][order], links.azimuth_rad[row][order], links.elevation_rad[row][order]
    count, ratio = len(p), 10 ** ((p[0] - p) / (10 * model.los_exponent))
    u = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=1)
    a_theta = np.stack([np.sin(az), -np.cos(az), 0 * az], axis=1)
    a_phi = np.stack([np.sin(el) * np.cos(az), np.sin(el) * np.sin(az), -np.cos(el)], axis=1)
    matrix = np.vstack([a_theta, a_phi, u[1:] - ratio[1:, None] * u[:1]])
    along = (u * a).sum(axis=1)
    right = np.concatenate(
        [(a_theta * a).sum(axis=1), (a_phi * a).sum(axis=1), along[1:] - ratio[1:] * along[0]]
    )
    gap = at - a
    if not measured_angles:
        az, el = np.arctan2(gap[:, 1], gap[:, 0]), np.arctan2(gap[:, 2], np.hypot(gap[:, 0], gap[:, 1]))
    x, y, z = gap.T
    c = np.zeros((3 * count - 1, 3 * count))
    k = np.arange(count)
    c[k, k] = x * np.cos(az) + y * np.sin(az)
    c[count + k, k] = -x * np.sin(el) * np.sin(az) + y * np.sin(el) * np.cos(az)
    reach = x * np.cos(el) * np.cos(az) + y * np.cos(el) * np.sin(az) + z * np.sin(el)
    c[count + k, count + k] = reach
    by_theta = y * np.cos(el) * np.cos(az) - x * np.cos(el) * np.sin(az)
    by_phi = z * np.cos(el) - x * np.sin(el) * np.cos(az) - y * np.sin(el) * np.sin(az)
    xi = np.log(10) / (10 * model.los_exponent)
    for i in range(1, count):
        row_i = 2 * count + i - 1
        c[row_i, i], c[row_i, count + i] = by_theta[i], by_phi[i]
        c[row_i, 2 * count + i] = ratio[i] * xi * reach[0]
        c[row_i, 2 * count] = -ratio[i] * xi * reach[0]
        c[row_i, 0], c[row_i, count] = -ratio[i] * by_theta[0], -ratio[i] * by_phi[0]
    std = np.repeat([model.azimuth_std_rad, model.elevation_std_rad, model.rss_std_db], count)
    weight = np.linalg.inv(c * std**2 @ c.T)
    return np.linalg.solve(matrix.T @ weight @ matrix, matrix.T @ weight @ right)


@pytest.mark.parametrize("count", [2, 4, 7])
def test_is_the_papers_weighted_solution(draw, count: int) -> None:
    """Our K rows with η eliminated against the paper's K − 1 ratio rows with the full 3K × 3K W."""
    drawn, model = draw(30, (1,) * count, 21), SignalModel()
    at = drawn.truth_enu_m + np.random.default_rng(3).normal(0.0, 5.0, drawn.truth_enu_m.shape)
    ours = positions(inputs(drawn.links, truth=at), model)
    for row in range(30):
        assert np.allclose(ours[row], dense(drawn.links, row, at[row], model, False), atol=1e-6)


def test_jacobians_at_the_measured_angles_are_no_better(draw) -> None:
    """(47) to the letter, two weighted solves: the same RMSE within half a percent."""
    drawn, model = draw(300, (1, 1, 1, 1), 22), SignalModel()
    ours = positions(inputs(drawn.links), model)
    letter = ours.copy()
    for row in range(300):
        for _ in range(2):
            letter[row] = dense(drawn.links, row, letter[row], model, True)
    error = [np.sqrt(np.square(x - drawn.truth_enu_m).sum(axis=1).mean()) for x in (ours, letter)]
    assert abs(error[0] / error[1] - 1.0) < 0.005


@pytest.mark.parametrize(("method", "limit"), [("wls-taylor", 1.03), ("wls-taylor-bounded", 1.02)])
def test_reaches_the_bound(draw, method: str, limit: float) -> None:
    """K = 4, R₀ = 100 m, 5,000 trials, seed 11: RMSE over the bound of the same trials."""
    drawn = draw(5000, (1, 1, 1, 1), 11)
    bound = crlb(drawn.truth_enu_m, drawn.links.position_enu_m, SignalModel())
    found = locate_batch(drawn.links, drawn.area, method, covariance=False)
    ratio = rmse(found, drawn.truth_enu_m) / np.sqrt(np.trace(bound, axis1=1, axis2=2).mean())
    assert 0.95 < ratio < limit


@pytest.mark.parametrize("method", ["wls-taylor", "wls-taylor-bounded"])
@pytest.mark.parametrize(("radius_m", "angle_std_deg"), [(100.0, 1.0), (400.0, 3.0)])
def test_covariance_is_honest(draw, method: str, radius_m: float, angle_std_deg: float) -> None:
    """90 % of truths in the 90 % ellipsoid (2,000 trials: ± 1.3 % at two standard errors)."""
    drawn = draw(2000, (1, 1, 1, 1), 12, radius_m=radius_m, angle_std_deg=angle_std_deg)
    std = np.radians(angle_std_deg)
    model = SignalModel(azimuth_std_rad=std, elevation_std_rad=std)
    found = locate_batch(drawn.links, drawn.area, method, model, covariance=False)
    own = np.isfinite([e.covariance_m2[0, 0] for e in found])
    # What is left to the posterior in clean LOS is the residuals' one in a thousand.
    assert own.mean() > 0.995
    held = [e for e, is_own in zip(found, own, strict=True) if is_own]
    assert 0.87 < share_in_90(held, drawn.truth_enu_m[own]) < 0.93


def test_exact_without_noise(draw) -> None:
    drawn = draw(50, (1, 1, 1), 3, rss_std_db=0.0, angle_std_deg=0.0)
    for method in ("wls-taylor", "wls-taylor-bounded"):
        assert rmse(locate_batch(drawn.links, drawn.area, method), drawn.truth_enu_m) < 1e-5


def test_nlos_links_are_left_out(draw) -> None:
    """Their powers and angles change nothing, in a batch whose problems differ in labels too."""
    drawn = draw(20, (1, 1, 0, 1, 0), 4)
    label = drawn.links.los_probability.copy()
    label[10:, 3] = 0.0
    links = type(drawn.links)(
        drawn.links.position_enu_m, drawn.links.rss_dbm + 30.0 * (1.0 - label),
        np.where(label > 0, drawn.links.azimuth_rad, 1.0), drawn.links.elevation_rad, label,
    )  # fmt: skip
    whole = locate_batch(links, drawn.area, "wls-taylor")
    for index, estimate in enumerate(whole):
        alone = links.problem(index).subset(np.flatnonzero(label[index]))
        single = locate(alone, drawn.area, "wls-taylor")
        assert np.allclose(single.position_enu_m, estimate.position_enu_m, atol=1e-7)
        assert np.allclose(single.covariance_m2, estimate.covariance_m2, rtol=1e-6)
        assert single.transmit_power_dbm == pytest.approx(estimate.transmit_power_dbm)


def test_angles_near_pi(draw) -> None:
    """Bearings that straddle ±π say the same as the same scene turned by a right angle."""
    drawn = draw(200, (1, 1, 1, 1), 8)
    turned = drawn.links.azimuth_rad + 2 * np.pi * (np.arange(4) % 2)
    again = type(drawn.links)(
        drawn.links.position_enu_m, drawn.links.rss_dbm, turned, drawn.links.elevation_rad,
        drawn.links.los_probability,
    )  # fmt: skip
    one = locate_batch(drawn.links, drawn.area, "wls-taylor")
    two = locate_batch(again, drawn.area, "wls-taylor")
    assert np.allclose(places(one), places(two), atol=1e-6)


def test_a_constant_offset_of_the_receivers_changes_nothing_but_the_power(draw) -> None:
    drawn = draw(20, (1, 1, 1), 9)
    shifted = type(drawn.links)(
        drawn.links.position_enu_m, drawn.links.rss_dbm + 7.0, drawn.links.azimuth_rad,
        drawn.links.elevation_rad, drawn.links.los_probability,
    )  # fmt: skip
    plain = locate_batch(drawn.links, drawn.area, "wls-taylor", covariance=False)
    offset = locate_batch(
        shifted, drawn.area, "wls-taylor", SignalModel(receiver_offset_db=7.0), covariance=False
    )
    assert np.allclose(places(plain), places(offset), atol=1e-9)
    assert plain[0].transmit_power_dbm == pytest.approx(offset[0].transmit_power_dbm)


def test_ideal_uses_the_power_of_each_trial(draw) -> None:
    """Exact without noise; with it, near the bound; a wrong power shows."""
    clean = draw(20, (1, 1), 14, rss_std_db=0.0, angle_std_deg=0.0)
    gap = np.linalg.norm(clean.truth_enu_m[:, None] - clean.links.position_enu_m, axis=2)
    power = (clean.links.rss_dbm + 25.0 * np.log10(gap)).mean(axis=1)
    exact = locate_batch(clean.links, clean.area, "wls-ideal", transmit_power_dbm=power, covariance=False)
    assert rmse(exact, clean.truth_enu_m) < 1e-5
    assert exact[3].transmit_power_dbm == pytest.approx(power[3])
    model = SignalModel(known_transmit_power_dbm=float(power[0]))
    single = locate(clean.links.problem(0), clean.area, "wls-ideal", model, covariance=False)
    assert np.allclose(single.position_enu_m, clean.truth_enu_m[0], atol=1e-5)
    off = locate_batch(clean.links, clean.area, "wls-ideal", transmit_power_dbm=power + 6.0, covariance=False)
    assert rmse(off, clean.truth_enu_m) > 0.1


def test_ideal_reaches_the_bound_of_known_power(draw) -> None:
    drawn = draw(3000, (1, 1, 1, 1), 15)
    power = np.random.default_rng(15)
    gap = np.linalg.norm(drawn.truth_enu_m[:, None] - drawn.links.position_enu_m, axis=2)
    rss = 15.0 - 25.0 * np.log10(gap) + 5.0 * power.standard_normal(gap.shape)
    links = type(drawn.links)(
        drawn.links.position_enu_m, rss, drawn.links.azimuth_rad, drawn.links.elevation_rad,
        drawn.links.los_probability,
    )  # fmt: skip
    found = locate_batch(
        links, drawn.area, "wls-ideal", transmit_power_dbm=np.full(3000, 15.0),
        truth_enu_m=drawn.truth_enu_m, covariance=False,
    )  # fmt: skip
    bound = crlb(drawn.truth_enu_m, links.position_enu_m, SignalModel(), known_transmit_power=True)
    limit = np.sqrt(np.trace(bound, axis1=1, axis2=2).mean())
    assert 0.95 < rmse(found, drawn.truth_enu_m) / limit < 1.04


def test_ideal_says_what_it_needs(draw) -> None:
    drawn = draw(2, (1, 1, 1), 16)
    with pytest.raises(InputError, match="no transmit power; it needs the true one"):
        locate_batch(drawn.links, drawn.area, "wls-ideal")
    with pytest.raises(InputError, match=r"shape \(3,\); \(2,\) is needed"):
        locate_batch(drawn.links, drawn.area, "wls-ideal", transmit_power_dbm=np.zeros(3))


def test_covariance_is_withheld_where_the_bound_does_not_hold(draw) -> None:
    """A wrong bearing, and vehicles too near one another, are not described by a Taylor step."""
    drawn = draw(200, (1, 1, 1, 1), 17)
    azimuth = drawn.links.azimuth_rad.copy()
    azimuth[:, 2] += 1.0
    wrong = type(drawn.links)(
        drawn.links.position_enu_m, drawn.links.rss_dbm, azimuth, drawn.links.elevation_rad,
        drawn.links.los_probability,
    )  # fmt: skip
    # Seen from the middle of the ring all bearings are level, and a turn of one may go unseen.
    withheld = np.isnan(wls_taylor(Batch.of(wrong, drawn.area, SignalModel())).covariance_m2[:, 0, 0])
    assert withheld.mean() > 0.99
    together = draw(200, (1, 1, 1), 18, ring=np.array([0.0, 0.01, 0.02]))
    withheld = np.isnan(
        wls_taylor(Batch.of(together.links, together.area, SignalModel())).covariance_m2[:, 0, 0]
    )
    assert withheld.all()
    filled = locate(wrong.problem(0), drawn.area, "wls-taylor")
    assert np.linalg.eigvalsh(filled.covariance_m2)[0] > 0.0


def test_a_bearing_off_by_a_right_angle_gets_no_infinite_weight(draw) -> None:
    """(47) at measured angles weighs it by 1/cos² of its error."""
    drawn = draw(300, (1, 1, 1, 1), 19)
    azimuth = drawn.links.azimuth_rad.copy()
    azimuth[:, 0] += np.pi / 2
    wrong = type(drawn.links)(
        drawn.links.position_enu_m, drawn.links.rss_dbm, azimuth, drawn.links.elevation_rad,
        drawn.links.los_probability,
    )  # fmt: skip
    error = np.linalg.norm(positions(inputs(wrong), SignalModel()) - drawn.truth_enu_m, axis=1)
    assert error.max() < 250.0


def test_area_bounds_pull_an_answer_from_outside(draw) -> None:
    drawn = draw(300, (1, 1), 6, angle_std_deg=8.0)
    disc = SearchArea(np.array([20.0, 10.0]), 40.0, 2.0, 6.0)
    found = places(locate_batch(drawn.links, disc, "wls-taylor-bounded", covariance=False))
    assert (found[:, 2] >= 2.0).all()
    assert (found[:, 2] <= 6.0).all()
    assert np.hypot(found[:, 0] - 20.0, found[:, 1] - 10.0).max() <= 40.0 * (1 + 1e-9)
