from __future__ import annotations

import math

import numpy as np
import shapely

from groundstation.localization import SearchArea, SignalModel
from groundstation.tracking import Belief, TrackingSettings, containment
from groundstation.tracking.prior import LastKnown, prior_field

AREA = SearchArea(np.zeros(2), 200.0, 0.0, 20.0)


def mass_within(belief: Belief, east: float, north: float, radius: float) -> float:
    away = np.hypot(belief.mesh.center_enu_m[:, 0] - east, belief.mesh.center_enu_m[:, 1] - north)
    return float(belief.mass[away <= radius].sum())


def test_the_radius_holds_nine_in_ten_of_what_is_not_doubted() -> None:
    belief = Belief(AREA, SignalModel(), TrackingSettings())
    belief.set_field("prior", prior_field([LastKnown(60.0, -40.0, 50.0)], AREA, 0.2))
    # The doubted fifth lies evenly: a sixteenth of it is in the circle.
    expected = 0.8 * 0.9 + 0.2 * 50.0**2 / 200.0**2
    assert abs(mass_within(belief, 60.0, -40.0, 50.0) / expected - 1.0) < 0.03
    belief.set_field("prior", None)
    assert abs(mass_within(belief, 60.0, -40.0, 50.0) - 50.0**2 / 200.0**2) < 0.01


def test_several_places_stand_beside_each_other_and_rule_nothing_out() -> None:
    field = prior_field([LastKnown(100.0, 0.0, 30.0), LastKnown(-100.0, 0.0, 30.0)], AREA, 0.2)
    assert field is not None
    places = np.array([[100.0, 0.0, 5.0], [-100.0, 0.0, 5.0], [0.0, 150.0, 5.0], [0.0, 1e4, 5.0]])
    east, west, away, far = field(places, np.full((4, 2), 1.0))
    assert abs(east - west) < 1e-9
    assert east > 2.0
    assert abs(away - math.log(0.2)) < 1e-6
    assert abs(far - math.log(0.2)) < 1e-12


def test_without_places_there_is_nothing_to_know() -> None:
    assert prior_field([], AREA, 0.2) is None


def test_a_polygon_counts_by_its_own_size() -> None:
    square = SearchArea.of_polygon(shapely.box(-50, -50, 50, 50), 0.0, 20.0)
    belief = Belief(square, SignalModel(), TrackingSettings())
    belief.set_field("prior", prior_field([LastKnown(0.0, 0.0, 20.0)], square, 0.5))
    assert abs(mass_within(belief, 0.0, 0.0, 20.0) - (0.45 + 0.5 * math.pi * 0.04)) < 0.06
    said = containment(belief.mesh, belief.mass)
    assert np.hypot(*said.position_enu_m[:2]) < 2.0
