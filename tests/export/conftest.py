"""Beliefs that every encoder's test needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from groundstation.domain.geometry import Geodetic
from groundstation.domain.target import Environment, SnapshotEstimate, TargetState

TIME_NS = 1_795_311_900_250_000_000
"""2026-11-22T01:45:00.250Z."""


@pytest.fixture
def belief() -> Callable[..., TargetState]:
    """Makes a belief; keyword arguments replace its fields."""
    place = Geodetic(-35.36251234567, 149.16541234567, 584.256)
    snapshot = SnapshotEstimate(
        time_ns=TIME_NS,
        position=place,
        covariance_enu_m2=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0),
        environment=Environment.MIXED,
        method="lsre-ccp",
        transmit_power_dbm=14.123456,
        path_loss_exponent=(2.0, 2.71234),
        vehicle_ids=(1, 2),
        los_vehicle_ids=(1,),
        status="ok",
    )
    state = TargetState(
        beacon_id=2**64 - 1,
        time_ns=TIME_NS,
        first_heard_ns=TIME_NS - 10**10,
        last_heard_ns=TIME_NS - 10**9,
        position=place,
        covariance_enu_m2=(9.123456, 1.0, 0.5, 16.0, 0.25, 4.0),
        radius_90_m=8.456,
        environment=Environment.MIXED,
        los_links=2,
        links=4,
        windows=12,
        method="posterior <&>",
        height_reference="home",
        sequence=3,
        snapshot=snapshot,
    )
    return lambda **changes: replace(state, **changes)


@pytest.fixture
def ring() -> Callable[[float, float, float], tuple[tuple[float, float], ...]]:
    """Makes a closed square ring: (latitude, longitude) of its middle, half its width in degrees."""

    def make(latitude: float, longitude: float, half: float) -> tuple[tuple[float, float], ...]:
        corners = [(-half, -half), (-half, half), (half, half), (half, -half), (-half, -half)]
        return tuple((latitude + north, longitude + east) for north, east in corners)

    return make
