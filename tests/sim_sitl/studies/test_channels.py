import math

import numpy as np
import pytest

from sim_sitl.studies.channels import AnalyticChannel, AngleReport, RubbleChannel, told_model, wrapped_rad


def at_distance(distance_m, trials, links=4):
    offset = np.zeros((trials, links, 3))
    offset[..., 0] = distance_m
    return offset


def states(value, trials, links=4):
    return np.full((trials, links), value)


def test_a_los_link_loses_by_eq_7():
    loss = AnalyticChannel().loss_db(
        at_distance(100.0, 10_000), states(True, 10_000), np.random.default_rng(1)
    )
    assert loss.mean() == pytest.approx(50.0, abs=0.1)
    assert loss.std() == pytest.approx(5.0, rel=0.02)
    assert np.corrcoef(loss[:, 0], loss[:, 1])[0, 1] == pytest.approx(0.0, abs=0.04)


def test_an_nlos_link_loses_by_eq_8_with_one_exponent_a_trial():
    loss = AnalyticChannel().loss_db(
        at_distance(100.0, 20_000), states(False, 20_000), np.random.default_rng(2)
    )
    shared, own = 400.0 * 1.5**2 / 12.0, 7.0**2 / 12.0 + 25.0
    assert loss.mean() == pytest.approx(10.0 * 2.75 * 2.0 + 3.5, abs=0.2)
    assert loss.var() == pytest.approx(shared + own, rel=0.03)
    assert np.cov(loss[:, 0], loss[:, 1])[0, 1] == pytest.approx(shared, rel=0.05)


def test_exponents_of_each_link_do_not_go_together():
    channel = AnalyticChannel(exponent_per_link=True)
    loss = channel.loss_db(at_distance(100.0, 20_000), states(False, 20_000), np.random.default_rng(3))
    assert loss.var() == pytest.approx(400.0 * 1.5**2 / 12.0 + 7.0**2 / 12.0 + 25.0, rel=0.03)
    assert np.corrcoef(loss[:, 0], loss[:, 1])[0, 1] == pytest.approx(0.0, abs=0.03)


def test_solvers_are_told_the_analytic_channel_as_it_is():
    told = AnalyticChannel().told
    assert (told.rss_std_db, told.los_exponent, told.nlos_bias_max_db) == (5.0, 2.5, 7.0)
    assert (told.nlos_exponent_min, told.nlos_exponent_max) == (2.0, 3.5)
    assert (told.transmit_power_min_dbm, told.transmit_power_max_dbm) == (13.0, 18.0)


def test_rubble_is_calibrated_to_eq_8_at_100_m_and_told_its_variances():
    channel = RubbleChannel()
    loss = channel.loss_db(at_distance(100.0, 30_000), states(False, 30_000), np.random.default_rng(4))
    assert loss.mean() == pytest.approx(10.0 * 2.75 * 2.0 + 3.5, abs=0.25)
    told = channel.told
    pair = np.cov(loss[:, 0], loss[:, 1])
    # What links share is told as the transmit power's range, what each has as σ_s and b.
    assert pair[0, 1] + 25.0 / 12.0 == pytest.approx(told.transmit_power_std_db**2, rel=0.05)
    assert pair[0, 0] - pair[0, 1] == pytest.approx(
        told.nlos_rss_std_db**2 + told.nlos_bias_max_db**2 / 12.0, rel=0.04
    )


def test_rubble_follows_friis_over_the_clear_part():
    far = RubbleChannel(exponent=(3.0, 3.0), length_m=(10.0, 10.0), bias_db=(0.0, 0.0))
    near, away = (
        far.loss_db(at_distance(d, 20_000), states(False, 20_000), np.random.default_rng(5))
        for d in (60, 510)
    )
    assert away.mean() - near.mean() == pytest.approx(20.0, abs=1e-9)


def test_small_scale_fading_has_the_moments_told():
    channel = RubbleChannel(
        exponent=(3.0, 3.0), excess_loss_db=(5.0, 5.0), shadowing_db=(1e-9, 1e-9), length_m=(10.0, 10.0),
        bias_db=(0.0, 0.0),
    )  # fmt: skip
    loss = channel.loss_db(at_distance(100.0, 20_000), states(False, 20_000), np.random.default_rng(6))
    mean, std = channel.fading_moments_db()
    assert loss.std() == pytest.approx(std, rel=0.03)
    # The constant taken out leaves eq. (8)'s mean, whatever the parts are.
    assert loss.mean() == pytest.approx(10.0 * 2.75 * 2.0 + 3.5, abs=0.05)
    assert mean < 0.0


def test_rubble_leaves_los_links_to_eq_7():
    loss = RubbleChannel().loss_db(at_distance(100.0, 5000), states(True, 5000), np.random.default_rng(7))
    assert loss.mean() == pytest.approx(50.0, abs=0.15)
    assert loss.std() == pytest.approx(5.0, rel=0.03)


def offsets_to(target, vehicles):
    return np.asarray(vehicles, dtype=float) - np.asarray(target, dtype=float)


def test_los_angles_are_the_papers_with_their_noise():
    # A vehicle 100 m east of the target and 100 m above it looks west and down by 45°.
    offset = np.broadcast_to(offsets_to([0, 0, 0], [[100.0, 0.0, 100.0]]), (20_000, 1, 3))
    azimuth, elevation = AngleReport(1.0).draw(offset, states(True, 20_000, 1), np.random.default_rng(8))
    assert wrapped_rad(azimuth - math.pi).mean() == pytest.approx(0.0, abs=1e-3)
    assert np.degrees(wrapped_rad(azimuth - math.pi).std()) == pytest.approx(1.0, rel=0.02)
    assert np.degrees(elevation.mean()) == pytest.approx(-45.0, abs=0.03)
    assert np.degrees(elevation.std()) == pytest.approx(1.0, rel=0.02)
    assert azimuth.max() <= math.pi
    assert azimuth.min() > -math.pi


def test_nlos_angles_are_uniform_or_zero():
    offset = at_distance(50.0, 20_000, 1)
    azimuth, elevation = AngleReport().draw(offset, states(False, 20_000, 1), np.random.default_rng(9))
    assert azimuth.std() == pytest.approx(2 * math.pi / math.sqrt(12.0), rel=0.02)
    assert elevation.std() == pytest.approx(math.pi / math.sqrt(12.0), rel=0.02)
    assert elevation.mean() == pytest.approx(0.0, abs=0.02)
    zero = AngleReport(nlos_zero=True).draw(offset, states(False, 20_000, 1), np.random.default_rng(9))
    assert not np.any(zero)


def test_rounded_angles_are_whole_degrees_off_by_029():
    report = AngleReport(std_deg=0.0, rounded_deg=1.0)
    rng = np.random.default_rng(10)
    offset = rng.uniform(20.0, 100.0, (5000, 2, 3))
    azimuth, elevation = report.draw(offset, states(True, 5000, 2), rng)
    assert np.degrees(azimuth) == pytest.approx(np.rint(np.degrees(azimuth)), abs=1e-9)
    true = np.arctan2(-offset[..., 2], np.hypot(offset[..., 0], offset[..., 1]))
    assert np.abs(np.degrees(elevation - true)).max() <= 0.5 + 1e-9
    assert np.degrees((elevation - true).std()) == pytest.approx(1.0 / math.sqrt(12.0), rel=0.02)
    assert np.degrees(report.told_std_rad) == pytest.approx(0.2887, abs=1e-4)


def test_an_elevation_carried_over_the_nadir_comes_out_on_the_other_side():
    offset = np.broadcast_to(offsets_to([0, 0, 0], [[0.5, 0.0, 50.0]]), (4000, 1, 3))
    azimuth, elevation = AngleReport(3.0).draw(offset, states(True, 4000, 1), np.random.default_rng(11))
    assert elevation.min() >= -0.5 * math.pi
    over = np.abs(azimuth) < 0.5 * math.pi
    # The nadir is 0.57° away: about 42 of 100 draws of σ = 3° pass it.
    assert np.mean(over) == pytest.approx(0.425, abs=0.03)


def test_told_model_carries_the_angles():
    model = told_model(AnalyticChannel(), AngleReport(3.0))
    assert math.degrees(model.azimuth_std_rad) == pytest.approx(3.0)
    assert math.degrees(model.elevation_std_rad) == pytest.approx(3.0)
