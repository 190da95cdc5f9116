from dataclasses import dataclass

import numpy as np
import pytest

from sim_sitl.studies.channels import AnalyticChannel, RubbleChannel
from sim_sitl.studies.end_to_end import DatasetChannel
from sim_sitl.studies.laws import law_of, legendre

CHANNELS = {
    "analytic": AnalyticChannel(),
    "analytic per link": AnalyticChannel(exponent_per_link=True),
    "rubble": RubbleChannel(),
    "data set": DatasetChannel(calibration_links=100),
}


def predictive(law, rss_dbm, distance_m, line_of_sight):
    """Density of one link's received power, power and classes summed out."""
    offset = np.zeros((1, len(rss_dbm), 3))
    offset[..., 0] = distance_m
    if line_of_sight:
        return law.los(rss_dbm, offset)[:, 0] @ law.level_weight
    return np.einsum("kcl,l,c->k", law.nlos(rss_dbm, offset)[:, 0], law.level_weight, law.class_weight)


@pytest.mark.parametrize("name", CHANNELS)
@pytest.mark.parametrize("distance_m", [60.0, 350.0])
@pytest.mark.parametrize("line_of_sight", [True, False])
def test_the_law_is_that_of_what_the_channel_draws(name, distance_m, line_of_sight):
    channel = CHANNELS[name]
    count = 150 if name == "data set" else 8000
    rng = np.random.default_rng(1)
    offset = np.zeros((count, 1, 3))
    offset[..., 0] = distance_m
    loss = channel.loss_db(offset, np.full((count, 1), line_of_sight), rng)[:, 0]
    received = np.sort(rng.uniform(13.0, 18.0, count) - loss)
    raster = np.arange(-150.0, 60.0, 0.25)
    density = predictive(law_of(channel), raster, distance_m, line_of_sight)
    distribution = np.cumsum(density) * 0.25
    assert distribution[-1] == pytest.approx(1.0, abs=2e-3)
    # Kolmogorov–Smirnov: 1.95/√n is passed by chance once in a thousand; the data set's law is itself
    # estimated from as few links.
    theirs = np.interp(received, raster, distribution)
    largest = np.abs(theirs - (np.arange(count) + 0.5) / count).max()
    share = 1.95 * np.sqrt(1 / count + (1 / 100 if name == "data set" else 0.0))
    assert largest < share + (0.01 if name == "rubble" else 0.004)


def test_links_of_a_trial_are_tied_by_what_they_share():
    """Var of the mean of two links' power, from the law and from draws: power and β are common."""
    channel, law = AnalyticChannel(), law_of(AnalyticChannel())
    rng = np.random.default_rng(2)
    offset = np.zeros((40_000, 2, 3))
    offset[..., 0] = 100.0
    drawn = rng.uniform(13.0, 18.0, (40_000, 1)) - channel.loss_db(offset, np.zeros((40_000, 2), bool), rng)
    raster = np.arange(-110.0, 30.0, 0.5)
    place = np.zeros((1, len(raster), 3))
    place[..., 0] = 100.0
    nlos = law.nlos(raster, place)[:, 0]
    mean = np.einsum("k,kcl->cl", raster, nlos) * 0.5
    weight = law.class_weight[:, None] * law.level_weight
    covariance = (weight * mean**2).sum() - (weight * mean).sum() ** 2
    assert covariance == pytest.approx(np.cov(drawn.T)[0, 1], rel=0.04)


def test_legendre_integrates_polynomials_over_the_uniform():
    node, weight = legendre(2.0, 3.5, 5)
    assert weight.sum() == pytest.approx(1.0)
    assert weight @ node == pytest.approx(2.75)
    assert weight @ node**7 == pytest.approx((3.5**8 - 2.0**8) / 8.0 / 1.5)


def test_a_channel_without_a_law_is_refused():
    @dataclass(frozen=True)
    class Strange:
        pass

    with pytest.raises(TypeError, match="Strange"):
        law_of(Strange())
