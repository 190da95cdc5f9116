"""The deterministic core: same inputs, same bytes; parts are independent of each other."""

from __future__ import annotations

from typing import Any

import pytest

from groundstation.domain.errors import UsageError
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from sim_sitl.scenario_file import load_scenario
from sim_sitl.simulation import Simulation


def fly(seed: int = 1, slices: int = 1, vehicles: int = 3, beacons: int | None = None) -> dict[int, bytes]:
    simulation = Simulation(load_scenario("city-block"), vehicles, beacons, seed)
    station = Encoder(255, 190)
    sent: dict[int, bytes] = dict.fromkeys(simulation.vehicles, b"")

    def step_to(end_s: float, start_s: float) -> None:
        for i in range(1, slices + 1):
            for vehicle, frames in simulation.step(start_s + (end_s - start_s) * i / slices).items():
                sent[vehicle] += b"".join(frames)

    step_to(2.0, 0.0)
    for vehicle in simulation.vehicles:
        for message_id in (30, 33):
            command = dialect.MAVLink_command_long_message(
                vehicle, 1, 511, 0, message_id, 200_000, 0, 0, 0, 0, 0
            )
            simulation.receive(vehicle, station.pack(command))
    step_to(6.0, 2.0)
    return sent


def test_the_same_inputs_give_the_same_bytes_however_the_time_is_sliced() -> None:
    assert fly() == fly(slices=7)


def test_another_seed_is_another_run() -> None:
    assert fly(seed=1) != fly(seed=2)


def test_more_vehicles_leave_the_levels_of_the_first_as_they_were() -> None:
    def field_of(vehicles: int) -> list[float]:
        simulation = Simulation(load_scenario("open-field"), vehicles, None, 1)
        channel: Any = simulation.sensors[1]._channels[0]
        return [channel._field.at((x, 0.0, 50.0)) for x in (0.0, 10.0, 100.0)]

    assert field_of(1) == field_of(5)


def test_beacons_are_the_first_of_the_scenario_then_drawn_in_its_area() -> None:
    scenario = load_scenario("rubble")
    assert Simulation(scenario, 1, 2, 1).beacons == scenario.beacons[:2]
    many = Simulation(scenario, 1, 8, 1).beacons
    assert many[:3] == scenario.beacons
    assert len({b.beacon_id for b in many}) == 8
    assert all(scenario.area.contains(b.position_enu_m[0], b.position_enu_m[1]) for b in many)
    assert many == Simulation(scenario, 4, 8, 1).beacons


def test_truth_names_every_beacon_with_place_and_power() -> None:
    simulation = Simulation(load_scenario("open-field"), 1, None, 1)
    truth = simulation.truth()["beacons"]
    assert [b["id"] for b in truth] == ["7001", "7002", "9007199254740993"]
    first = truth[0]
    east, north, up = simulation.scenario.frame.to_enu(
        simulation.scenario.frame.to_geodetic(simulation.beacons[0].position_enu_m)
    )
    assert (east, north, up) == pytest.approx(simulation.beacons[0].position_enu_m, abs=1e-6)
    assert first["alt_amsl_m"] == pytest.approx(586.0, abs=0.01)
    assert first["transmit_power_dbm"] == 15.2


def test_vehicles_start_apart_on_the_ring() -> None:
    simulation = Simulation(load_scenario("open-field"), 6, None, 1)
    places = [v.flight.position_enu_m for v in simulation.vehicles.values()]
    assert len({(round(e), round(n)) for e, n, _ in places}) == 6


def test_too_many_vehicles_are_refused() -> None:
    with pytest.raises(UsageError, match="1 to 200"):
        Simulation(load_scenario("open-field"), 0, None, 1)


def test_garbage_from_outside_is_counted_not_raised() -> None:
    simulation = Simulation(load_scenario("open-field"), 1, None, 1)
    frame = bytearray(Encoder(255, 190).pack(dialect.MAVLink_timesync_message(0, 5)))
    frame[12] ^= 0xFF
    simulation.receive(1, bytes(frame))
    assert simulation.rejected_frames == 1


def test_describe_says_what_flies_and_which_links_are_clear() -> None:
    simulation = Simulation(load_scenario("rubble"), 2, None, 1)
    assert simulation.describe() == "t 0 s: 1 GUIDED 50 m ??? | 2 GUIDED 50 m ???"
    simulation.step(3.0)
    line = simulation.describe()
    assert line.startswith("t 3 s: 1 GUIDED 50 m n")
    assert "?" not in line
