"""The squares that a searcher sees."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from groundstation.localization.containment import Raster, raster, region_rings, smooth_raster
from groundstation.localization.mesh import Mesh
from groundstation.tracking.search_map import UNITS, square_shares


def two_heaps() -> tuple[Mesh, np.ndarray]:
    """Equal boxes of 4 m over 400 m; seven tenths in the north-east, the rest in the south-west."""
    steps = np.arange(-198.0, 200.0, 4.0)
    east, north = (part.ravel() for part in np.meshgrid(steps, steps))
    center = np.stack([east, north, np.zeros(east.size)], axis=1)
    mesh = Mesh(center, np.full((east.size, 2), 2.0), np.full(east.size, np.log(64.0)))

    def heap(x: float, y: float, std: float) -> np.ndarray:
        value = np.exp(-0.5 * ((east - x) ** 2 + (north - y) ** 2) / std**2)
        return value / value.sum()

    return mesh, 0.7 * heap(60.0, 60.0, 12.0) + 0.3 * heap(-70.0, -40.0, 18.0)


def test_rows_begin_in_the_north_and_shares_add_up() -> None:
    squares = square_shares(smooth_raster(*two_heaps()))
    assert squares.share.shape == squares.containment.shape == (64, 64)
    assert abs(float(squares.share.sum()) - 1.0) < 1e-3
    row, column = np.unravel_index(int(squares.share.argmax()), squares.share.shape)
    assert row < 32 < column
    assert squares.containment[row, column] == squares.containment.min()


def test_containment_is_the_share_of_the_likelier_squares() -> None:
    squares = square_shares(smooth_raster(*two_heaps()))
    for row, column in ((10, 40), (20, 50), (45, 12), (63, 63)):
        likelier = squares.share >= squares.share[row, column]
        assert abs(float(squares.share[likelier].sum()) - squares.containment[row, column] / UNITS) < 2e-3


def test_the_squares_up_to_90_percent_are_the_90_percent_region() -> None:
    mesh, mass = two_heaps()
    picture = smooth_raster(mesh, mass)
    squares = square_shares(picture)
    rings = dict(region_rings(mesh, mass, picture=picture))[0.9]
    area = sum(abs(sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in pairwise(ring))) / 2.0 for ring in rings)
    marked = int((squares.containment <= 9000).sum()) * picture.cell_m**2
    assert abs(marked - area) < 0.05 * area


def test_equal_squares_are_equally_likely_whatever_their_order() -> None:
    even = square_shares(Raster(0.0, 0.0, 1.0, np.full((8, 8), 1.0 / 64.0)))
    assert set(even.containment.ravel().tolist()) == {UNITS}
    mass = np.zeros((4, 4))
    mass[0, 0] = mass[3, 3] = 0.4
    mass[1, 2] = 0.2
    squares = square_shares(Raster(0.0, 0.0, 1.0, mass))
    assert squares.containment[3, 0] == squares.containment[0, 3] == 8000
    assert squares.containment[2, 2] == squares.containment[0, 0] == UNITS


def test_the_map_holds_nearly_all_of_the_belief() -> None:
    mesh, mass = two_heaps()
    assert raster(mesh, mass).mass.sum() > 0.998
