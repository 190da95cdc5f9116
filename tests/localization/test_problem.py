from __future__ import annotations

import numpy as np
import pytest
import shapely

from groundstation.domain.errors import InputError
from groundstation.localization import locate
from groundstation.localization.ground import GroundHeights
from groundstation.localization.problem import Links, SearchArea, SignalModel


def links(count: int = 4, **changed: object) -> Links:
    angle = 2.0 * np.pi * np.arange(count) / max(count, 1)
    values: dict[str, object] = {
        "position_enu_m": np.stack([50 * np.cos(angle), 50 * np.sin(angle), np.full(count, 50.0)], axis=1),
        "rss_dbm": np.full(count, -60.0),
        "azimuth_rad": np.full(count, np.nan),
        "elevation_rad": np.full(count, np.nan),
        "los_probability": np.zeros(count),
    }
    values.update(changed)
    return Links(**values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (links(2), "got 2 link"),
        (links(position_enu_m=np.full((4, 3), np.nan)), "position of link 0 is not finite"),
        (links(rss_dbm=np.array([-60, np.nan, -60, -60])), "received power of link 1"),
        (links(position_enu_m=np.tile([1.0, 2.0, 50.0], (4, 1))), "two or more places"),
        (links(los_probability=np.array([0.1, 0.2, 1.2, 0.0])), "link 2 is 1.2"),
    ],
)
def test_what_cannot_be_located_is_said(bad: Links, message: str) -> None:
    with pytest.raises(InputError, match=message):
        locate(bad, SearchArea(np.zeros(2), 100.0, 0.0, 20.0), "lsre-socp")


def test_shapes_must_agree() -> None:
    with pytest.raises(InputError, match=r"rss_dbm has shape \(3,\)"):
        links(rss_dbm=np.zeros(3))
    with pytest.raises(InputError, match=r"\(K, 3\) is needed"):
        links(position_enu_m=np.zeros((4, 2)))


def test_unknown_link_is_not_los() -> None:
    known = links(los_probability=np.array([0.5, np.nan, 0.49, 1.0]))
    assert known.los(0.5).tolist() == [True, False, False, True]


def test_clip_to_disc_and_polygon() -> None:
    disc = SearchArea(np.array([10.0, 0.0]), 5.0, 0.0, 20.0)
    assert np.allclose(disc.clip(np.array([30.0, 0.0, 50.0])), [15.0, 0.0, 20.0])
    square = SearchArea.of_polygon(shapely.box(0, 0, 10, 10), 0.0, 20.0)
    assert np.allclose(square.clip(np.array([[-4.0, 5.0, -3.0], [2.0, 3.0, 4.0]])), [[0, 5, 0], [2, 3, 4]])
    assert square.radius_m == pytest.approx(np.sqrt(50.0))


@pytest.mark.parametrize(
    "make",
    [
        lambda: SearchArea(np.zeros(2), 0.0, 0.0, 20.0),
        lambda: SearchArea(np.array([np.nan, 0.0]), 10.0, 0.0, 20.0),
        lambda: SearchArea(np.zeros(2), 10.0, 20.0, 0.0),
        lambda: SearchArea.of_polygon(shapely.Polygon(), 0.0, 20.0),
        lambda: SignalModel(rss_std_db=0.0),
        lambda: SignalModel(angle_outlier_probability=1.0),
        lambda: SignalModel(rss_outlier_probability=-0.1),
        lambda: SignalModel(nlos_exponent_min=3.0, nlos_exponent_max=2.0),
        lambda: SignalModel(transmit_power_min_dbm=30.0),
        lambda: SignalModel(vehicle_position_std_m=-1.0),
        lambda: SignalModel(vehicle_height_std_m=float("inf")),
    ],
)
def test_impossible_settings_are_refused(make: object) -> None:
    with pytest.raises(InputError):
        make()  # type: ignore[operator]


def test_how_unsure_vehicles_are_of_their_places_in_three_forms() -> None:
    model = SignalModel(vehicle_position_std_m=2.0, vehicle_height_std_m=3.0)
    assert model.vehicle_std_m == (2.0, 3.0)
    assert model.vehicle_variance_m2 == (4.0, 9.0)
    np.testing.assert_array_equal(model.vehicle_covariance_m2, np.diag([4.0, 4.0, 9.0]))


def test_height_limits_follow_the_ground() -> None:
    ground = GroundHeights(-200.0, -200.0, 400.0, np.array([[0.0, 40.0], [0.0, 40.0]]), np.ones((2, 2)))
    area = SearchArea(np.zeros(2), 100.0, 0.0, 1.0).over(ground, 2.0, 12.0)
    low, high = area.height_limits_m(np.array([-50.0, 50.0]), np.zeros(2))
    assert low.tolist() == pytest.approx([17.0, 27.0])
    assert high.tolist() == pytest.approx([27.0, 37.0])
    # Both planes hold every place of the disc.
    assert area.height_min_m == pytest.approx(12.0, abs=0.3)
    assert area.height_max_m == pytest.approx(42.0, abs=0.3)
    clipped = area.clip(np.array([[50.0, 0.0, 500.0], [-50.0, 0.0, -500.0]]))
    assert clipped[:, 2].tolist() == pytest.approx([37.0, 17.0])
