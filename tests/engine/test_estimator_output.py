"""Values at the estimator's edge: a raster of the plane becomes squares on WGS84, none of them moved."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.target import Environment, TargetState
from groundstation.engine.estimator_output import search_map
from groundstation.localization.containment import Raster

ORIGIN = Geodetic(47.0, 8.0, 500.0)
FRAME = LocalFrame(ORIGIN)


def state() -> TargetState:
    return TargetState(
        7, 5, 1, 4, FRAME.to_geodetic((0.0, 0.0, 0.0)), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0), 8.0,
        Environment.NLOS, 0, 1, 1, "m", "home", 3, None,
    )  # fmt: skip


@pytest.mark.parametrize(("row", "column"), [(0, 0), (0, 3), (2, 1), (1, 2)])
def test_each_square_of_the_raster_lies_where_it_was(row: int, column: int) -> None:
    mass = np.full((3, 4), 0.02)
    mass[row, column] = 0.78
    west_m, south_m, cell_m = -120.0, 65.0, 2.5
    found = search_map(state(), Raster(west_m, south_m, cell_m, mass), FRAME)
    assert (found.rows, found.columns, found.cell_m) == (3, 4, cell_m)
    assert (found.beacon_id, found.time_ns, found.sequence, found.origin) == (7, 5, 3, ORIGIN)
    share = np.array([v for (v,) in struct.iter_unpack("<f", found.share)]).reshape(3, 4)
    down, right = np.unravel_index(share.argmax(), share.shape)
    middle = (west_m + (column + 0.5) * cell_m, south_m + (row + 0.5) * cell_m)
    # By the numbers of the plane, as a GIS reads them, and by the corners, as the page does.
    assert found.west_m + (right + 0.5) * found.cell_m == pytest.approx(middle[0], abs=1e-6)
    assert found.north_m - (down + 0.5) * found.cell_m == pytest.approx(middle[1], abs=1e-6)
    (north, west), (_, east), (south, _), _ = found.corners
    latitude = north + (south - north) * (down + 0.5) / 3
    longitude = west + (east - west) * (right + 0.5) / 4
    at_east, at_north, _ = FRAME.to_enu(Geodetic(latitude, longitude, ORIGIN.altitude_amsl_m))
    assert (at_east, at_north) == pytest.approx(middle, abs=0.01)
