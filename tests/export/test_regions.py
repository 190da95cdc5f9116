"""Regions: outer rings and holes told apart, orientation, area kept, the circle when there are none."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import shapely

from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.target import TargetState
from groundstation.export.regions import regions_of

Belief = Callable[..., TargetState]
MakeRing = Callable[[float, float, float], tuple[tuple[float, float], ...]]


def test_without_regions_the_circle_of_the_radius(belief: Belief) -> None:
    target = belief(radius_90_m=50.0)
    (region,) = regions_of(target)
    assert region.containment == 0.9
    ((circle,),) = region.polygons
    assert circle[0] == circle[-1]
    assert shapely.LinearRing(circle).is_ccw
    frame = LocalFrame(target.position)
    for longitude, latitude in circle:
        east, north, _ = frame.to_enu(Geodetic(latitude, longitude, target.position.altitude_amsl_m))
        assert math.hypot(east, north) == pytest.approx(50.0, abs=0.02)


@pytest.mark.parametrize("radius_m", [math.nan, math.inf, 0.0])
def test_without_a_radius_there_is_no_circle(belief: Belief, radius_m: float) -> None:
    assert regions_of(belief(radius_90_m=radius_m)) == []


def test_even_odd_rings_become_polygons_with_holes(belief: Belief, ring: MakeRing) -> None:
    outer, hole, island = ring(0.5, 0.5, 0.3), ring(0.5, 0.5, 0.2), ring(0.5, 0.5, 0.1)
    beside = ring(0.5, 1.5, 0.1)
    for order in ([outer, hole, island, beside], [beside, island, hole, outer]):
        (region,) = regions_of(belief(regions=((0.5, tuple(order)),)))
        shapes = [shapely.Polygon(polygon[0], polygon[1:]) for polygon in region.polygons]
        assert all(shape.is_valid for shape in shapes)
        assert sorted(len(polygon) for polygon in region.polygons) == [1, 1, 2]
        assert sum(shape.area for shape in shapes) == pytest.approx(0.36 - 0.16 + 0.04 + 0.04)
        for exterior, *holes in region.polygons:
            assert shapely.LinearRing(exterior).is_ccw
            assert not any(shapely.LinearRing(each).is_ccw for each in holes)


def test_smallest_share_first_and_nothing_degenerate(belief: Belief, ring: MakeRing) -> None:
    line = ((1.0, 1.0), (1.0, 2.0), (1.0, 1.0))
    dot = ring(1.0, 1.0, 1e-12)
    regions = ((0.95, (ring(1, 1, 0.2),)), (0.5, (ring(1, 1, 0.1), line)), (0.9, (dot,)))
    assert [region.containment for region in regions_of(belief(regions=regions))] == [0.5, 0.95]
