from __future__ import annotations

import numpy as np

from groundstation.localization import Links, SignalModel, locate
from groundstation.localization.lsre import lsre_socp_iterative
from groundstation.localization.projection import (
    los_anchor,
    project,
    project_within_heights,
    projection_label_aware,
    projection_label_aware_literal,
    ray_direction,
)

MODEL = SignalModel()


def test_projection_is_the_nearest_point_of_the_ray(draw) -> None:
    links = draw(1, (1, 0, 0, 0), 41).links.problem(0)
    origin, direction = links.position_enu_m[0], ray_direction(links, 0)
    found = project(links, 0, np.array([10.0, 20.0, 5.0]))
    assert abs((found - [10.0, 20.0, 5.0]) @ direction) < 1e-9
    assert np.allclose(project(links, 0, origin - 30 * direction), origin)


def test_mended_ray_stays_between_the_heights(draw) -> None:
    drawn = draw(50, (1, 0, 0, 0), 42)
    for index in range(50):
        links = drawn.links.problem(index)
        found = project_within_heights(links, 0, np.array([0.0, 0, 20]), drawn.area)
        assert drawn.area.height_min_m <= found[2] <= drawn.area.height_max_m


def test_anchor_is_the_surest_link_with_angles(draw) -> None:
    links = draw(1, (1, 1, 1, 0), 43).links.problem(0)
    links.los_probability[:] = [0.6, 0.99, 0.9, 0.0]
    links.azimuth_rad[1] = np.nan
    assert los_anchor(links, MODEL) == 2


def test_literal_test_never_accepts(draw) -> None:
    """Defect of (76): with (68) on every link J is zero at the free solution, wherever that is."""
    drawn = draw(30, (1, 0, 0, 0), 44)
    mended = 0
    for index in range(30):
        links = drawn.links.problem(index)
        free = lsre_socp_iterative(links, drawn.area, MODEL, every_link=True)
        assert free.rss_cost_db2 < 1e-12
        literal = projection_label_aware_literal(links, 0, drawn.area, MODEL)
        assert (literal.position_enu_m == free.position_enu_m).all()
        ray = ray_direction(links, 0)
        place = projection_label_aware(links, 0, drawn.area, MODEL).position_enu_m - links.position_enu_m[0]
        mended += int(np.linalg.norm(place - (place @ ray) * ray) < 0.5)
    assert mended >= 22


def test_with_a_fixed_los_exponent_only_that_link_is_left_in_j(draw) -> None:
    """The other reading: β_LOS kept. J is one residual, and (70) decides whether it is large."""
    drawn = draw(20, (1, 0, 0, 0), 45)
    for index in range(20):
        links = drawn.links.problem(index)
        free = lsre_socp_iterative(links, drawn.area, MODEL)
        assert free.path_loss_exponent[0] == MODEL.los_exponent
        distance = np.linalg.norm(free.position_enu_m - links.position_enu_m, axis=1)
        expected = free.transmit_power_dbm - 10 * free.path_loss_exponent * np.log10(distance)
        residual = links.rss_dbm - expected
        # An exponent held at its floor is the only other way to a residual.
        refitted = free.path_loss_exponent[1:] > 0.1
        assert np.abs(residual[1:][refitted]).max() < 1e-9
        assert free.rss_cost_db2 >= residual[0] ** 2 - 1e-9


def test_refuses_a_bearing_that_the_powers_forbid() -> None:
    """A strong vehicle nearby says west; the 'LOS' bearing of a far one says east."""
    place = np.array([[-60.0, 0, 50], [80.0, 0, 50], [80.0, 40, 50], [80.0, -40, 50]])
    truth = np.array([-60.0, 5, 5])
    rss = 15.0 - 27.0 * np.log10(np.linalg.norm(place - truth, axis=1)) - 3.0
    nothing = np.full(4, np.nan)
    azimuth, elevation = nothing.copy(), nothing.copy()
    azimuth[1], elevation[1] = 0.2, -1.2
    model = SignalModel(nlos_rss_std_db=2.0, rss_std_db=2.0)
    from groundstation.localization import SearchArea

    area = SearchArea(np.zeros(2), 120.0, 0.0, 20.0)
    links = Links(place, rss, azimuth, elevation, np.array([0.1, 0.8, 0.1, 0.1]))
    estimate = locate(links, area, "projection-label-aware", model)
    assert "refused" in estimate.status
    assert estimate.position_enu_m[0] < 0
