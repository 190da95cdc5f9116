"""Rings under the even–odd rule to polygons with holes: what a map draws.

Rule: nothing is computed about the belief here. The rings come from tracking, never cross
each other and are closed; this says which of them is a hole of which, and leaves out specks:
where a belief is nearly even, its edge is noise in hundreds of pieces, which no eye needs and
which would make a message of 60 kB. Exported files keep them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from groundstation.domain.mission import Ring

LonLatRing = list[list[float]]
"""Closed ring of [longitude, latitude] pairs, degrees."""

DECIMALS = 6
"""Of degrees on the wire: 0.1 m, a tenth of the smallest square that a region is made of."""


SPECK_SHARE = 0.01
"""Parts and holes smaller than this share of the largest ring are left out."""


def polygons(rings: Sequence[Ring], speck_share: float = SPECK_SHARE) -> list[list[LonLatRing]]:
    """GeoJSON MultiPolygon coordinates: outer rings in the given order, each with its holes."""
    turned = [_rounded(ring) for ring in rings]
    areas = [_area(ring) for ring in turned]
    least = speck_share * max(areas, default=0.0)
    kept = [ring for ring, area in zip(turned, areas, strict=True) if len(ring) >= 4 and area >= least]
    holders = [[other for other in kept if other is not ring and _within(ring, other)] for ring in kept]
    # A ring within an odd number of others is a hole of the innermost, which is the one held by most.
    depth = {id(ring): len(held_by) for ring, held_by in zip(kept, holders, strict=True)}
    found = {id(ring): [ring] for ring in kept if depth[id(ring)] % 2 == 0}
    for ring, held_by in zip(kept, holders, strict=True):
        if depth[id(ring)] % 2:
            found[id(max(held_by, key=lambda other: depth[id(other)]))].append(ring)
    return list(found.values())


def _rounded(ring: Ring) -> LonLatRing:
    points: LonLatRing = []
    for latitude, longitude in ring:
        point = [round(float(longitude), DECIMALS), round(float(latitude), DECIMALS)]
        if not points or point != points[-1]:
            points.append(point)
    return points


def _area(ring: LonLatRing) -> float:
    """Within a ring, square degrees, relative to its first corner: for comparisons at one place only."""
    if not ring:
        return 0.0
    x, y = ring[0]
    twice = sum((a[0] - x) * (b[1] - y) - (b[0] - x) * (a[1] - y) for a, b in pairwise(ring))
    return abs(twice) / 2.0


def _within(ring: LonLatRing, other: LonLatRing) -> bool:
    """Whether most corners of ``ring`` lie inside ``other``: outlines may touch in a corner."""
    corners = ring[:-1]
    return 2 * sum(_inside(x, y, other) for x, y in corners) > len(corners)


def _inside(x: float, y: float, ring: LonLatRing) -> bool:
    inside = False
    for (x0, y0), (x1, y1) in pairwise(ring):
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
            inside = not inside
    return inside
