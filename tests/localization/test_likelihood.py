from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from groundstation.localization import regression
from groundstation.localization.bearings import angle_log_likelihood
from groundstation.localization.likelihood import (
    DB_OF_LOG,
    ExponentGrid,
    bearing_density,
    log_squares,
    mixture_variance_db2,
    shared_variance_m2,
)
from groundstation.localization.problem import SignalModel
from groundstation.localization.regression import Evidence
from groundstation.localization.whitening import Observations, whiten


def path_loss_db(place: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """10 log₁₀ of the distances (n, 3) × (C, 3) → (n, C), as the paper writes it."""
    gap = np.linalg.norm(place[:, None] - candidates, axis=-1)
    return np.asarray(10.0 * np.log10(np.maximum(gap, 1.0)))


MODEL = SignalModel(receiver_offset_std_db=1.5, los_exponent_std=0.2)


def flight(count: int, seed: int, parents: int, foreign: bool = False) -> Observations:
    """Two vehicles; ``foreign``: windows of the other one are parents too."""
    rng = np.random.default_rng(seed)
    link = np.arange(count) % 2
    place = rng.uniform(-60, 60, (count, 3)) + np.array([0, 0, 60])
    earlier = np.full((count, parents), -1)
    for row in range(count):
        mine = [r for r in range(row) if foreign or link[r] == link[row]][-parents:]
        earlier[row, : len(mine)] = mine
    return Observations(
        place,
        link,
        rng.uniform(-60, -30, count),
        rng.uniform(0, 1, count),
        np.full(count, 0.5),
        np.full(count, np.nan),
        np.full(count, np.nan),
        np.full((count, 2), 0.02),
        np.zeros(count),
        np.ones(count),
        earlier,
        np.zeros((count, 2)),
    )


def dense_log_likelihood(seen: Observations, x: np.ndarray, grid: ExponentGrid, shared: float = 0.0) -> float:
    """The same model as one multivariate normal a node, with its whole covariance."""
    p = seen.los_probability
    gap = np.linalg.norm(seen.position_enu_m[:, None] - seen.position_enu_m[None], axis=2)
    same = seen.link[:, None] == seen.link[None]
    shadow = np.outer(p, p) * MODEL.rss_std_db**2 + np.outer(1 - p, 1 - p) * MODEL.nlos_rss_std_db**2
    covariance = shadow * np.exp(-gap / 25.0) * np.where(same, 1.0, shared)
    total = p * MODEL.rss_std_db**2 + (1 - p) * MODEL.nlos_rss_std_db**2
    own = (
        total
        - np.diag(shadow)
        + mixture_variance_db2(p, MODEL, MODEL.nlos_bias_max_db)
        + seen.white_variance_db2
    )
    covariance += np.diag(own) + MODEL.transmit_power_std_db**2
    offset = np.sqrt(MODEL.receiver_offset_std_db**2 + (1 - p) * MODEL.nlos_bias_max_db**2 / 12)
    covariance += np.outer(offset, offset) * same
    path = path_loss_db(seen.position_enu_m, x[None])[:, 0]
    terms = []
    for los, nlos, prior in zip(grid.los, grid.nlos, grid.log_prior, strict=True):
        mean = MODEL.transmit_power_mean_dbm - (p * los + (1 - p) * nlos) * path
        mean -= 0.5 * MODEL.nlos_bias_max_db * (1 - p)
        terms.append(prior + multivariate_normal(mean, covariance).logpdf(seen.rss_dbm))
    return float(np.logaddexp.reduce(terms))


def evidence_of(
    seen: Observations, candidates: np.ndarray, parts: list[int], model: SignalModel = MODEL
) -> Evidence:
    evidence = Evidence.empty(len(candidates), 2)
    for first, last in zip([0, *parts], [*parts, seen.count], strict=True):
        shown = Observations(*(getattr(seen, name)[:last] for name in Observations.__dataclass_fields__))
        evidence.add(shown, whiten(shown, first, 2, 25.0, model), candidates)
    return evidence


def test_sequential_form_is_the_multivariate_normal() -> None:
    """With all earlier windows as parents nothing is approximated: differences agree to 1e-8."""
    seen = flight(9, 3, parents=9)
    grid = ExponentGrid.of(MODEL)
    candidates = np.random.default_rng(4).uniform(-80, 80, (6, 3))
    ours = evidence_of(seen, candidates, [1, 4, 5]).log_likelihood_on_grid(grid)
    dense = np.array([dense_log_likelihood(seen, x, grid) for x in candidates])
    assert np.allclose(ours - ours[0], dense - dense[0], atol=1e-8)


def test_shadowing_that_vehicles_share_is_the_multivariate_normal() -> None:
    """70 % of the field alike for both vehicles, all earlier windows of both as parents: to 1e-8."""
    seen = flight(9, 13, parents=9, foreign=True)
    grid = ExponentGrid.of(MODEL)
    candidates = np.random.default_rng(4).uniform(-80, 80, (6, 3))
    ours = evidence_of(seen, candidates, [2, 5], replace(MODEL, shared_shadowing=0.7)).log_likelihood_on_grid(
        grid
    )
    dense = np.array([dense_log_likelihood(seen, x, grid, 0.7) for x in candidates])
    assert np.allclose(ours - ours[0], dense - dense[0], atol=1e-8)


def test_few_parents_are_close() -> None:
    """Along a straight flight at 8 m spacing three parents lose less than 0.1 of log likelihood."""
    rng = np.random.default_rng(0)
    count = 30
    seen = flight(count, 7, parents=3)
    place = np.stack(
        [8.0 * (np.arange(count) // 2), 30.0 * (np.arange(count) % 2), np.full(count, 50.0)], axis=1
    )
    parts = [getattr(seen, name) for name in Observations.__dataclass_fields__]
    parts[0], parts[3], parts[4] = place, np.zeros(count), np.full(count, 0.01)
    parts[2] = -60.0 + 3.0 * rng.standard_normal(count)
    seen = Observations(*parts)
    grid = ExponentGrid.of(MODEL)
    candidates = rng.uniform(-80, 80, (8, 3))
    ours = evidence_of(seen, candidates, []).log_likelihood_on_grid(grid)
    dense = np.array([dense_log_likelihood(seen, x, grid) for x in candidates])
    assert np.abs((ours - ours[0]) - (dense - dense[0])).max() < 0.1


def test_batches_do_not_matter() -> None:
    seen = flight(12, 5, parents=3)
    candidates = np.random.default_rng(1).uniform(-80, 80, (5, 3))
    grid = ExponentGrid.of(MODEL)
    one = evidence_of(seen, candidates, []).log_likelihood_on_grid(grid)
    many = evidence_of(seen, candidates, list(range(1, 12))).log_likelihood_on_grid(grid)
    assert np.allclose(one, many, atol=1e-9)


def test_how_many_losses_are_worked_out_at_once_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = flight(12, 4, 3, foreign=True)
    candidates = np.random.default_rng(2).uniform(-80, 80, (7, 3))
    rows, sums = whiten(seen, 0, 2, 25.0, MODEL), []
    for block in (1, 36, 10_000):
        monkeypatch.setattr(regression, "_BLOCK", block)
        sums.append(Evidence.empty(7, 2))
        sums[-1].add(seen, rows, candidates, null=True)
    for other in sums[1:]:
        np.testing.assert_allclose(other.level_path, sums[0].level_path, rtol=1e-6)
        np.testing.assert_allclose(other.path_path, sums[0].path_path, rtol=1e-6)
        np.testing.assert_allclose(other.loading_path, sums[0].loading_path, rtol=1e-6, atol=1e-5)


def test_losses_are_those_of_the_distance_and_the_elevation() -> None:
    """Slant, straight below (17 dB at most) and closer than 1 m; each in dB, to single precision."""
    vehicle = np.array([[3.0, -4.0, 60.0]])
    places = np.array([[43.0, 26.0, 10.0], [3.2, -4.1, 20.0], [3.1, -4.0, 60.2]])
    path, deep = log_squares(vehicle, places, null=True)
    slant_m, below_m = np.hypot(50.0, 50.0), np.linalg.norm(places[1] - vehicle[0])
    np.testing.assert_allclose(
        DB_OF_LOG * path[0], [10 * np.log10(slant_m), 10 * np.log10(below_m), 0.0], atol=1e-5
    )
    np.testing.assert_allclose(
        DB_OF_LOG * deep[0], [10 * np.log10(2.0), -10 * np.log10(0.02), 0.0], atol=1e-5
    )
    np.testing.assert_allclose(DB_OF_LOG * path, path_loss_db(vehicle, places), atol=1e-5)
    assert log_squares(vehicle, places, null=False)[1] is None


def test_losses_far_from_the_origin_are_as_good() -> None:
    """100 km off: differences, not coordinates, are rounded to single precision."""
    away = np.array([1e5, -1e5, 3e3])
    rng = np.random.default_rng(4)
    vehicle, places = rng.uniform(-200, 200, (5, 3)), rng.uniform(-200, 200, (40, 3))
    vehicle[:, 2], places[:, 2] = 40.0, 5.0
    path, _ = log_squares(vehicle + away, places + away, null=False)
    np.testing.assert_allclose(DB_OF_LOG * path, path_loss_db(vehicle, places), atol=3e-5)


def test_second_visit_to_a_place_teaches_little() -> None:
    """Ten windows from one spot spread less than two from spots far apart."""
    model = SignalModel()
    candidates = np.array([[60.0, 0, 5], [-60.0, 0, 5]])

    def gap(places: np.ndarray, rss: np.ndarray) -> float:
        count = len(rss)
        parents = np.arange(count)[:, None] - 1
        none = np.full(count, np.nan)
        zero = np.zeros(count)
        seen = Observations(
            places, np.zeros(count, dtype=int), rss, zero, zero + 0.1, none, none, np.ones((count, 2)),
            zero, zero, parents, np.zeros((count, 2)),
        )  # fmt: skip
        evidence = Evidence.empty(2, 1)
        evidence.add(seen, whiten(seen, 0, 1, 25.0, model), candidates)
        both = evidence.log_likelihood_on_grid(ExponentGrid.of(model))
        return float(abs(both[0] - both[1]))

    hovering = gap(np.tile([80.0, 0, 50], (10, 1)), np.full(10, -40.0))
    moving = gap(np.array([[80.0, 0, 50], [-80.0, 0, 50]]), np.array([-40.0, -50.0]))
    assert hovering < moving


def test_angles_wrap_and_tails_are_finite() -> None:
    model = SignalModel(angle_outlier_probability=0.01)
    seen = Observations(
        np.array([[0.0, 0, 50]]), np.zeros(1, dtype=int), np.array([np.nan]), np.ones(1), np.ones(1),
        np.array([np.pi - 1e-3]), np.array([-0.5]), np.full((1, 2), 0.02), np.ones(1), np.ones(1),
        np.full((1, 1), -1), np.zeros((1, 2)),
    )  # fmt: skip
    reach = 50 / np.tan(0.5)
    spots = reach * np.array([[-1.0, 1e-3, 0], [-1.0, -1e-3, 0], [1.0, 0, 0], [0, 1.0, 0]])
    (value,) = angle_log_likelihood(seen, 0, spots, np.full((4, 2), 1e-3), model)
    assert abs(value[0] - value[1]) < 0.1
    assert value[0] - value[2] > 5
    assert np.isclose(value[2], value[3])
    assert np.isfinite(value).all()


def bearings(toward: list[tuple[float, float, float]], p: float) -> Observations:
    """Windows from a ring, each with the bearing to the place that is given for it."""
    count = len(toward)
    turn = 2 * np.pi * np.arange(count) / count
    place = np.stack([90 * np.cos(turn), 90 * np.sin(turn), np.full(count, 50.0)], axis=1)
    offset = np.array(toward) - place
    none = np.full(count, np.nan)
    return Observations(
        place, np.zeros(count, dtype=int), none, np.zeros(count), np.ones(count),
        np.arctan2(offset[:, 1], offset[:, 0]),
        np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1])),
        np.full((count, 2), 0.02), np.full(count, p), np.ones(count), np.full((count, 1), -1),
        np.zeros((count, 2)),
    )  # fmt: skip


def test_one_bearing_among_liars_claims_less_than_one_among_witnesses() -> None:
    """Same label, same bearing to A; beside it 19 bearings to nowhere in common, or 19 to A."""
    model = SignalModel(angle_outlier_probability=0.05, los_shares=(0.01, 0.05, 0.2, 0.5, 0.8, 0.95))
    rng = np.random.default_rng(6)
    a, b = (20.0, 10.0, 5.0), (-30.0, -25.0, 5.0)
    scattered = [tuple(rng.uniform(-300, 300, 3) * [1, 1, 0]) for _ in range(19)]
    candidates = np.array([a, b])

    def claim(seen: Observations, shares: tuple[float, ...]) -> float:
        evidence = Evidence.empty(2, 1, len(shares))
        chosen = replace(model, los_shares=shares)
        evidence.angle_log += angle_log_likelihood(seen, 0, candidates, np.full((2, 2), 0.5), chosen)
        at_a, at_b = evidence.log_likelihood_on_grid(ExponentGrid.of(model))
        return float(at_a - at_b)

    liars = bearings([a, *scattered], 0.5)
    witnesses = bearings([a] * 20, 0.5)
    assert claim(liars, (0.5,)) > 4.0
    assert claim(liars, model.los_shares) < claim(liars, (0.5,)) - 2.0
    assert claim(witnesses, model.los_shares) > 50.0


@pytest.mark.parametrize(
    ("width", "tolerance"), [(0.3, 0.01), (1.0, 0.01), (1.4, 0.01), (3.0, 0.12), (10.0, 0.5)]
)
def test_boxes_of_any_width_add_up_to_the_ray(width: float, tolerance: float) -> None:
    """Density of a bearing times the volume, summed over boxes from 0.3 to 10 σ wide.

    Up to 1.4 σ, where the centres alone are taken, the integral to 1 %; of wide boxes enough to be split.
    """
    std, away = 0.02, 80.0
    cell = width * std * away
    count = int(np.ceil(60.0 / cell)) | 1
    steps = (np.arange(count) - count // 2 + 0.37) * cell
    north, up = np.meshgrid(steps, steps, indexing="ij")
    offset = np.stack([np.full(north.size, away), north.ravel(), up.ravel()])
    spread = np.full(north.size, cell**2 / 12.0)
    density = bearing_density(offset, spread, spread, (0.0, 0.0), (std, std))
    # d(azimuth) d(elevation) = dy dz / away² on the ray.
    total = density.sum() * cell**2 / away**2
    assert abs(total - 1.0) < tolerance


def fine_grid(model: SignalModel) -> ExponentGrid:
    """β_LOS in 121 steps over ±5 σ, β_NLOS in 400."""
    los = model.los_exponent + model.los_exponent_std * np.linspace(-5.0, 5.0, 121)
    weight = np.exp(-0.5 * np.square((los - model.los_exponent) / model.los_exponent_std))
    span = model.nlos_exponent_max - model.nlos_exponent_min
    nlos = model.nlos_exponent_min + span * (np.arange(400) + 0.5) / 400
    mass = np.repeat(weight / weight.sum() / 400, 400)
    return ExponentGrid(np.repeat(los, 400), np.tile(nlos, 121), np.log(mass), los, nlos, model)


def test_exponents_beyond_their_limits_are_unlikely_not_impossible() -> None:
    """Limits far under the truth: the sum over a grid with the prior's tails, and the mean goes there."""
    seen = flight(40, 9, parents=3)
    places = np.array([[0.0, 0.0, 0.0], [40.0, -20.0, 0.0], [-50.0, 30.0, 0.0]])
    rng = np.random.default_rng(2)
    heard = 15.5 - 4.0 * path_loss_db(seen.position_enu_m, places[:1])[:, 0] - 4.0
    seen = replace(
        seen,
        rss_dbm=heard + rng.standard_normal(40),
        los_probability=np.zeros(40),
        link=np.zeros(40, dtype=int),
    )
    hard = replace(MODEL, nlos_exponent_min=2.0, nlos_exponent_max=3.0, los_exponent_std=0.0)
    soft = replace(hard, nlos_exponent_doubt=0.15)
    evidence = evidence_of(seen, places, [], hard)
    assert evidence.solved(ExponentGrid.of(hard)).means_at(0)[1] < 3.0
    assert 3.2 < evidence.solved(ExponentGrid.of(soft)).means_at(0)[1] < 4.2
    nlos = np.linspace(1.0, 5.5, 1500)
    beyond = np.log(np.maximum(2.0 / nlos, 1.0)) + np.log(np.maximum(nlos / 3.0, 1.0))
    grid = ExponentGrid(
        np.full(1500, soft.los_exponent), nlos, -beyond / 0.15, np.array([soft.los_exponent]), nlos, soft
    )
    summed, ours = evidence.log_likelihood_on_grid(grid), evidence.log_likelihood(ExponentGrid.of(soft))
    np.testing.assert_allclose(ours - ours[0], summed - summed[0], atol=0.05)
    tight = evidence.log_likelihood(ExponentGrid.of(hard))
    assert np.abs((tight - tight[0]) - (summed - summed[0])).max() > 0.3


def test_noise_may_be_higher_than_told_and_never_lower() -> None:
    seen = flight(40, 9, parents=3)
    places = np.array([[0.0, 0.0, 0.0], [40.0, -20.0, 0.0]])

    def contrast(spread_db: float, degrees: float | None) -> float:
        """How much the first place, where it is, is ahead."""
        rng = np.random.default_rng(5)
        heard = 15.5 - 3.0 * path_loss_db(seen.position_enu_m, places[:1])[:, 0]
        told = replace(
            seen, rss_dbm=heard + spread_db * rng.standard_normal(40), los_probability=np.zeros(40)
        )
        first, second = evidence_of(told, places, []).log_likelihood(ExponentGrid.of(MODEL), degrees)
        return float(first - second)

    assert contrast(0.1, 5.0) == pytest.approx(contrast(0.1, None), rel=1e-6)
    assert abs(contrast(25.0, 5.0)) < 0.5 * abs(contrast(25.0, None))


@pytest.mark.parametrize("limits", [(2.0, 3.5), (1.5, 8.0), (4.0, 5.0)])
def test_exponents_in_closed_form_are_the_fine_sum(limits: tuple[float, float]) -> None:
    """β_NLOS within, at and outside its limits; β_LOS uncertain: differences to 0.05."""
    model = replace(MODEL, nlos_exponent_min=limits[0], nlos_exponent_max=limits[1])
    seen = flight(40, 9, parents=3)
    candidates = np.random.default_rng(4).uniform(-80, 80, (12, 3))
    evidence = evidence_of(seen, candidates, [7], model)
    ours = evidence.log_likelihood(ExponentGrid.of(model))
    fine = evidence.log_likelihood_on_grid(fine_grid(model))
    np.testing.assert_allclose(ours - ours[0], fine - fine[0], atol=0.05)
    # With the noise unknown β_LOS is taken as Gaussian on the noise's scale: so here it is certain.
    certain = replace(model, los_exponent_std=0.0)
    ours = evidence.log_likelihood(ExponentGrid.of(certain), 6.0)
    fine = evidence.log_likelihood_on_grid(ExponentGrid.of(certain, 400), 6.0)
    np.testing.assert_allclose(ours - ours[0], fine - fine[0], atol=0.05)


def test_antennas_null_is_the_multivariate_normal() -> None:
    """g ~ N(1, 0.8) as a rank-one part of the covariance, all earlier windows as parents: to 1e-8."""
    model = replace(MODEL, antenna_null_mean=1.0, antenna_null_std=0.8, los_exponent_std=0.0)
    model = replace(model, nlos_exponent_min=2.7, nlos_exponent_max=2.7)
    seen = flight(9, 3, parents=9)
    candidates = np.random.default_rng(4).uniform(-80, 80, (6, 3)) * [1, 1, 0.1]
    evidence = Evidence.empty(6, 2)
    for first, last in [(0, 4), (4, 9)]:
        part = Observations(*(getattr(seen, name)[:last] for name in Observations.__dataclass_fields__))
        evidence.add(part, whiten(part, first, 2, 25.0, model), candidates, null=model.has_antenna_null)
    ours = evidence.log_likelihood(ExponentGrid.of(model))
    p = seen.los_probability
    rows = whiten(seen, 0, 2, 25.0, replace(model, transmit_power_min_dbm=0.0, transmit_power_max_dbm=0.0))
    dense = []
    for x in candidates:
        away = x - seen.position_enu_m
        cos2 = np.square(away[:, :2]).sum(axis=1) / np.square(away).sum(axis=1)
        null = 10.0 * np.log10(np.maximum(cos2, 0.02))
        path = path_loss_db(seen.position_enu_m, x[None])[:, 0]
        exponent = p * model.los_exponent + (1.0 - p) * 2.7
        mean = model.transmit_power_mean_dbm - exponent * path - 0.5 * model.nlos_bias_max_db * (1 - p) + null
        # The covariance that the whitening stands for, power and offsets put back.
        mix = np.zeros((9, 9))
        for row in range(9):
            family = np.concatenate([[row], np.where(seen.parents[row] >= 0, seen.parents[row], 0)])
            np.add.at(mix[row], family, rows.mixing[row])
        base = np.linalg.inv(mix.T @ mix)
        offset = np.sqrt(model.receiver_offset_std_db**2 + (1 - p) * model.nlos_bias_max_db**2 / 12)
        base += np.outer(offset, offset) * (seen.link[:, None] == seen.link)
        base += model.transmit_power_std_db**2 + 0.8**2 * np.outer(null, null)
        dense.append(multivariate_normal(mean, base).logpdf(seen.rss_dbm))
    np.testing.assert_allclose(ours - ours[0], np.array(dense) - dense[0], atol=1e-4)
    flat = evidence.log_likelihood(
        ExponentGrid.of(replace(model, antenna_null_mean=0.0, antenna_null_std=0.0))
    )
    assert np.abs((ours - ours[0]) - (flat - flat[0])).max() > 0.1


def test_what_places_leave_unsure_together_is_between_the_best_and_the_worst() -> None:
    """Assumed 1 m and 2 m. Vague ones count less, and those without a line of sight not at all."""
    model = SignalModel(vehicle_position_std_m=1.0, vehicle_height_std_m=2.0)
    alike = np.full((4, 2), [9.0, 25.0])
    assert shared_variance_m2(alike, np.ones(4), model) == pytest.approx((9.0, 25.0))
    fleet = np.array([[64.0, 64.0], [1.0, 4.0], [1.0, 4.0], [1.0, 4.0]])
    # Weights 1/65 and 1/2: (64/65 + 3/2) / (1/65 + 3/2).
    assert shared_variance_m2(fleet, np.ones(4), model)[0] == pytest.approx(1.6396, abs=1e-4)
    assert shared_variance_m2(fleet, np.array([0.0, 1.0, 1.0, 1.0]), model) == pytest.approx((1.0, 4.0))
    assert shared_variance_m2(fleet, np.zeros(4), model) == shared_variance_m2(fleet, np.ones(4), model)
    exact = np.array([[0.0, 0.0], [1.0, 4.0]])
    assert shared_variance_m2(exact, np.ones(2), model) == pytest.approx((1.0 / 3.0, 4.0 / 3.0))
    # A channel of the paper's: nobody is off.
    assert shared_variance_m2(np.zeros((3, 2)), np.ones(3), SignalModel()) == (0.0, 0.0)
