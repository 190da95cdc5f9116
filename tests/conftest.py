"""Builders: a mission with a fence of 400 m square round home, and vehicles that fly in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from groundstation.domain.geometry import Enu, Geodetic, LocalFrame
from groundstation.domain.mission import Area, Mission
from groundstation.domain.vehicle import Autopilot, VehicleState
from groundstation.safety.gate import Airspace

HOME = Geodetic(-35.3625, 149.1654, 584.0)
FRAME = LocalFrame(HOME)
NOW_NS = 1_800_000_000_000_000_000


def make_ring(corners: list[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    places = [FRAME.to_geodetic((east, north, 0.0)) for east, north in [*corners, corners[0]]]
    return tuple((place.latitude_deg, place.longitude_deg) for place in places)


def make_square(half_m: float) -> tuple[tuple[float, float], ...]:
    return make_ring([(-half_m, -half_m), (half_m, -half_m), (half_m, half_m), (-half_m, half_m)])


@pytest.fixture
def frame() -> LocalFrame:
    return FRAME


@pytest.fixture
def now_ns() -> int:
    return NOW_NS


@pytest.fixture
def ring() -> Callable[[list[tuple[float, float]]], tuple[tuple[float, float], ...]]:
    return make_ring


@pytest.fixture
def mission() -> Mission:
    return Mission(revision=3, origin=HOME, fence=Area(((make_square(200.0),),), "fence"))


@pytest.fixture
def vehicle() -> Callable[..., VehicleState]:
    def build(vehicle_id: int, place: Enu, **changes: object) -> VehicleState:
        # ENU up is height above home near home; altitude is set from it exactly.
        horizontal = FRAME.to_geodetic(place)
        position = replace(horizontal, altitude_amsl_m=HOME.altitude_amsl_m + place[2])
        state = VehicleState(
            vehicle_id=vehicle_id,
            time_ns=NOW_NS,
            connections=("udpin:0.0.0.0:14550",),
            autopilot=Autopilot.ARDUPILOT,
            mode="GUIDED",
            armed=True,
            ready=True,
            lost=False,
            last_heartbeat_ns=NOW_NS,
            position=position,
            position_time_ns=NOW_NS,
            height_above_home_m=place[2],
            home=HOME,
            attitude=(1.0, 0.0, 0.0, 0.0),
            velocity_ned_m_s=(0.0, 0.0, 0.0),
            battery_percent=80.0,
            battery_voltage_v=12.0,
            gps_fix_type=3,
            satellites=10,
            position_target=None,
            sensor_heard_ns=NOW_NS,
            packet_loss_percent=0.0,
            clock_offset_known=True,
        )
        return replace(state, **changes)  # type: ignore[arg-type]

    return build


@pytest.fixture
def place() -> Callable[[float, float, float], Geodetic]:
    def build(east_m: float, north_m: float, height_m: float) -> Geodetic:
        horizontal = FRAME.to_geodetic((east_m, north_m, height_m))
        return replace(horizontal, altitude_amsl_m=HOME.altitude_amsl_m + height_m)

    return build


@pytest.fixture
def airspace(mission: Mission) -> Callable[..., Airspace]:
    def build(*vehicles: VehicleState, **changes: object) -> Airspace:
        base = Airspace(NOW_NS, mission, {v.vehicle_id: v for v in vehicles}, {})
        return replace(base, **changes)  # type: ignore[arg-type]

    return build
