import math

import pytest

from groundstation.domain.geometry import Geodetic
from groundstation.domain.vehicle import Autopilot, PlaceAccuracy
from groundstation.mavlink.messages import (
    EkfStatus,
    GlobalPosition,
    GpsRaw,
    Heartbeat,
    HomePosition,
    PositionTarget,
    SysStatus,
)
from groundstation.measurement.vehicle_picture import VehiclePicture, is_vehicle

S = 1_000_000_000
HERE = Geodetic(47.0, 8.0, 550.0)


@pytest.mark.parametrize(
    ("heartbeat", "expected"),
    [
        (Heartbeat(2, 3, 129, 4, 4), True),
        (Heartbeat(2, 12, 129, 4, 4), True),
        (Heartbeat(2, 0, 0, 0, 0), True),
        (Heartbeat(6, 8, 0, 0, 4), False),
        (Heartbeat(18, 8, 0, 0, 4), False),
        (Heartbeat(6, 3, 0, 0, 4), False),
    ],
    ids=["ardupilot", "px4", "generic", "gcs", "companion", "gcs that claims an autopilot"],
)
def test_who_is_a_vehicle(heartbeat, expected):
    assert is_vehicle(heartbeat) is expected


def test_nothing_heard_is_nothing_claimed():
    state = VehiclePicture(3).snapshot(S, None, None)
    assert (state.mode, state.armed, state.ready, state.lost) == ("unknown", False, False, False)
    assert (state.autopilot, state.connections) == (Autopilot.UNKNOWN, ())
    assert (
        state.position
        is state.home
        is state.attitude
        is state.battery_percent
        is state.position_target
        is None
    )


@pytest.mark.parametrize(
    ("flags", "healthy", "ready"),
    [
        (0x210, True, True),
        (0x33F, True, True),
        (0x010, True, False),
        (0x200, True, False),
        (0x210, False, False),
    ],
)
def test_readiness(flags, healthy, ready):
    picture = VehiclePicture(1)
    picture.ekf_status(EkfStatus(flags))
    assert not picture.ready
    picture.sys_status(SysStatus(12.0, 50.0, healthy))
    assert picture.ready is ready


@pytest.mark.parametrize(
    ("frame", "home", "expected_m"),
    [(0, None, 40.0), (5, None, 40.0), (6, None, 540.0), (3, 510.0, 550.0), (11, 510.0, None)],
)
def test_a_target_s_altitude_is_brought_to_sea_level(frame, home, expected_m):
    picture = VehiclePicture(1)
    picture.global_position(GlobalPosition(1, HERE, 50.0, (0.0, 0.0, 0.0)), S)
    if home is not None:
        picture.home_position(HomePosition(Geodetic(47.0, 8.0, home)))
    picture.position_target(PositionTarget(1, Geodetic(47.1, 8.1, 40.0), frame))
    target = picture.snapshot(S, None, 0).position_target
    assert (None if target is None else target.altitude_amsl_m) == expected_m


def test_a_home_without_a_fix_is_not_taken():
    picture = VehiclePicture(1)
    picture.home_position(HomePosition(Geodetic(0.0, 0.0, 0.0)))
    assert picture.home is None


def test_what_is_missing_is_said_in_words():
    picture = VehiclePicture(1)
    assert "GPS_RAW_INT" in picture.missing()
    picture.gps_raw(GpsRaw(1, 4, None, None))
    assert "no fix (type 1, 4 satellites)" in picture.missing()
    picture.gps_raw(GpsRaw(3, 9, None, None))
    assert "estimate is not valid" in picture.missing()
    picture.ekf_status(EkfStatus(0x210))
    assert "GLOBAL_POSITION_INT" in picture.missing()


def test_how_well_it_knows_its_place_as_long_as_it_has_a_fix():
    picture = VehiclePicture(1)
    picture.gps_raw(GpsRaw(3, 9, 1.5, None))
    assert picture.snapshot(S, None, 0).place_accuracy == PlaceAccuracy(1.5, None, False)
    picture.gps_raw(GpsRaw(6, 14, 0.02, 0.03))
    assert picture.snapshot(S, None, 0).place_accuracy == PlaceAccuracy(0.02, 0.03, True)
    for lost in (GpsRaw(1, 3, 4000.0, 4000.0), GpsRaw(3, 9, None, 2.0)):
        picture.gps_raw(lost)
        assert picture.snapshot(S, None, 0).place_accuracy is None


def test_without_corrections_nobody_is_surer_of_a_place_than_assumed():
    """Told as root mean square of both axes: each is a √2-th of it."""
    assumed = (1.0, 2.0)
    assert PlaceAccuracy(0.4, 0.5, False).std_m(assumed) == assumed
    assert PlaceAccuracy(6.0, 9.0, False).std_m(assumed) == pytest.approx((6.0 / math.sqrt(2.0), 9.0))
    assert PlaceAccuracy(0.02, 0.03, True).std_m(assumed) == pytest.approx((0.02 / math.sqrt(2.0), 0.03))
    assert PlaceAccuracy(8.0, None, False).std_m(assumed) == pytest.approx((8.0 / math.sqrt(2.0), 2.0))
    assert PlaceAccuracy(0.02, None, True).std_m(assumed)[1] == 2.0


def test_kept_before_places_had_an_accuracy():
    tree = VehiclePicture(1).state()
    del tree["place_accuracy"]
    picture = VehiclePicture(1)
    picture.restore(tree)
    assert picture.place_accuracy is None


def test_connections_newest_first_and_the_old_ones_go():
    picture = VehiclePicture(1)
    picture.connections = {"a": 1 * S, "b": 50 * S, "c": 90 * S}
    assert picture.snapshot(100 * S, None, 0).connections == ("c", "b")
    assert picture.snapshot(900 * S, None, 0).connections == ("c",)
    picture.connections = {f"tcp{i}": i * S for i in range(100)}
    picture.snapshot(100 * S, None, 0)
    assert len(picture.connections) == 16


def test_state_and_restore():
    one, two = VehiclePicture(1), VehiclePicture(1)
    one.heartbeat(Heartbeat(2, 3, 129, 4, 4), S)
    one.global_position(GlobalPosition(1, HERE, 50.0, (1.0, 2.0, 3.0)), S)
    one.home_position(HomePosition(HERE))
    one.position_target(PositionTarget(1, HERE, 6))
    one.attitude = (1.0, 0.0, 0.0, 0.0)
    one.connections["udp"] = S
    one.gps_raw(GpsRaw(6, 14, 0.02, 0.03))
    two.restore(one.state())
    assert two.snapshot(S, 1.5, 0) == one.snapshot(S, 1.5, 0)
