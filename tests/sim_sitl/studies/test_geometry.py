import math

import numpy as np
import pytest

from sim_sitl.dataset.geometry import draw_geometry
from sim_sitl.studies.geometry import (
    HARD_GEOMETRIES,
    DatasetRows,
    Fixed,
    Ring,
    area_of,
    draw_targets,
    on_circle,
    ring_enu_m,
)


def test_targets_are_uniform_in_the_disc_and_in_height():
    target = draw_targets(40_000, 100.0, np.random.default_rng(1))
    distance = np.hypot(target[:, 0], target[:, 1])
    # Uniform in a disc: mean square R²/2, a quarter within half the radius, no direction preferred.
    assert np.mean(distance**2) == pytest.approx(5000.0, rel=0.02)
    assert np.mean(distance < 50.0) == pytest.approx(0.25, abs=0.01)
    assert distance.max() <= 100.0
    assert target[:, :2].mean(axis=0) == pytest.approx([0.0, 0.0], abs=1.0)
    assert target[:, 2].min() >= 1.0
    assert target[:, 2].max() <= 20.0
    assert target[:, 2].mean() == pytest.approx(10.5, abs=0.1)
    assert target[:, 2].std() == pytest.approx(19.0 / math.sqrt(12.0), rel=0.02)


@pytest.mark.parametrize(("vehicles", "inner"), [(2, 0), (3, 0), (4, 0), (5, 1), (6, 2), (7, 3)])
def test_up_to_four_vehicles_stand_on_the_circle_and_the_others_on_the_inner_ring(vehicles, inner):
    ring = ring_enu_m(vehicles, 200.0)
    distance = np.hypot(ring[:, 0], ring[:, 1])
    assert np.sort(distance) == pytest.approx([100.0] * inner + [200.0] * (vehicles - inner))
    assert (ring[:, 2] == 50.0).all()
    for radius in (100.0, 200.0):
        group = np.sort(np.arctan2(*ring[np.isclose(distance, radius)][:, 1::-1].T) % (2 * math.pi))
        gaps = np.diff(np.append(group, group[:1] + 2 * math.pi))
        assert gaps == pytest.approx([2 * math.pi / len(gaps)] * len(gaps)) if len(gaps) else True
    if inner:
        assert math.degrees(math.atan2(ring[4, 1], ring[4, 0])) == pytest.approx(45.0)


def test_the_ring_is_the_same_in_every_trial_and_draws_nothing():
    rng = np.random.default_rng(3)
    placed = Ring(5, 150.0).place(np.zeros((6, 3)), rng)
    assert placed.shape == (6, 5, 3)
    assert (placed == placed[0]).all()
    assert rng.random() == np.random.default_rng(3).random()


def test_dataset_rows_are_placed_as_the_generator_places_them():
    rng = np.random.default_rng(4)
    target = draw_targets(8000, 100.0, rng)
    offset = DatasetRows(4).place(target, rng) - target[:, None, :]
    range_m = np.linalg.norm(offset, axis=-1)
    for low, high, share in ((10.0, 100.0, 0.5), (100.0, 150.0, 0.3), (150.0, 200.0, 0.2)):
        assert np.mean((range_m >= low) & (range_m < high)) == pytest.approx(share, abs=0.01)
    assert offset[..., 2].min() >= 0.0
    assert offset[..., 2].max() <= 20.0
    own = [
        draw_geometry(np.random.default_rng([4, row]), line_of_sight=bool(row % 2), captures=1)
        for row in range(1500)
    ]
    theirs = np.concatenate([geometry.position_enu_m for geometry in own])
    quantiles = (0.1, 0.3, 0.5, 0.7, 0.9)
    assert np.quantile(range_m, quantiles) == pytest.approx(
        np.quantile(np.linalg.norm(theirs, axis=1), quantiles), abs=7.0
    )
    assert np.quantile(offset[..., 2], quantiles) == pytest.approx(
        np.quantile(theirs[:, 2], quantiles), abs=1.2
    )


def test_a_rows_area_does_not_give_the_target_away():
    rng = np.random.default_rng(5)
    target = draw_targets(20_000, 100.0, rng)
    assert area_of(DatasetRows()).center_enu_m.tolist() == [0.0, 0.0]
    # Answering the centre is as bad as in the disc of V-C: √(R²/2 + 19²/12).
    error = np.linalg.norm(target - [0.0, 0.0, 10.5], axis=1)
    assert math.sqrt(np.mean(error**2)) == pytest.approx(math.hypot(70.711, 5.485), rel=0.01)


def test_the_density_of_rows_places_integrates_over_targets_as_they_are_drawn():
    """Mean of 1/density over draws is the volume of what it covers, whatever the density."""
    rng = np.random.default_rng(6)
    rows = DatasetRows(1)
    target = np.zeros((6000, 3))
    offset = rows.place(target, rng)[:, 0]
    inner = np.linalg.norm(offset, axis=1) < 100.0
    density = np.array([rows.density(vehicle[None], np.zeros((1, 3)))[0] for vehicle in offset])
    low = inner & (offset[:, 2] < 5.0)
    # Volumes of the slabs below and above 5 m within 100 m range, less what lies within 10 m.
    height = np.linspace(0.0, 20.0, 200_001)
    outer = math.pi * (100.0**2 - height**2)
    hole = math.pi * np.maximum(10.0**2 - height**2, 0.0)
    steep = np.maximum(height / 0.95, 10.0)
    slab = outer - np.maximum(hole, math.pi * (steep**2 - height**2))
    expected = slab[height < 5.0].sum() / slab.sum()
    found = (1.0 / density[low]).sum() / (1.0 / density[inner]).sum()
    assert found == pytest.approx(expected, rel=0.05)


def test_fixed_vehicles_stand_where_they_are_told():
    geometry = Fixed(((50.0, 0.0), (0.0, -300.0)), radius_m=80.0)
    placed = geometry.place(np.zeros((3, 3)), np.random.default_rng(0))
    assert geometry.vehicles == 2
    assert placed[2].tolist() == [[50.0, 0.0, 50.0], [0.0, -300.0, 50.0]]
    assert area_of(geometry).radius_m == 80.0


def test_on_circle_is_about_its_centre():
    assert np.array(on_circle((0, 90), 10.0, (5.0, -5.0))) == pytest.approx(
        np.array([[15.0, -5.0], [5.0, 5.0]])
    )


def test_hard_geometries_are_what_they_say():
    places = {
        name: geometry.place(np.zeros((1, 3)), np.random.default_rng(0))[0]
        for name, (_, geometry) in HARD_GEOMETRIES.items()
    }
    distance = {name: np.hypot(*place[:, :2].T) for name, place in places.items()}
    assert np.hypot(*(places["outside"][:, :2] - [-250.0, 0.0]).T) == pytest.approx([100.0] * 4)
    assert distance["outside"].min() > 100.0
    assert HARD_GEOMETRIES["wide"][1].radius_m > distance["wide"].max()
    assert np.sort(distance["one-close"]) == pytest.approx([50.0, 300.0, 300.0, 300.0])
    assert places["one-side"][:, 0].max() < -100.0
    azimuth = np.degrees(np.arctan2(places["uneven"][:, 1], places["uneven"][:, 0]))
    assert np.sum(np.abs(azimuth) <= 40.1) == 3
    assert [len(places[name]) for name in ("k2", "k3")] == [2, 3]
    assert [HARD_GEOMETRIES[name][1].radius_m for name in ("r200", "r400")] == [200.0, 400.0]
