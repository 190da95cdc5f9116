from __future__ import annotations

import numpy as np
import pytest
import shapely

from groundstation.localization import SearchArea
from groundstation.localization.region import Region

BENT = shapely.Polygon([(120, -60), (190, 0), (120, 60), (145, 0)])


@pytest.mark.parametrize(
    "area",
    [
        SearchArea(np.array([100.0, -50]), 70.0, 2.0, 18.0),
        SearchArea.of_polygon(BENT, 0.0, 20.0),
        SearchArea.of_polygon(BENT.reverse(), 0.0, 20.0),
    ],
)
def test_constraints_hold_exactly_inside(area: SearchArea) -> None:
    region = Region.of(area)
    rng = np.random.default_rng(0)
    place = np.column_stack(
        [rng.uniform(0, 220, 4000), rng.uniform(-130, 80, 4000), rng.uniform(-5, 25, 4000)]
    )
    hull = area if area.polygon_en_m is None else SearchArea.of_polygon(shapely.convex_hull(BENT), 0.0, 20.0)
    expected = hull.contains(place[:, 0], place[:, 1])
    expected &= (place[:, 2] >= area.height_min_m) & (place[:, 2] <= area.height_max_m)
    got = (region.constraints().values(region.scaled(place)) >= 0.0).all(axis=1)
    assert 200 < expected.sum() < 3800
    assert (got == expected).all()
    assert np.allclose(region.metres(region.scaled(place)), place)


@pytest.mark.parametrize(
    "area",
    [
        SearchArea(np.zeros(2), 70.0, 2.0, 18.0),
        SearchArea(np.zeros(2), 70.0, 5.0, 5.0),
        SearchArea.of_polygon(BENT, 0.0, 20.0),
    ],
)
def test_starts_lie_strictly_inside(area: SearchArea) -> None:
    region = Region.of(area)
    place = np.random.default_rng(1).uniform(-500, 500, (300, 3))
    place[0] = region.center_m
    inside = region.inside(place)
    assert (region.constraints().values(inside) > 0.0).all()
    assert np.allclose(region.metres(inside[0]), region.center_m)
    well = region.metres(0.3 * inside)
    assert np.allclose(region.metres(region.inside(well)), well)
