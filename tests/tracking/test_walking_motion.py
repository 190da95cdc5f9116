from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from groundstation.localization import SignalModel
from groundstation.tracking.walking_motion import drifted
from groundstation.tracking.walking_points import Points

MODEL = replace(SignalModel(), angle_bias_std_rad=math.radians(1.0))


def learned() -> tuple[Points, np.ndarray]:
    """Two vehicles, of whose offsets and errors of bearing three points are sure."""
    points = Points.none(2, MODEL).take(np.zeros(0, dtype=int))
    shapes = {name: getattr(points, name).shape[:-1] for name in Points.__slots__}
    filled = Points(*(np.full((*shapes[name], 3), 0.5) for name in Points.__slots__))
    return (
        replace(filled, bias_rad=np.full((2, 2, 3), 0.03), bias_rad2=np.full((2, 2, 3), 1e-7)),
        0.01 * np.eye(3),
    )


def test_what_was_learned_of_a_vehicle_is_forgotten_and_the_power_is_not() -> None:
    points, covariance = learned()
    after, spread = drifted(points, covariance, 2000.0, MODEL)
    np.testing.assert_allclose(after.bias_rad2, MODEL.angle_bias_std_rad**2)
    np.testing.assert_allclose(after.bias_rad, 0.0, atol=1e-12)
    np.testing.assert_allclose(after.nuisance[1:], 0.0, atol=1e-6)
    np.testing.assert_allclose(np.diag(spread), [0.01, 1.0, 1.0])
    np.testing.assert_array_equal(after.nuisance[0], points.nuisance[0])
    np.testing.assert_array_equal(after.position_enu_m, points.position_enu_m)


def test_two_short_steps_are_one_long_one() -> None:
    long, long_spread = drifted(*learned(), 30.0, MODEL)
    once, once_spread = drifted(*learned(), 12.0, MODEL)
    twice, twice_spread = drifted(once, once_spread, 18.0, MODEL)
    for name in ("nuisance", "bias_rad", "bias_rad2"):
        np.testing.assert_allclose(getattr(twice, name), getattr(long, name))
    np.testing.assert_allclose(twice_spread, long_spread)
    # A walker's error of bearing is believed to half its prior's width again within half a minute.
    assert math.sqrt(float(long.bias_rad2.max())) == pytest.approx(math.radians(0.795), rel=0.01)
