"""Rings to polygons with holes, checked against Shapely's even–odd reading of the same rings."""

from __future__ import annotations

from functools import reduce

import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.domain.mission import Ring
from groundstation.server.regions import polygons


def square(west: float, south: float, side: float) -> Ring:
    """A closed square; (latitude, longitude) corners."""
    corners = [(0, 0), (0, 1), (1, 1), (1, 0), (0, 0)]
    return tuple((south + dy * side, west + dx * side) for dy, dx in corners)


def test_one_ring_is_one_polygon_in_the_order_of_geojson() -> None:
    assert polygons([square(149.0, -35.0, 0.5)]) == [
        [[[149.0, -35.0], [149.5, -35.0], [149.5, -34.5], [149.0, -34.5], [149.0, -35.0]]]
    ]


def test_holes_go_to_the_ring_round_them_and_islands_stand_alone() -> None:
    outer, hole, island, other = square(0, 0, 9), square(1, 1, 7), square(2, 2, 2), square(20, 0, 3)
    found = polygons([other, outer, hole, island])
    assert [len(polygon) for polygon in found] == [1, 2, 1]
    assert found[1][1][0] == [1.0, 1.0]
    assert found[2][0][0] == [2.0, 2.0]


def test_a_hole_that_touches_the_outline_in_a_corner_is_still_a_hole() -> None:
    touching: Ring = ((0.0, 0.0), (3.0, 1.0), (1.0, 3.0), (0.0, 0.0))
    (polygon,) = polygons([square(0, 0, 9), touching])
    assert len(polygon) == 2


def test_specks_are_left_out_and_what_matters_stays() -> None:
    large, part, hole = square(0, 0, 9), square(20, 0, 2), square(1, 1, 1)
    specks = [square(30 + i, 30, 0.5) for i in range(300)] + [square(5, 5, 0.5)]
    assert [len(polygon) for polygon in polygons([large, hole, *specks, part])] == [2, 1]


@pytest.mark.parametrize("rings", [[], [((1.0, 1.0), (1.0, 1.0), (1.0, 1.0), (1.0, 1.0))]])
def test_what_has_no_area_is_left_out(rings: list[Ring]) -> None:
    assert polygons(rings) == []


@settings(max_examples=60, deadline=None)
@given(marked=st.sets(st.tuples(st.integers(0, 5), st.integers(0, 5)), max_size=30))
def test_the_area_is_that_of_the_even_odd_rule(marked: set[tuple[int, int]]) -> None:
    # Outlines of marked squares, as tracking draws them.
    outline = shapely.union_all([shapely.box(x, y, x + 1, y + 1) for x, y in sorted(marked)])
    rings: list[Ring] = [
        tuple((float(y), float(x)) for x, y in ring.coords)
        for part in shapely.get_parts(outline)
        for ring in (part.exterior, *part.interiors)
    ]
    expected = reduce(
        shapely.symmetric_difference,
        [shapely.Polygon([(x, y) for y, x in ring]) for ring in rings],
        shapely.Polygon(),
    )
    found = [shapely.Polygon(outer, holes) for outer, *holes in polygons(rings, speck_share=0.0)]
    assert all(part.is_valid for part in found)
    assert shapely.union_all(found).symmetric_difference(expected).area == pytest.approx(0.0, abs=1e-12)
