"""Levels against the equations, the shadowing field's statistics, angles."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sim_sitl.propagation import LinkChannel, ShadowingField
from sim_sitl.randomness import Stream, generator
from sim_sitl.scenario import BeaconSpec, PropagationSpec, ReceiverSpec
from sim_sitl.world import Obstruction, World

BEACON = BeaconSpec(7, (0.0, 0.0, 0.0), 15.0, 1.0, 867_500_000, 0.0)
BURIED = replace(BEACON, buried_depth_m=3.0)


def link(
    propagation: PropagationSpec,
    receiver: ReceiverSpec | None = None,
    beacon: BeaconSpec = BEACON,
    *,
    seed: int = 1,
    vehicle: int = 1,
) -> LinkChannel:
    return LinkChannel(
        propagation, receiver or ReceiverSpec(), beacon, seed=seed, vehicle_id=vehicle, beacon_key=0
    )


def clear(distance_m: float) -> Obstruction:
    return Obstruction(distance_m, 0.0, 0.0, False, ())


def blocked(distance_m: float, length_m: float = 5.0, loss_db: float = 9.0) -> Obstruction:
    return Obstruction(distance_m, length_m, loss_db, False, ("wall",))


def test_shadowing_is_a_unit_gaussian_field_that_decorrelates_over_its_distance() -> None:
    fields = [ShadowingField(generator(3, Stream.SHADOWING, i), 25.0) for i in range(800)]
    place = np.array(
        [[f.at((10.0, -20.0, 50.0)), f.at((35.0, -20.0, 50.0)), f.at((10.0, 80.0, 50.0))] for f in fields]
    )
    assert np.std(place[:, 0]) == pytest.approx(1.0, abs=0.08)
    assert np.mean(place[:, 0]) == pytest.approx(0.0, abs=0.11)
    correlation = np.corrcoef(place, rowvar=False)
    assert correlation[0, 1] == pytest.approx(math.exp(-1), abs=0.1), "25 m apart"
    assert correlation[0, 2] == pytest.approx(math.exp(-4), abs=0.1), "100 m apart"
    kurtosis = np.mean(place[:, 0] ** 4) / np.mean(place[:, 0] ** 2) ** 2
    assert kurtosis == pytest.approx(3.0, abs=0.7)


def test_shadowing_correlation_along_one_long_flight() -> None:
    values = []
    for i in range(12):
        field = ShadowingField(generator(9, Stream.SHADOWING, i), 25.0)
        values.append([field.at((5.0 * step, 0.0, 50.0)) for step in range(400)])
    series = np.array(values)
    lag = np.mean(series[:, :-5] * series[:, 5:]) / np.mean(series**2)
    assert lag == pytest.approx(math.exp(-1), abs=0.1)


def test_each_vehicle_has_its_own_field_and_the_same_seed_the_same() -> None:
    spec = PropagationSpec()
    draws = [link(spec, vehicle=v).receive((50, 50, 50), clear(86.6)).rss_dbm for v in (1, 2, 1)]
    assert draws[0] == draws[2]
    assert draws[0] != draws[1]


def test_line_of_sight_follows_equation_7(quiet: Any) -> None:
    channel = link(quiet.propagation, quiet.receiver)
    for distance in (10.0, 50.0, 200.0):
        reception = channel.receive((distance, 0, 0), clear(distance))
        assert reception.rss_dbm == pytest.approx(15.0 - 25.0 * math.log10(distance), abs=0.1)


def test_obstructed_follows_equation_8_with_a_bias_that_saturates(quiet: Any) -> None:
    spec = replace(quiet.propagation, nlos_exponent=(3.0, 3.0))
    channel = link(spec, quiet.receiver)
    free = spec.reference_loss_db + 30.0 * 2
    assert channel.median_loss_db(blocked(100.0, loss_db=1e9)) == pytest.approx(free + 7.0)
    bias = channel.median_loss_db(blocked(100.0, loss_db=3.0)) - free
    assert bias == pytest.approx(7.0 * (1 - math.exp(-3 / 7)))


def test_rubble_follows_equations_9_to_11(quiet: Any) -> None:
    spec = replace(
        quiet.propagation, nlos_model="rubble", rubble_exponent=(3.0, 3.0), rubble_excess_db=(10.0, 10.0)
    )
    channel = link(spec, quiet.receiver, BURIED)
    loss = channel.median_loss_db(blocked(104.0, length_m=4.0))
    friis = 20 * math.log10(100.0) + 20 * math.log10(867.5) - 27.55
    assert loss == pytest.approx(friis + 31.5 + 10.0 + 30 * math.log10(4.0))
    # Lengths are held to 1–20 m.
    assert channel.median_loss_db(blocked(120.0, length_m=90.0)) == pytest.approx(
        friis + 31.5 + 10.0 + 30 * math.log10(20.0)
    )


def test_every_vehicle_sees_the_same_rubble_on_a_beacon() -> None:
    spec = PropagationSpec(nlos_model="rubble")
    losses = {link(spec, vehicle=v).median_loss_db(blocked(100.0)) for v in range(1, 5)}
    assert len(losses) == 1
    assert link(spec, seed=2).median_loss_db(blocked(100.0)) not in losses


def test_a_packet_below_the_sensitivity_is_not_heard(quiet: Any) -> None:
    deaf = replace(quiet.receiver, sensitivity_dbm=-60.0)
    channel = link(quiet.propagation, deaf)
    assert channel.receive((5, 0, 0), clear(5.0)).heard
    assert not channel.receive((100, 0, 0), clear(100.0)).heard


def test_line_of_sight_angles_are_the_truth_with_noise_and_a_constant_bias() -> None:
    receiver = ReceiverSpec(angle_noise_deg=1.0, angle_bias_deg=0.5)
    channel = link(PropagationSpec(), receiver)
    vehicle = (60.0, -80.0, 50.0)
    truth = math.atan2(80.0, -60.0), math.atan2(-50.0, 100.0)
    obstruction = World(()).obstruction(BEACON, vehicle)
    errors = np.degrees(
        [
            [r.azimuth_rad - truth[0], r.elevation_rad - truth[1]]
            for r in (channel.receive(vehicle, obstruction) for _ in range(2000))
        ]
    )
    assert np.std(errors, axis=0) == pytest.approx([1.0, 1.0], abs=0.06)
    bias = np.mean(errors, axis=0)
    other = np.degrees(channel.receive(vehicle, obstruction).angle_std_rad)
    assert other == pytest.approx(1.0)
    assert 0.05 < np.max(np.abs(bias)) < 2.0


def test_obstructed_angles_are_a_reflectors_wrong_and_alike_in_one_place() -> None:
    channel = link(PropagationSpec())
    here = np.array([channel.receive((60, 60, 50), blocked(98.0)).azimuth_rad for _ in range(200)])
    assert abs(np.mean(np.exp(1j * here))) > 0.98
    places = [(30.0 * i + 5, 30.0 * j + 5, 50.0) for i in range(-8, 8) for j in range(-8, 8)]
    errors = []
    for place in places:
        truth = math.atan2(-place[1], -place[0])
        errors.append(channel.receive(place, blocked(100.0)).azimuth_rad - truth)
    assert abs(np.mean(np.exp(1j * np.array(errors)))) < 0.15, "uniform: no information"


def test_antenna_pattern_weakens_what_is_off_its_beam(quiet: Any) -> None:
    receiver = replace(quiet.receiver, antenna_beamwidth_deg=45.0, antenna_downtilt_deg=30.0)
    channel, isotropic = link(quiet.propagation, receiver), link(quiet.propagation, quiet.receiver)
    below, ahead = (0.0, 0.0, 100.0), (86.6, 0.0, 50.0)
    loss = [
        isotropic.receive(p, clear(100.0)).rss_dbm - channel.receive(p, clear(100.0)).rss_dbm
        for p in (below, ahead)
    ]
    assert loss[0] == pytest.approx(20.0, abs=0.2)
    assert loss[1] == pytest.approx(0.0, abs=0.2)
