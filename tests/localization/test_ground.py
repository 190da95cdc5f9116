"""Heights of the ground: between the nodes, outside the grid, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.domain.errors import InputError
from groundstation.localization.ground import GroundHeights


def test_ground_heights_are_linear_between_nodes_and_go_on_outside() -> None:
    ground = GroundHeights(
        0.0, 0.0, 10.0, np.array([[0.0, 10.0, 20.0], [5.0, 15.0, 25.0]]), np.array([[1, 1, 0], [1, 1, 1]])
    )
    east, north = np.array([0.0, 5.0, 15.0, 20.0, 90.0]), np.array([0.0, 5.0, 5.0, 10.0, -7.0])
    assert ground.at(east, north).tolist() == pytest.approx([0.0, 7.5, 17.5, 25.0, 20.0])
    assert [ground.is_known(e, n) for e, n in ((0, 0), (19, 1), (19, 9), (26, 0), (-6, 0))] == [
        True, False, True, False, False,
    ]  # fmt: skip
    with pytest.raises(InputError, match="two by two"):
        GroundHeights(0.0, 0.0, 1.0, np.zeros((1, 5)), np.ones((1, 5)))
    with pytest.raises(InputError, match="finite"):
        GroundHeights(0.0, 0.0, 1.0, np.full((2, 2), np.nan), np.ones((2, 2)))
