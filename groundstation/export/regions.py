"""Containment regions as polygons with holes, on WGS84.

Rule: a region says what share of the belief it holds. Where tracking drew none, the circle of
``radius_90_m`` stands for 90 %: that is how the radius is defined.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import shapely
from shapely.geometry import Polygon
from shapely.geometry.polygon import orient

from groundstation.domain.geometry import LocalFrame
from groundstation.domain.mission import Ring
from groundstation.domain.target import TargetState
from groundstation.export.rounding import degrees

CIRCLE_CORNERS = 64
LonLat = tuple[float, float]
"""(longitude, latitude) in degrees: the order of GeoJSON and KML."""


@dataclass(frozen=True, slots=True)
class Region:
    """One containment region."""

    containment: float
    """Share of the belief within, 0..1."""
    polygons: tuple[tuple[tuple[LonLat, ...], ...], ...]
    """For each polygon its outer ring, counter-clockwise, and its holes, clockwise; rings closed."""


def regions_of(target: TargetState) -> list[Region]:
    """The regions of a belief, smallest share first."""
    if not target.regions:
        circle = _circle(target)
        return [] if circle is None else [Region(0.9, ((circle,),))]
    found = [Region(share, _polygons(rings)) for share, rings in sorted(target.regions)]
    return [region for region in found if region.polygons]


def _polygons(rings: tuple[Ring, ...]) -> tuple[tuple[tuple[LonLat, ...], ...], ...]:
    """Outer rings and holes told apart by the even–odd rule."""
    shape: shapely.Geometry = Polygon()
    for ring in rings:
        if len(ring) < 4:
            continue
        part = shapely.make_valid(Polygon([(longitude, latitude) for latitude, longitude in ring]))
        shape = shapely.symmetric_difference(shape, part)
    parts = [part for part in shapely.get_parts(shapely.normalize(shape)) if isinstance(part, Polygon)]
    rounded = [_rounded(part) for part in parts]
    return tuple(polygon for polygon in rounded if polygon)


def _rounded(polygon: Polygon) -> tuple[tuple[LonLat, ...], ...]:
    turned = orient(polygon)
    rings = (_ring(list(ring.coords)) for ring in (turned.exterior, *turned.interiors))
    kept = tuple(ring for ring in rings)
    # What is smaller than the rounding is a point, no polygon; a hole as small is no hole.
    return tuple(ring for ring in kept if len(set(ring)) >= 3) if len(set(kept[0])) >= 3 else ()


def _ring(coordinates: list[tuple[float, ...]]) -> tuple[LonLat, ...]:
    return tuple((degrees(point[0]), degrees(point[1])) for point in coordinates)


def _circle(target: TargetState) -> tuple[LonLat, ...] | None:
    if not (math.isfinite(target.radius_90_m) and target.radius_90_m > 0.0):
        return None
    frame = LocalFrame(target.position)
    corners: list[LonLat] = []
    for index in range(CIRCLE_CORNERS):
        angle_rad = 2.0 * math.pi * index / CIRCLE_CORNERS
        offset = (target.radius_90_m * math.cos(angle_rad), target.radius_90_m * math.sin(angle_rad), 0.0)
        place = frame.to_geodetic(offset)
        corners.append((degrees(place.longitude_deg), degrees(place.latitude_deg)))
    return (*corners, corners[0])
