"""The sensor's messages mean what the interface says, on its own clock."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from groundstation.mavlink.decode import decode
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.framing import frame_of
from groundstation.mavlink.messages import AoaSample, CirFragment, LinkStateReport, RssSample
from sim_sitl.radio_sensor import SensorSettings


def sensor_messages(talker: Any, seconds: float, kind: type) -> list[Any]:
    """Decoded by the station's own decoder."""
    talker._time_s += seconds
    frames = [frame_of(raw) for raw in talker.simulation.step(talker._time_s)[1]]
    messages = [decode(frame) for frame in frames if frame.component_id == 191]
    return [message for message in messages if isinstance(message, kind)]


def request(
    beacon_id: int, captures: int, interval_ms: int, first: int = 0, count: int = 0, encoding: int = 0
) -> Any:
    return dialect.MAVLink_sar_cir_request_message(
        1, 191, beacon_id, first, count, encoding, captures, interval_ms
    )


def test_each_beacon_is_heard_at_its_interval_with_its_own_sequence(airborne: Any) -> None:
    samples = sensor_messages(airborne, 20.0, RssSample)
    for beacon in airborne.simulation.beacons:
        mine = [s for s in samples if s.beacon_id == beacon.beacon_id]
        assert len(mine) in (39, 40, 41)
        assert [s.sequence for s in mine] == list(range(mine[0].sequence, mine[0].sequence + len(mine)))
        assert {s.frequency_hz for s in mine} == {867_500_000}
        steps = np.diff([s.time_usec for s in mine]) * 1e-6
        assert np.all(np.abs(steps - beacon.packet_interval_s) < 0.06)


def test_lost_packets_send_nothing_and_leave_a_gap_in_the_sequence(
    talk: Callable[..., Any], field: Any
) -> None:
    # About half of the packets fade below this.
    weak = replace(
        field,
        propagation=replace(
            field.propagation, los_rician_k_db=-30.0, fading_averages=1, los_shadowing_db=0.0
        ),
        receiver=replace(field.receiver, sensitivity_dbm=-68.0),
    )
    talker = talk(weak)
    samples = sensor_messages(talker, 60.0, RssSample)
    first = [s.sequence for s in samples if s.beacon_id == 7001]
    lost = talker.simulation.sensors[1].lost_below_sensitivity[0]
    assert 10 < len(first) < 110
    assert first == sorted(set(first))
    assert lost + len(first) in (119, 120, 121)
    assert first != list(range(first[0], first[0] + len(first)))


def test_the_sensors_clock_is_its_own_and_drifts(talk: Callable[..., Any]) -> None:
    talker = talk(sensor=SensorSettings(cir_every=0, clock_skew=1e-3))
    sensor = talker.simulation.sensors[1]
    rate = (sensor.clock_ns(100.0) - sensor.clock_ns(0.0)) / 100e9
    assert rate != 1.0
    assert rate == pytest.approx(1.0, abs=5e-3)
    samples = sensor_messages(talker, 3.0, RssSample)
    assert all(20e6 < s.time_usec < 310e6 for s in samples), "since its boot, not since 1970"
    boot = talker.simulation.vehicles[1].since_boot_s
    assert abs(sensor.clock_ns(3.0) * 1e-9 - boot) > 0.1


@pytest.mark.parametrize("angles", ["body", "earth"])
def test_angles_point_at_the_beacon_in_their_frame(talk: Callable[..., Any], quiet: Any, angles: str) -> None:
    talker = talk(quiet, sensor=SensorSettings(cir_every=0, angles=angles))
    talker.run(5.0)
    vehicle = talker.simulation.vehicles[1]
    checked = 0
    for _ in range(200):
        for aoa in sensor_messages(talker, 0.02, AoaSample):
            assert aoa.body_frame == (angles == "body")
            spec = next(b for b in talker.simulation.beacons if b.beacon_id == aoa.beacon_id)
            bearing = np.array(
                [
                    math.cos(aoa.elevation_rad) * math.cos(aoa.azimuth_rad),
                    math.cos(aoa.elevation_rad) * math.sin(aoa.azimuth_rad),
                    -math.sin(aoa.elevation_rad),
                ]
            )
            if angles == "body":
                bearing = _rotation(vehicle.flight) @ bearing
            east, north, up = np.subtract(spec.position_enu_m, vehicle.flight.position_enu_m)
            truth = np.array([north, east, -up]) / math.hypot(east, north, up)
            assert bearing == pytest.approx(truth, abs=0.006), "0.2 m of flight and some attitude between"
            checked += 1
    assert checked > 10
    assert abs(vehicle.flight.pitch_rad) > 0.05, "the airframe leans, or this shows nothing"


def _rotation(flight: Any) -> Any:
    """Body to NED from roll, pitch, yaw, written out."""
    r, p, y = flight.roll_rad, flight.pitch_rad, flight.yaw_rad
    rx = np.array([[1, 0, 0], [0, math.cos(r), -math.sin(r)], [0, math.sin(r), math.cos(r)]])
    ry = np.array([[math.cos(p), 0, math.sin(p)], [0, 1, 0], [-math.sin(p), 0, math.cos(p)]])
    rz = np.array([[math.cos(y), -math.sin(y), 0], [math.sin(y), math.cos(y), 0], [0, 0, 1]])
    return rz @ ry @ rx


def test_no_cir_unless_configured_or_asked(airborne: Any) -> None:
    assert sensor_messages(airborne, 5.0, CirFragment) == []
    airborne.send(request(7001, captures=3, interval_ms=1000))
    fragments = sensor_messages(airborne, 8.0, CirFragment)
    assert [f.beacon_id for f in fragments] == [7001] * 3
    assert all(f.tap_count == 64 and f.fragment_count == 1 and len(f.data) == 64 for f in fragments)
    assert all(f.first_path_index == pytest.approx(8.0, abs=2.5) for f in fragments)
    steps = np.diff([f.time_usec for f in fragments]) * 1e-6
    assert np.all(steps > 0.97)
    assert len({f.capture_id for f in fragments}) == 3


def test_a_request_for_the_whole_response_comes_in_fragments_until_stopped(airborne: Any) -> None:
    airborne.send(request(0, captures=0, interval_ms=100, first=0, count=1016))
    fragments = sensor_messages(airborne, 2.0, CirFragment)
    assert {f.beacon_id for f in fragments} == {b.beacon_id for b in airborne.simulation.beacons}
    captures: dict[tuple[int, int], bytes] = {}
    for f in fragments:
        assert (f.tap_count, f.fragment_count) == (1016, 5)
        captures[f.beacon_id, f.capture_id] = captures.get((f.beacon_id, f.capture_id), b"") + f.data
    assert {len(data) for data in captures.values()} == {1016}
    airborne.send(request(0, captures=0, interval_ms=0))
    sensor_messages(airborne, 0.1, CirFragment)
    assert sensor_messages(airborne, 3.0, CirFragment) == []


def test_unasked_captures_come_with_each_nth_packet_and_evolve(talk: Callable[..., Any]) -> None:
    talker = talk(sensor=SensorSettings(cir_every=4))
    fragments = [f for f in sensor_messages(talker, 20.0, CirFragment) if f.beacon_id == 7001]
    assert len(fragments) in (9, 10, 11)
    assert len({f.data for f in fragments}) == len(fragments)


def test_tunnel_carries_the_same_messages(talk: Callable[..., Any], frames_by_id: Callable[..., Any]) -> None:
    plain = sensor_messages(talk(sensor=SensorSettings(cir_every=1)), 3.0, RssSample | CirFragment)  # type: ignore[arg-type]
    talker = talk(sensor=SensorSettings(cir_every=1, tunnel=True))
    wrapped = sensor_messages(talker, 3.0, RssSample | CirFragment)  # type: ignore[arg-type]
    assert wrapped == plain
    counts = frames_by_id(talker.simulation.step(5.0)[1])
    assert 385 in counts
    assert not {20800, 20801, 20802} & set(counts)


def test_link_state_leans_to_the_truth(talk: Callable[..., Any]) -> None:
    talker = talk(sensor=SensorSettings(cir_every=0, link_state=True))
    reports = sensor_messages(talker, 20.0, LinkStateReport)
    clear = [r.los_probability for r in reports if r.beacon_id == 7001]
    assert len(clear) > 30
    assert np.mean(clear) == pytest.approx(0.8, abs=0.1)


def test_heartbeats_once_a_second_as_an_onboard_controller(airborne: Any) -> None:
    beats = [m for m in airborne.run(10.0) if m.get_type() == "HEARTBEAT" and m.get_srcComponent() == 191]
    assert len(beats) == 10
    assert {(m.type, m.autopilot) for m in beats} == {(18, 8)}
