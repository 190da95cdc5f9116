from __future__ import annotations

import math
import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapely
from scipy.special import ndtr

from groundstation.localization import SERVICE_MODEL, Links, SearchArea, SignalModel, locate_batch
from groundstation.localization.batch import Batch
from groundstation.localization.containment import region_rings
from groundstation.localization.posterior import PosteriorAnswer, beliefs, posterior

TRIALS = 200
SEED = 21
# K = 4, R₀ = 100 m; the limits of an exact posterior mean, metres.
ENVIRONMENTS = {"LOS": ((1, 1, 1, 1), 1.88), "mixed": ((1, 0, 0, 0), 14.1), "NLOS": ((0, 0, 0, 0), 45.0)}


@cache
def beliefs_of(draw, environment: str) -> tuple[list[PosteriorAnswer], np.ndarray]:
    drawn = draw(TRIALS, ENVIRONMENTS[environment][0], SEED)
    return beliefs(Batch.of(drawn.links, drawn.area, SignalModel())), drawn.truth_enu_m


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_reaches_the_limits(draw, environment: str) -> None:
    """200 trials, seed 21: the RMSE is the limit's within three of its standard errors."""
    found, truth = beliefs_of(draw, environment)
    square = np.square(np.array([b.position_enu_m for b in found]) - truth).sum(axis=1)
    rmse = math.sqrt(square.mean())
    error = square.std() / (2.0 * rmse * math.sqrt(TRIALS))
    assert abs(rmse - ENVIRONMENTS[environment][1]) < 3.0 * error
    expected = math.sqrt(np.mean([np.trace(b.covariance_m2) for b in found]))
    assert abs(rmse - expected) < 3.5 * error


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_regions_hold_their_share(draw, environment: str) -> None:
    """Highest-density regions of 50 and 90 %: the truth inside as often as said."""
    found, truth = beliefs_of(draw, environment)
    level = np.array([b.credible_level(x)[0] for b, x in zip(found, truth, strict=True)])
    for share in (0.5, 0.9):
        assert abs(np.mean(level <= share) - share) < 3.3 * math.sqrt(share * (1.0 - share) / TRIALS)


@pytest.mark.parametrize(("environment", "low", "high"), [("LOS", 0.85, 0.95), ("NLOS", 0.85, 0.96)])
def test_ellipsoid_of_the_covariance(draw, environment: str, low: float, high: float) -> None:
    """χ² of three degrees at 90 %: 6.251."""
    found, truth = beliefs_of(draw, environment)
    error = truth - np.array([b.position_enu_m for b in found])
    inside = [e @ np.linalg.solve(b.covariance_m2, e) < 6.251 for e, b in zip(error, found, strict=True)]
    assert low <= np.mean(inside) <= high


# ---- against a fine grid with every nuisance integrated numerically ---------------------------------------


def grid_posterior(
    links: Links, area: SearchArea, model: SignalModel
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, 3), their share and density by brute force: nothing moment-matched.

    P_t uniform and β_NLOS uniform on Gauss–Legendre nodes, b uniform as a difference of two
    normal distributions, the two states of each link as a mixture at each node.
    """
    step, radius = 1.5, area.radius_m
    axis = np.arange(-radius + step / 2, radius, step)
    height = np.linspace(area.height_min_m, area.height_max_m, 11)
    height = 0.5 * (height[1:] + height[:-1])
    x = np.stack(np.meshgrid(axis, axis, height, indexing="ij"), axis=-1).reshape(-1, 3)
    x = x[np.hypot(x[:, 0], x[:, 1]) < radius]
    offset = x[:, None] - links.position_enu_m
    flat = np.hypot(offset[..., 0], offset[..., 1])
    path = 10.0 * np.log10(np.hypot(flat, offset[..., 2]))
    turn = np.arctan2(offset[..., 1], offset[..., 0]) - links.azimuth_rad
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    lift = np.arctan2(offset[..., 2], flat) - links.elevation_rad
    anywhere = 1.0 / (2.0 * np.pi**2)
    seen = np.exp(-0.5 * (turn / model.azimuth_std_rad) ** 2 - 0.5 * (lift / model.elevation_std_rad) ** 2)
    seen /= 2.0 * np.pi * model.azimuth_std_rad * model.elevation_std_rad
    seen = (1.0 - model.angle_outlier_probability) * seen + model.angle_outlier_probability * anywhere
    seen = np.where(links.has_angle(), seen, anywhere)
    p, std, bias = links.los_probability, model.rss_std_db, model.nlos_bias_max_db
    node, weight = np.polynomial.legendre.leggauss(9)
    half_power = 0.5 * (model.transmit_power_max_dbm - model.transmit_power_min_dbm)
    half_exponent = 0.5 * (model.nlos_exponent_max - model.nlos_exponent_min)
    density = np.zeros(len(x))
    for power, power_weight in zip(model.transmit_power_mean_dbm + half_power * node, weight, strict=True):
        residual = links.rss_dbm - power + model.los_exponent * path
        clear = p * seen * np.exp(-0.5 * (residual / std) ** 2) / (std * math.sqrt(2.0 * np.pi))
        middle = 0.5 * (model.nlos_exponent_max + model.nlos_exponent_min)
        for exponent, exponent_weight in zip(middle + half_exponent * node, weight, strict=True):
            residual = links.rss_dbm - power + exponent * path
            hidden = (ndtr((residual + bias) / std) - ndtr(residual / std)) / bias
            both = np.prod(clear + (1.0 - p) * anywhere * hidden, axis=1)
            density += power_weight * exponent_weight * both
    return x, density / density.sum(), np.log(density)


@pytest.mark.parametrize(
    ("p", "seed"),
    [
        ((0.0, 0.0, 0.0, 0.0), 1),
        ((0.0, 0.0, 0.0), 2),
        ((1.0, 0.0, 0.0, 0.0), 3),
        ((0.8, 0.3, 0.1, 0.05), 4),
        ((0.6, 0.6, 0.02), 5),
        ((0.5, 0.97, 0.4, 0.9), 6),
        ((1.0, 1.0), 7),
        ((0.3,), 8),
    ],
)
def test_is_the_brute_force_posterior(p: tuple[float, ...], seed: int) -> None:
    """Mean to 6 % of the spread, spread to 6 %, levels to 5 %."""
    rng = np.random.default_rng(seed)
    count, radius = len(p), 50.0
    turn = 2.0 * np.pi * (np.arange(count) + rng.random()) / count
    place = np.stack([50 * np.cos(turn), 50 * np.sin(turn), np.full(count, 40.0)], axis=1)
    truth = np.array([*rng.uniform(-30, 30, 2), rng.uniform(2, 18)])
    state = rng.random(count) < np.array(p)
    offset = truth - place
    distance = np.linalg.norm(offset, axis=1)
    rss = rng.uniform(13, 18) - 10 * np.where(state, 2.5, rng.uniform(2, 3.5)) * np.log10(distance)
    rss += 5.0 * rng.standard_normal(count) - ~state * rng.uniform(0, 7, count)
    std = math.radians(6.0)
    azimuth = np.arctan2(offset[:, 1], offset[:, 0]) + std * rng.standard_normal(count)
    elevation = np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1]))
    elevation = elevation + std * rng.standard_normal(count)
    azimuth = np.where(state, azimuth, rng.uniform(-np.pi, np.pi, count))
    elevation = np.where(state, elevation, rng.uniform(-1.5, 0.5, count))
    links = Links(place, rss, azimuth, elevation, np.array(p))
    area = SearchArea(np.zeros(2), radius, 0.0, 20.0)
    model = SignalModel(azimuth_std_rad=std, elevation_std_rad=std)
    x, share, density = grid_posterior(links, area, model)
    mean = share @ x
    covariance = (x - mean).T @ ((x - mean) * share[:, None])
    spread = math.sqrt(np.trace(covariance))
    found = posterior(links, area, model)
    assert np.linalg.norm(found.position_enu_m - mean) < 0.06 * spread
    assert abs(math.sqrt(np.trace(found.covariance_m2)) / spread - 1.0) < 0.06
    probe = x[:: len(x) // 40]
    level = np.array([share[density > at].sum() for at in density[:: len(x) // 40]])
    assert np.abs(found.credible_level(probe) - level).max() < 0.05


# ---- against closed forms ---------------------------------------------------------------------------------


def test_one_bearing_and_the_height_limits() -> None:
    """Powers that say nothing: volume r² cos φ dr dφ dθ within the heights, Gaussian in φ and θ."""
    std, azimuth, elevation = 0.0175, 0.7, -0.6
    model = SignalModel(
        rss_std_db=1e3, azimuth_std_rad=std, elevation_std_rad=std, angle_outlier_probability=1e-9
    )
    place = np.array([-30.0, -20.0, 50.0])
    links = Links(place[None], np.array([-40.0]), np.array([azimuth]), np.array([elevation]), np.ones(1))
    found = posterior(links, SearchArea(np.zeros(2), 100.0, 0.0, 20.0), model)
    node, weight = np.polynomial.hermite_e.hermegauss(25)
    down = elevation + std * node
    near, far = 30.0 / np.sin(-down), 50.0 / np.sin(-down)
    weight = weight * np.cos(down)
    volume = weight @ (far**3 - near**3) / 3.0
    first = weight * (far**4 - near**4) / 4.0 / volume
    level = (first @ np.cos(down)) * math.exp(-0.5 * std**2)
    shift = np.array([level * math.cos(azimuth), level * math.sin(azimuth), first @ np.sin(down)])
    spread = weight @ (far**5 - near**5) / 5.0 / volume - shift @ shift
    assert np.linalg.norm(found.position_enu_m - place - shift) < 0.05 * math.sqrt(spread)
    assert abs(math.sqrt(np.trace(found.covariance_m2) / spread) - 1.0) < 0.03


def test_equal_powers_on_a_ring_mean_the_centre() -> None:
    turn = 2.0 * np.pi * np.arange(6) / 6
    place = np.stack([100 * np.cos(turn), 100 * np.sin(turn), np.full(6, 50.0)], axis=1)
    none = np.full(6, np.nan)
    for p in (0.0, 0.5, 1.0):
        links = Links(place, np.full(6, -40.0), none, none, np.full(6, p))
        found = posterior(links, SearchArea(np.zeros(2), 100.0, 0.0, 20.0), SignalModel())
        assert np.linalg.norm(found.position_enu_m[:2]) < 0.5
        assert abs(found.covariance_m2[0, 0] / found.covariance_m2[1, 1] - 1.0) < 0.05


@pytest.mark.parametrize("count", [3, 10, 50])
def test_sharp_bearings_find_the_place(draw, count: int) -> None:
    """0.1° from 3 to 50 vehicles: within four standard deviations, which shrink with the root of K."""
    drawn = draw(3, (1,) * count, 4, angle_std_deg=0.1)
    model = SignalModel(azimuth_std_rad=math.radians(0.1), elevation_std_rad=math.radians(0.1))
    for belief, truth in zip(
        beliefs(Batch.of(drawn.links, drawn.area, model)), drawn.truth_enu_m, strict=True
    ):
        error = truth - belief.position_enu_m
        assert error @ np.linalg.solve(belief.covariance_m2, error) < 16.3
        assert 0.1 < math.sqrt(np.trace(belief.covariance_m2)) * math.sqrt(count) < 0.6


# ---- any input --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 2, 3, 12, 50])
@pytest.mark.parametrize("model", [SignalModel(), SERVICE_MODEL], ids=["paper", "service"])
def test_any_number_of_links(draw, count: int, model: SignalModel) -> None:
    drawn = draw(1, (0,) * count, 2)
    answer = posterior(drawn.links.problem(0), drawn.area, model)
    assert np.isfinite(answer.position_enu_m).all()
    spread = np.sqrt(answer.covariance_m2[0, 0] + answer.covariance_m2[1, 1])
    assert (8.0 if count == 50 else 20.0) < spread < 75.0
    assert answer.path_loss_exponent.shape == answer.los_probability.shape == (count,)


def test_a_batch_is_its_problems(draw) -> None:
    """Soft and certain links, a b_max of its own each: as one by one."""
    drawn = draw(6, (1, 0, 0, 0), 8)
    drawn.links.los_probability[2:4] = [0.9, 0.2, 0.05, 0.1]
    bias = np.linspace(6.0, 8.0, 6)
    together = locate_batch(drawn.links, drawn.area, "posterior", bias_max_db=bias)
    for row, estimate in enumerate(together):
        model = SignalModel(nlos_bias_max_db=float(bias[row]))
        alone = posterior(drawn.links.problem(row), drawn.area, model)
        assert np.allclose(estimate.position_enu_m, alone.position_enu_m, atol=1e-6)
        assert np.allclose(estimate.covariance_m2, alone.covariance_m2, atol=1e-5)
        assert abs(estimate.transmit_power_dbm - alone.transmit_power_dbm) < 1e-6


def test_a_wrong_label_is_outvoted(draw) -> None:
    """An NLOS link said to be LOS with 90 % whose bearing points elsewhere: three others agree."""
    drawn = draw(1, (1, 1, 1, 1), 6)
    links = drawn.links.problem(0)
    links.azimuth_rad[1] += 1.5
    links.los_probability[:] = 0.9
    found = posterior(links, drawn.area, SignalModel())
    assert np.linalg.norm(found.position_enu_m - drawn.truth_enu_m[0]) < 6.0
    assert found.los_probability[1] < 0.3
    assert found.los_probability[[0, 2, 3]].min() > 0.9


def test_one_outlier_of_30_db_does_not_make_it_certain(draw) -> None:
    drawn = draw(1, (1, 1, 1, 1), 5)
    links = drawn.links.problem(0)
    links.rss_dbm[2] += 30.0
    answer = posterior(links, drawn.area, SignalModel())
    # Four bearings outvote the power.
    assert np.linalg.norm(answer.position_enu_m - drawn.truth_enu_m[0]) < 8.0


def test_power_is_estimated(draw) -> None:
    drawn = draw(1, (1, 1, 1, 1), 9, rss_std_db=0.0, angle_std_deg=0.1)
    model = SignalModel(rss_std_db=0.3, transmit_power_min_dbm=0.0, transmit_power_max_dbm=40.0)
    links = drawn.links.problem(0)
    distance = np.linalg.norm(links.position_enu_m - drawn.truth_enu_m[0], axis=1)
    true_power = float((links.rss_dbm + 25.0 * np.log10(distance)).mean())
    assert abs(posterior(links, drawn.area, model).transmit_power_dbm - true_power) < 0.5


def test_known_power_narrows(draw) -> None:
    drawn = draw(1, (0, 0, 0), 3)
    links = drawn.links.problem(0)
    wide = SignalModel(transmit_power_min_dbm=-20.0, transmit_power_max_dbm=50.0)
    unknown = posterior(links, drawn.area, wide)
    known = posterior(links, drawn.area, replace(wide, known_transmit_power_dbm=15.0))
    assert known.transmit_power_dbm == 15.0
    assert np.linalg.slogdet(known.covariance_m2)[1] < np.linalg.slogdet(unknown.covariance_m2)[1]


def test_levels_outside_and_in_a_flat_area(draw) -> None:
    drawn = draw(1, (1, 0, 0, 0), 3)
    links = drawn.links.problem(0)
    found = posterior(links, drawn.area, SignalModel())
    outside = np.array([[500.0, 0.0, 5.0], [0.0, 0.0, 90.0]])
    assert (found.credible_level(outside) == 1.0).all()
    ground = SearchArea(np.zeros(2), 100.0, 3.0, 3.0)
    flat = posterior(links, ground, SignalModel())
    assert abs(flat.position_enu_m[2] - 3.0) < 1e-9
    best = flat.mesh.center_enu_m[np.argmax(flat.log_likelihood)]
    assert flat.credible_level(best)[0] < 0.3


def test_belief_travels_between_processes_and_gives_regions(draw) -> None:
    drawn = draw(1, (1, 0, 0, 0), 3)
    found = posterior(drawn.links.problem(0), drawn.area, SignalModel())
    copied = pickle.loads(pickle.dumps(found))
    assert (copied.credible_level(drawn.truth_enu_m) == found.credible_level(drawn.truth_enu_m)).all()
    areas = []
    for _, rings in region_rings(found.mesh, found.mass):
        shape = shapely.Polygon()
        for ring in rings:
            shape = shape.symmetric_difference(shapely.Polygon(ring))
        areas.append(shape.area)
    assert areas == sorted(areas)


@pytest.mark.parametrize("los", [(1, 0, 0, 0), (1, 1, 1, 1)])
def test_bearings_that_never_stray_contradict_without_a_breakdown(draw, los: tuple[int, ...]) -> None:
    """A model that knows no stray bearings, and a bearing that points into the sky: finite all the same."""
    drawn = draw(2, los, 71)
    model = SignalModel(angle_outlier_probability=0.0, rss_outlier_probability=0.0)
    elevation = np.where(np.arange(4) == 0, 0.5, drawn.links.elevation_rad)
    for links in (drawn.links, replace(drawn.links, elevation_rad=elevation)):
        for estimate in locate_batch(links, drawn.area, "posterior", model):
            assert np.isfinite(estimate.position_enu_m).all()
            assert np.isfinite(estimate.covariance_m2).all()
