"""What is asked of vehicles: until it comes, ever more seldom, within the radio's budget."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from groundstation.command.settings import TelemetrySettings
from groundstation.command.telemetry import TelemetryDesk
from groundstation.domain.inputs import Direction, FrameInput, Record, SessionInput, TickInput
from groundstation.domain.radio import LinkActivity
from groundstation.domain.target import Environment, TargetState
from groundstation.mavlink import encode
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.framing import Framer
from groundstation.mavlink.messages import Timesync
from groundstation.mavlink.vehicle_message import VehicleMessage
from groundstation.safety.grants import Grants
from groundstation.safety.guard import Guard, Source

SECOND = 10**9
GLOBAL_POSITION, POSITION_TARGET, HOME = 33, 87, 242


class Bench:
    def __init__(self, now_ns, settings=None):
        self.desk = TelemetryDesk(settings)
        self.now_ns = now_ns
        self.start_ns = now_ns
        self.targets = ()
        self.sent = []
        self.parser = dialect.MAVLink(None)
        self.guard = Guard(Grants())
        self.framer = Framer()

    def feed(self, value, *ingested):
        record = Record(0, self.now_ns, self.now_ns // 1000, value)
        out = []
        for send in self.desk.handle(record, ingested, self.targets):
            (frame,) = self.framer.feed(send.frame)
            assert self.guard.admit(frame, Source.STATION, self.now_ns).reason == "harmless"
            (message,) = self.parser.parse_buffer(send.frame)
            out.append(((self.now_ns - self.start_ns) / SECOND, send.vehicle_id, message))
        self.sent += out
        return out

    def tick(self, seconds, on_tick=lambda: None):
        for _ in range(round(seconds * 10)):
            self.now_ns += SECOND // 10
            on_tick()
            self.feed(TickInput())

    def of(self, kind):
        return [(at, vehicle_id, m) for at, vehicle_id, m in self.sent if m.get_type() == kind]

    def asked(self, message_id, command=511):
        return [at for at, _, m in self.of("COMMAND_LONG") if (m.command, m.param1) == (command, message_id)]


@pytest.fixture
def bench(now_ns, vehicle):
    bench = Bench(now_ns)
    bench.feed(TickInput(), vehicle(1, (0, 0, 50), home=None))
    return bench


@pytest.fixture
def autopilot():
    return encode.Encoder(1, 1)


def position_frame(autopilot):
    return FrameInput(
        "udp",
        Direction.IN,
        autopilot.pack(dialect.MAVLink_global_position_int_message(1, 1, 1, 1, 1, 0, 0, 0, 0)),
    )


def test_a_heartbeat_every_second_as_a_ground_station(bench):
    bench.tick(10.0)
    beats = bench.of("HEARTBEAT")
    assert 10 <= len(beats) <= 11
    assert {(m.type, m.autopilot, m.get_srcSystem(), m.get_srcComponent()) for _, _, m in beats} == {
        (6, 8, 255, 190)
    }


def test_a_new_vehicle_is_asked_for_every_stream_at_its_rate(bench):
    bench.tick(1.0)
    wanted = {stream.message_id: stream.rate_hz for stream in TelemetrySettings().streams}
    asked = {int(m.param1): 1e6 / m.param2 for _, _, m in bench.of("COMMAND_LONG") if m.command == 511}
    assert asked == pytest.approx(wanted)


def test_not_all_at_once(bench):
    per_tick = {}
    bench.tick(3.0)
    for at, _, message in bench.of("COMMAND_LONG"):
        per_tick[at] = per_tick.get(at, 0) + (message.command == 511)
    assert max(per_tick.values()) <= 2


def test_a_silent_stream_is_asked_for_ever_more_seldom(bench):
    bench.tick(120.0)
    at = bench.asked(GLOBAL_POSITION)
    gaps = [b - a for a, b in pairwise(at)]
    assert gaps[:4] == pytest.approx([2.0, 4.0, 8.0, 16.0], abs=0.15)
    assert gaps[4:] == pytest.approx([30.0] * len(gaps[4:]), abs=0.15)


def test_an_optional_stream_is_given_up(bench):
    bench.tick(200.0)
    assert len(bench.asked(POSITION_TARGET)) == TelemetrySettings().optional_attempts


def test_a_stream_that_comes_is_not_asked_for_again_until_it_stops(bench, autopilot):
    bench.tick(30.0, lambda: bench.feed(position_frame(autopilot)))
    assert len(bench.asked(GLOBAL_POSITION)) == 1
    bench.tick(3.0)
    assert len(bench.asked(GLOBAL_POSITION)) == 2


def test_the_same_message_of_another_component_is_not_the_autopilots(bench):
    sensor = encode.Encoder(1, 191)
    bench.tick(5.0, lambda: bench.feed(position_frame(sensor)))
    assert len(bench.asked(GLOBAL_POSITION)) > 1


def test_home_is_asked_for_until_known_and_again_after_arming(bench, vehicle, frame, autopilot):
    bench.tick(10.0)
    assert len(bench.asked(HOME, 512)) >= 3
    before = len(bench.asked(HOME, 512))
    home = FrameInput(
        "udp",
        Direction.IN,
        autopilot.pack(dialect.MAVLink_home_position_message(1, 1, 1, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)),
    )
    bench.feed(home, vehicle(1, (0, 0, 0), armed=False, home=frame.origin))
    bench.tick(20.0)
    assert len(bench.asked(HOME, 512)) == before
    bench.feed(TickInput(), vehicle(1, (0, 0, 0), armed=True, home=frame.origin))
    assert len(bench.asked(HOME, 512)) == before + 1
    bench.feed(home)
    bench.tick(31.0)
    assert len(bench.asked(HOME, 512)) == before + 2


def test_a_lost_vehicle_is_left_alone(bench, vehicle):
    bench.tick(1.0)
    bench.feed(TickInput(), vehicle(1, (0, 0, 50), lost=True))
    count = len(bench.sent)
    bench.tick(20.0)
    assert {m.get_type() for _, _, m in bench.sent[count:]} == {"HEARTBEAT"}


def test_timesync_is_asked_fast_first_and_answered(bench):
    bench.tick(60.0)
    at = [when for when, _, m in bench.of("TIMESYNC")]
    assert 8 <= len(at) <= 11
    assert at[3] < 4.0
    message = Timesync(tc1=0, ts1=123_456_789)
    ((_, vehicle_id, reply),) = [
        item
        for item in bench.feed(TickInput(), VehicleMessage(1, 1, "udp", bench.now_ns, message))
        if item[2].get_type() == "TIMESYNC" and item[2].tc1 != 0
    ]
    assert (vehicle_id, reply.ts1, reply.tc1) == (1, 123_456_789, bench.now_ns)
    answers = bench.feed(TickInput(), VehicleMessage(1, 1, "udp", bench.now_ns, Timesync(tc1=5, ts1=6)))
    assert not [m for _, _, m in answers if m.get_type() == "TIMESYNC" and m.tc1 != 0]


class TestCaptures:
    def activity(self, bench, vehicle_id, beacon_id):
        return LinkActivity(vehicle_id, beacon_id, bench.now_ns, -80.0, None, 1, 0, 0)

    def fly(self, bench, links, seconds):
        def heard():
            bench.feed(TickInput(), *(self.activity(bench, *link) for link in links))

        bench.tick(seconds, heard)
        return bench.of("SAR_CIR_REQUEST")

    def test_an_active_link_is_asked_one_frame_at_a_time_and_renewed_in_time(self, bench):
        requests = self.fly(bench, [(1, 2**63 + 5)], 30.0)
        assert {(m.target_system, m.target_component, m.beacon_id) for _, _, m in requests} == {
            (1, 191, 2**63 + 5)
        }
        assert {(m.tap_count, m.encoding, m.captures, m.interval_ms) for _, _, m in requests} == {
            (0, 0, 10, 1000)
        }
        at = [when for when, _, _ in requests]
        assert [b - a for a, b in pairwise(at)] == pytest.approx([8.0] * (len(at) - 1), abs=0.15)

    def test_a_silent_link_is_not_asked(self, bench):
        self.fly(bench, [(1, 7)], 1.0)
        count = len(bench.of("SAR_CIR_REQUEST"))
        bench.tick(40.0)
        late = [at for at, _, _ in bench.of("SAR_CIR_REQUEST")[count:]]
        assert all(at < 12.0 for at in late)

    @pytest.mark.parametrize("count", [1, 5, 20])
    def test_a_serial_radio_keeps_its_budget(self, now_ns, vehicle, count):
        bench = Bench(now_ns)
        links = []
        for index in range(count):
            bench.feed(
                TickInput(), vehicle(index + 1, (0, 0, 50), connections=("serial:/dev/ttyUSB0:57600",))
            )
            links += [(index + 1, 1), (index + 1, 2)]
        requests = self.fly(bench, links, 3.0)
        rates = {
            (m.target_system, m.beacon_id): 1000.0 / m.interval_ms for _, _, m in requests[-len(links) :]
        }
        assert len(rates) == len(links)
        # 116 bytes each: interfaces' own number for a window of 64 taps.
        assert sum(rates.values()) * 116 <= TelemetrySettings().cir_budget_serial_bytes_s
        assert all(m.interval_ms < 65_536 for _, _, m in requests)

    def test_none_are_asked_for_when_switched_off(self, now_ns, vehicle):
        bench = Bench(now_ns, replace(TelemetrySettings(), cir_interval_ms=0))
        bench.feed(TickInput(), vehicle(1, (0, 0, 50)))
        assert self.fly(bench, [(1, 7)], 3.0) == []


def test_estimates_go_to_everyone_once_a_second(bench, frame):
    bench.targets = tuple(
        TargetState(
            beacon_id=beacon_id,
            time_ns=bench.now_ns,
            first_heard_ns=bench.now_ns,
            last_heard_ns=bench.now_ns,
            position=frame.origin,
            covariance_enu_m2=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
            radius_90_m=12.5,
            environment=Environment.NLOS,
            los_links=0,
            links=4,
            windows=9,
            method="adaptive",
            height_reference="home",
            sequence=77,
            snapshot=None,
        )
        for beacon_id in (7, 2**63 + 1)
    )
    bench.tick(10.0)
    sent = bench.of("SAR_TARGET_ESTIMATE")
    assert {vehicle_id for _, vehicle_id, _ in sent} == {None}
    assert 20 <= len(sent) <= 22
    last = sent[-1][2]
    assert (last.beacon_id, last.sequence, last.environment, last.links) == (2**63 + 1, 77, 3, 4)
    assert list(last.covariance_enu) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert (last.lat, last.lon, last.alt) == (-353625000, 1491654000, 584000)
    assert abs(last.time_usec - bench.now_ns // 1000) < 2_000_000


def test_a_resumed_session_asks_everything_anew(bench, vehicle):
    bench.tick(2.0)
    bench.feed(SessionInput("resumed", "1"))
    count = len(bench.asked(GLOBAL_POSITION))
    bench.tick(2.0)
    assert len(bench.asked(GLOBAL_POSITION)) == count
    bench.feed(TickInput(), vehicle(1, (0, 0, 50)))
    bench.tick(1.0)
    assert len(bench.asked(GLOBAL_POSITION)) == count + 1
