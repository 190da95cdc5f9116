"""One vehicle's part of who listened where; the way there from frames is in test_listening."""

from __future__ import annotations

from dataclasses import replace

import pytest

from groundstation.domain.geometry import Geodetic
from groundstation.domain.radio import Listener
from groundstation.engine.vehicle_listening import VehicleListening
from groundstation.mavlink.messages import AoaSample, RssSample
from groundstation.measurement.pose_history import PoseHistory
from groundstation.measurement.settings import MeasurementSettings

SECOND = 1_000_000_000
SETTINGS = MeasurementSettings()
LEVEL = RssSample(0, 7, 868_000_000, -90.0, -110.0, 0)
ANGLE = AoaSample(0, 7, 0.1, 0.2, 0.01, 0.01, False)


def poses(settings: MeasurementSettings = SETTINGS) -> PoseHistory:
    made = PoseHistory(settings)
    for second in range(11):
        made.add_position(second * SECOND, 47.0, 8.0, 500.0 + second)
        made.add_attitude(second * SECOND, (1.0, 0.0, 0.0, 0.0))
    return made


def taken(listening: VehicleListening, heard_ns: int | None = 6 * SECOND, offset_ns: int | None = 0):
    return listening.take(4 * SECOND, 6 * SECOND, heard_ns, offset_ns, poses())


def test_levels_count_angles_only_say_that_it_was_heard_and_an_interval_starts_anew() -> None:
    listening = VehicleListening(SETTINGS, 3)
    for beacon_id, message in ((9, LEVEL), (7, ANGLE), (9, LEVEL), (9, ANGLE)):
        listening.heard(beacon_id, message)
    place = Geodetic(47.0, 8.0, 505.0)
    assert taken(listening) == Listener(3, place, ((7, 0), (9, 2)))
    assert taken(listening) == Listener(3, place, ())


@pytest.mark.parametrize(("heard_ns", "offset_ns"), [(None, 0), (6 * SECOND, None), (2 * SECOND, 0)])
def test_an_unknown_place_or_a_sensor_that_was_silent_is_not_known(
    heard_ns: int | None, offset_ns: int | None
) -> None:
    listening = VehicleListening(SETTINGS, 3)
    listening.heard(7, LEVEL)
    assert taken(listening, heard_ns, offset_ns) is None
    assert taken(listening) == Listener(3, Geodetic(47.0, 8.0, 505.0), ())


def test_it_counts_as_many_beacons_as_a_vehicle_may_have_links() -> None:
    listening = VehicleListening(replace(SETTINGS, links_per_vehicle=2), 3)
    for beacon_id in (1, 2, 3, 2):
        listening.heard(beacon_id, LEVEL)
    listener = taken(listening)
    assert listener is not None
    assert listener.packets == ((1, 1), (2, 2))
