from __future__ import annotations

import numpy as np

from groundstation.localization import Links, SearchArea, SignalModel
from groundstation.localization.batch import Batch
from groundstation.localization.rays import Rays, unit_bearings

MODEL = SignalModel()


def rays(place: list[list[float]], azimuth_deg: list[float], elevation_deg: list[float]) -> Rays:
    """One problem a vehicle; each with a single LOS link."""
    count = len(place)
    links = Links(
        np.array(place)[:, None],
        np.full((count, 1), -50.0),
        np.radians(azimuth_deg)[:, None],
        np.radians(elevation_deg)[:, None],
        np.ones((count, 1)),
    )
    return Rays.of(Batch.of(links, SearchArea(np.zeros(2), 100.0, 1.0, 20.0), MODEL))


def test_unit_bearings_are_71() -> None:
    east, north, down = unit_bearings(np.radians([0.0, 90.0, 17.0]), np.radians([0.0, 0.0, -90.0]))
    assert np.allclose(east, [1, 0, 0])
    assert np.allclose(north, [0, 1, 0])
    assert np.allclose(down, [0, 0, -1])


def test_the_link_is_the_surest_with_both_angles(draw) -> None:
    drawn = draw(3, (1, 1, 1, 0), 43)
    drawn.links.los_probability[:] = [0.6, 0.99, 0.9, 0.0]
    drawn.links.azimuth_rad[1, 1] = np.nan
    drawn.links.los_probability[2] = [0.6, np.nan, 0.3, 0.0]
    assert Rays.of(Batch.of(drawn.links, drawn.area, MODEL)).link.tolist() == [1, 2, 0]


def test_the_nearest_point_leaves_a_right_angle_and_never_lies_behind() -> None:
    ray = rays([[100.0, 0, 50]] * 2, [180.0, 180.0], [-30.0, -30.0])
    target = np.array([[10.0, 20.0, 5.0], [400.0, 0.0, 50.0]])
    found = ray.at(ray.along_m(target))
    assert abs((found[0] - target[0]) @ ray.direction[0]) < 1e-9
    assert np.allclose(found[1], [100.0, 0, 50])


def test_height_limits_end_the_ray() -> None:
    area = SearchArea(np.zeros(2), 100.0, 1.0, 20.0)
    ray = rays(
        [[100.0, 0, 50], [100.0, 0, 50], [100.0, 0, 10], [100.0, 0, 50], [100.0, 0, 0]],
        [180.0] * 5,
        [-45.0, -45.0, 0.0, 30.0, 30.0],
    )
    far, near = np.array([-500.0, 0, 0]), np.array([99.0, 0, 50])
    target = np.array([far, near, far, far, near])
    height = ray.at(ray.along_within_heights_m(target, area))[:, 2]
    # Down to the floor; up to the ceiling; level: untouched; upwards from above: untouched; up from below.
    assert np.allclose(height[[0, 1, 2, 4]], [1.0, 20.0, 10.0, 0.5 * (np.cos(np.pi / 6) + 25.0)])
    assert height[3] > 50.0


def test_angle_misfit_counts_deviations() -> None:
    ray = rays([[0.0, 0, 50]] * 4, [180.0] * 4, [-20.0] * 4)
    turn, tilt = np.degrees(MODEL.azimuth_std_rad), np.degrees(MODEL.elevation_std_rad)
    azimuth = np.radians([180.0, 180.0 + turn, -180.0 + turn, 180.0])
    elevation = np.radians([-20.0, -20.0, -20.0, -20.0 + 2.0 * tilt])
    at = ray.origin_enu_m + 70.0 * unit_bearings(azimuth, elevation)
    level = np.cos(np.radians(20.0)) ** 2
    assert np.allclose(ray.angle_misfit(at, MODEL), [0.0, level, level, 4.0], atol=1e-3)
