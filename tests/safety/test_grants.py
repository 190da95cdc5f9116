"""Grants die by themselves, by a hold, and with the process; they cover one place only."""

from __future__ import annotations

import math

import pytest

from groundstation.domain.geometry import Geodetic
from groundstation.safety.grants import Grants
from groundstation.safety.settings import SafetySettings

TARGET = Geodetic(-35.3625, 149.1654, 634.0)
SECOND = 10**9


@pytest.fixture
def grants():
    grants = Grants(SafetySettings(grant_lifetime_s=6.0))
    grants.issue("c1", 1, 192, TARGET, 100 * SECOND)
    return grants


def test_a_grant_covers_its_vehicle_command_and_target_only(grants):
    now = 101 * SECOND
    assert grants.match(1, 192, TARGET, now) is not None
    assert grants.match(2, 192, TARGET, now) is None
    assert grants.match(1, 22, TARGET, now) is None


@pytest.mark.parametrize(
    ("target", "covered"),
    [
        (Geodetic(-35.36250005, 149.16540005, 634.0), True),
        (Geodetic(-35.36251, 149.1654, 634.0), False),
        (Geodetic(-35.3625, 149.16541, 634.0), False),
        (Geodetic(-35.3625, 149.1654, 634.1), True),
        (Geodetic(-35.3625, 149.1654, 635.0), False),
        (Geodetic(math.nan, 149.1654, 634.0), False),
        (Geodetic(-35.3625, 149.1654, math.nan), False),
    ],
)
def test_the_target_is_compared_to_the_wires_rounding(grants, target, covered):
    assert (grants.match(1, 192, target, 101 * SECOND) is not None) is covered


def test_it_expires(grants):
    assert grants.match(1, 192, TARGET, 106 * SECOND) is not None
    assert grants.match(1, 192, TARGET, 106 * SECOND + 1) is None


def test_a_hold_revokes_at_once_and_leaves_a_shadow(grants):
    now = 101 * SECOND
    assert grants.hold(1, now).grant_id == "c1"
    assert grants.match(1, 192, TARGET, now) is None
    assert grants.hold(1, now) is None
    assert grants.in_hold_shadow(1, now + 5 * SECOND)
    assert not grants.in_hold_shadow(1, now + 5 * SECOND + 1)
    assert not grants.in_hold_shadow(2, now)
    assert (grants.issued_total, grants.revoked_total) == (1, 1)


def test_a_newer_grant_takes_the_place_of_the_older(grants):
    other = Geodetic(-35.36, 149.16, 640.0)
    grants.issue("c2", 1, 192, other, 101 * SECOND)
    assert grants.match(1, 192, TARGET, 101 * SECOND) is None
    assert grants.match(1, 192, other, 101 * SECOND).grant_id == "c2"


def test_nothing_survives_forgetting(grants):
    grants.forget_all()
    assert grants.live(1, 101 * SECOND) is None
