"""The desk: confirmation, gate at sending, grants, hold, and what a restart forgets."""

from __future__ import annotations

from dataclasses import replace

import pytest

from groundstation.command.desk import CommandDesk
from groundstation.command.outputs import SendFrame
from groundstation.domain.command import CommandKind, CommandPhase, CommandStatus, Proposal, ProposalGone
from groundstation.domain.events import Event, Severity
from groundstation.domain.inputs import (
    Decision,
    MissionInput,
    OperatorInput,
    PlanInput,
    Record,
    SessionInput,
    TickInput,
)
from groundstation.domain.vehicle import Autopilot
from groundstation.mavlink.framing import Framer, frame_of
from groundstation.mavlink.messages import CommandAck, Heartbeat
from groundstation.mavlink.vehicle_message import VehicleMessage
from groundstation.safety.guard import Source

SECOND = 10**9


class Bench:
    """A desk with the journal's records made for it; time is set by the test."""

    def __init__(self, now_ns):
        self.desk = CommandDesk()
        self.now_ns = now_ns
        self.records = []

    def feed(self, value, *ingested):
        record = Record(len(self.records), self.now_ns, self.now_ns // 1000, value)
        self.records.append((record, ingested))
        return self.desk.handle(record, ingested)

    def operator(self, decision, proposal_id=None, vehicle_id=None):
        return self.feed(OperatorInput("anna", decision, proposal_id, vehicle_id))

    def tick(self, seconds):
        outputs = []
        for _ in range(round(seconds * 10)):
            self.now_ns += SECOND // 10
            outputs += self.feed(TickInput())
        return outputs

    def admitted(self, outputs):
        frames = [frame_of(item.frame) for item in outputs if isinstance(item, SendFrame)]
        verdicts = [self.desk.guard.admit(frame, Source.STATION, self.now_ns) for frame in frames]
        return [verdict.admitted for verdict in verdicts]

    def says(self, vehicle_id, message):
        return self.feed(TickInput(), VehicleMessage(vehicle_id, 1, "udp", self.now_ns, message))


def kinds(outputs, kind):
    return [item for item in outputs if isinstance(item, kind)]


def phases(outputs):
    return [status.phase for status in kinds(outputs, CommandStatus)]


@pytest.fixture
def fresh(vehicle):
    def build(bench, vehicle_id, place_enu, **changes):
        times = dict.fromkeys(("time_ns", "last_heartbeat_ns", "position_time_ns"), bench.now_ns)
        return vehicle(vehicle_id, place_enu, **(times | changes))

    return build


@pytest.fixture
def bench(now_ns, mission, fresh):
    bench = Bench(now_ns)
    bench.feed(SessionInput("began", "1"))
    bench.feed(MissionInput(mission, "anna"))
    bench.feed(TickInput(), fresh(bench, 1, (0, 0, 50)), fresh(bench, 2, (-100, 0, 50)))
    for vehicle_id in (1, 2):
        bench.says(vehicle_id, Heartbeat(2, 3, 0x89, 4, 4))
    return bench


@pytest.fixture
def offer(place, mission):
    def build(bench, vehicle_id=1, proposal_id="p1", target=None):
        proposal = Proposal(
            proposal_id=proposal_id,
            vehicle_id=vehicle_id,
            beacon_id=2**60,
            position=target or place(100, 50, 60),
            height_above_home_m=60.0,
            reason="there",
            created_ns=bench.now_ns,
            expires_ns=bench.now_ns + 60 * SECOND,
            mission_revision=mission.revision,
            target_sequence=1,
        )
        return bench.feed(PlanInput(mission.revision, (proposal,)))

    return build


def test_a_plan_is_offered_and_a_confirmation_sends_it(bench, offer, place):
    assert [p.proposal_id for p in kinds(offer(bench), Proposal)] == ["p1"]
    outputs = bench.operator(Decision.CONFIRM, "p1", 1)
    assert phases(outputs) == [CommandPhase.GATED, CommandPhase.SENT]
    assert [gone.reason for gone in kinds(outputs, ProposalGone)] == ["confirmed"]
    (send,) = kinds(outputs, SendFrame)
    assert send.vehicle_id == 1
    assert Framer().feed(send.frame)[0].message_id == 75
    assert bench.admitted(outputs) == [True]
    accepted = bench.says(1, CommandAck(192, 0, None, 255, 190))
    assert phases(accepted) == [CommandPhase.ACCEPTED]
    # Acknowledged: nothing more has to leave, so nothing more may.
    assert bench.admitted(outputs) == [False]


def test_retries_pass_the_guard_and_end(bench, offer):
    offer(bench)
    bench.operator(Decision.CONFIRM, "p1", 1)
    outputs = bench.tick(1.0)
    assert bench.admitted(outputs) == [True]
    outputs = bench.tick(3.0)
    assert phases(outputs) == [CommandPhase.TIMED_OUT]
    (event,) = kinds(outputs, Event)
    assert (event.code, event.vehicle_id) == ("command.timed_out", 1)


@pytest.mark.parametrize("vehicle_id", [2, 9, None])
def test_a_confirmation_for_another_vehicle_sends_nothing(bench, offer, vehicle_id):
    offer(bench)
    outputs = bench.operator(Decision.CONFIRM, "p1", vehicle_id)
    assert kinds(outputs, SendFrame) == []
    assert [event.code for event in kinds(outputs, Event)] == ["confirm.mismatch"]
    assert bench.desk.grants.issued_total == 0
    assert kinds(bench.operator(Decision.CONFIRM, "p1", 1), SendFrame) != []


def test_a_second_click_on_the_same_proposal_sends_nothing(bench, offer):
    offer(bench)
    bench.operator(Decision.CONFIRM, "p1", 1)
    outputs = bench.operator(Decision.CONFIRM, "p1", 1)
    assert kinds(outputs, SendFrame) == []
    assert [event.code for event in kinds(outputs, Event)] == ["confirm.unknown"]


def test_proposals_expire_on_ticks_and_cannot_be_confirmed_late(bench, offer):
    offer(bench)
    bench.now_ns += 60 * SECOND
    outputs = bench.operator(Decision.CONFIRM, "p1", 1)
    assert kinds(outputs, SendFrame) == []
    assert [gone.reason for gone in kinds(outputs, ProposalGone)] == ["expired"]
    offer(bench, proposal_id="p2")
    outputs = bench.tick(61.0)
    assert [(gone.proposal_id, gone.reason) for gone in kinds(outputs, ProposalGone)] == [("p2", "expired")]


def test_the_gate_is_asked_again_with_the_poses_of_this_moment(bench, offer, fresh):
    offer(bench)
    bench.now_ns += 4 * SECOND
    stale = bench.operator(Decision.CONFIRM, "p1", 1)
    (refused,) = kinds(stale, CommandStatus)
    assert refused.phase is CommandPhase.REFUSED
    assert "4.0 s old" in refused.detail
    assert kinds(stale, SendFrame) == []
    # Another vehicle has come into the way meanwhile.
    bench.feed(TickInput(), fresh(bench, 1, (0, 0, 50)), fresh(bench, 2, (50, 25, 55)))
    (blocked,) = kinds(bench.operator(Decision.CONFIRM, "p1", 1), CommandStatus)
    assert "vehicle 2" in blocked.detail
    bench.feed(TickInput(), fresh(bench, 2, (-100, 0, 50)))
    assert CommandPhase.SENT in phases(bench.operator(Decision.CONFIRM, "p1", 1))


def test_a_commanded_target_keeps_others_away(bench, offer, place, fresh):
    offer(bench)
    bench.operator(Decision.CONFIRM, "p1", 1)
    offer(bench, 2, "p2", place(100, 45, 60))
    (refused,) = kinds(bench.operator(Decision.CONFIRM, "p2", 2), CommandStatus)
    assert refused.phase is CommandPhase.REFUSED
    bench.operator(Decision.HOLD, vehicle_id=1)
    held = bench.feed(
        TickInput(), fresh(bench, 1, (0, 100, 50), mode="BRAKE", last_heartbeat_ns=bench.now_ns + 1)
    )
    assert CommandPhase.HOLDING in phases(held)
    assert CommandPhase.SENT in phases(bench.operator(Decision.CONFIRM, "p2", 2))


def test_a_mission_change_withdraws_every_proposal_and_refuses_old_plans(bench, offer, mission):
    offer(bench)
    outputs = bench.feed(MissionInput(replace(mission, revision=4, fence=None), "anna"))
    assert [gone.proposal_id for gone in kinds(outputs, ProposalGone)] == ["p1"]
    assert offer(bench, proposal_id="p2") == []
    assert kinds(bench.operator(Decision.CONFIRM, "p2", 1), SendFrame) == []


class TestHold:
    def test_works_without_fence_mission_pose_or_proposal(self, now_ns, fresh):
        bench = Bench(now_ns)
        bench.feed(TickInput(), fresh(bench, 1, (0, 0, 50), position=None, home=None, lost=True))
        bench.says(1, Heartbeat(2, 3, 0x89, 4, 4))
        outputs = bench.operator(Decision.HOLD, vehicle_id=1)
        assert isinstance(outputs[0], SendFrame)
        assert bench.admitted(outputs) == [True]

    def test_revokes_the_grant_before_the_frame_leaves(self, bench, offer):
        offer(bench)
        sent = bench.operator(Decision.CONFIRM, "p1", 1)
        outputs = bench.operator(Decision.HOLD, vehicle_id=1)
        assert bench.admitted(sent) == [False]
        assert bench.admitted(outputs) == [True]
        assert [(s.kind, s.phase) for s in kinds(outputs, CommandStatus)] == [
            (CommandKind.HOLD, CommandPhase.SENT),
            (CommandKind.REPOSITION, CommandPhase.REVOKED),
        ]
        # The reposition is over: no retry of it comes any more.
        later = bench.tick(2.0)
        assert all(frame_of(item.frame).message_id == 76 for item in kinds(later, SendFrame))

    def test_withdraws_the_vehicles_proposals(self, bench, offer):
        offer(bench)
        offer(bench, 2, "p2")
        gone = kinds(bench.operator(Decision.HOLD, vehicle_id=1), ProposalGone)
        assert [item.proposal_id for item in gone] == ["p1"]

    def test_all_holds_every_vehicle_ever_heard(self, bench, offer):
        offer(bench)
        sent = bench.operator(Decision.CONFIRM, "p1", 1)
        outputs = bench.operator(Decision.HOLD_ALL)
        assert [item.vehicle_id for item in kinds(outputs, SendFrame)] == [1, 2]
        assert bench.admitted(outputs) == [True, True]
        assert bench.admitted(sent) == [False]

    def test_is_verified_by_mode_and_reported_when_it_is_not(self, bench, fresh):
        bench.operator(Decision.HOLD, vehicle_id=1)
        bench.tick(1.0)
        outputs = bench.feed(
            TickInput(), fresh(bench, 1, (0, 0, 50), mode="BRAKE", last_heartbeat_ns=bench.now_ns + 1)
        )
        assert phases(outputs) == [CommandPhase.HOLDING]
        bench.operator(Decision.HOLD, vehicle_id=2)
        outputs = bench.tick(30.0)
        assert phases(outputs) == [CommandPhase.TIMED_OUT]
        (event,) = kinds(outputs, Event)
        assert event.severity is Severity.ERROR

    def test_pressed_twice_sends_at_once_again(self, bench):
        bench.operator(Decision.HOLD, vehicle_id=1)
        outputs = bench.operator(Decision.HOLD, vehicle_id=1)
        assert len(kinds(outputs, SendFrame)) == 1
        assert phases(outputs) == [CommandPhase.SENT, CommandPhase.SUPERSEDED]

    def test_no_confirmation_overtakes_it(self, bench, offer, fresh):
        bench.operator(Decision.HOLD, vehicle_id=1)
        offer(bench)
        outputs = bench.operator(Decision.CONFIRM, "p1", 1)
        assert phases(outputs) == [CommandPhase.REFUSED]
        assert [event.code for event in kinds(outputs, Event)] == ["confirm.refused"]
        assert kinds(outputs, SendFrame) == []
        bench.tick(0.5)
        bench.feed(TickInput(), fresh(bench, 1, (0, 0, 50), mode="BRAKE", last_heartbeat_ns=bench.now_ns + 1))
        assert CommandPhase.SENT in phases(bench.operator(Decision.CONFIRM, "p1", 1))

    def test_uses_the_modes_of_the_autopilot(self, bench, fresh):
        bench.feed(TickInput(), fresh(bench, 3, (0, 100, 50), autopilot=Autopilot.PX4, mode="AUTO.LOITER"))
        bench.says(3, Heartbeat(2, 12, 0x81, 4 << 16 | 3 << 24, 4))
        outputs = bench.operator(Decision.HOLD, vehicle_id=3)
        assert bench.admitted(outputs) == [True]
        payload = frame_of(kinds(outputs, SendFrame)[0].frame).payload
        assert int.from_bytes(payload[28:30], "little") == 192


def test_a_newer_command_supersedes_the_older(bench, offer, place):
    offer(bench)
    first = bench.operator(Decision.CONFIRM, "p1", 1)
    offer(bench, 1, "p2", place(50, -80, 60))
    outputs = bench.operator(Decision.CONFIRM, "p2", 1)
    assert phases(outputs) == [CommandPhase.SUPERSEDED, CommandPhase.GATED, CommandPhase.SENT]
    assert bench.admitted(first) == [False]
    assert bench.admitted(outputs) == [True]


@pytest.mark.parametrize(("system", "component"), [(245, 190), (255, 191)])
def test_another_stations_acknowledgement_is_not_ours(bench, offer, system, component):
    offer(bench)
    bench.operator(Decision.CONFIRM, "p1", 1)
    assert phases(bench.says(1, CommandAck(192, 0, None, system, component))) == []


def test_a_refusing_vehicle_ends_it_with_its_answer(bench, offer):
    offer(bench)
    sent = bench.operator(Decision.CONFIRM, "p1", 1)
    outputs = bench.says(1, CommandAck(192, 2, None, 255, 190))
    (status,) = kinds(outputs, CommandStatus)
    assert (status.phase, status.detail) == (CommandPhase.REFUSED, "the vehicle answered: denied")
    assert bench.admitted(sent) == [False]


def test_dismissed_proposals_are_gone(bench, offer):
    offer(bench)
    (gone,) = bench.operator(Decision.DISMISS, "p1")
    assert gone.reason == "dismissed"
    assert [event.code for event in kinds(bench.operator(Decision.DISMISS, "p1"), Event)] == [
        "operator.incomplete"
    ]


def test_a_resumed_session_has_no_grant_no_command_and_no_proposal(bench, offer):
    offer(bench)
    sent = bench.operator(Decision.CONFIRM, "p1", 1)
    offer(bench, 2, "p2")
    outputs = bench.feed(SessionInput("resumed", "1"))
    assert phases(outputs) == [CommandPhase.REVOKED]
    assert [gone.proposal_id for gone in kinds(outputs, ProposalGone)] == ["p2"]
    assert bench.admitted(sent) == [False]
    assert kinds(bench.tick(5.0), SendFrame) == []


def test_state_survives_a_restart_without_authority(bench, offer, mission):
    offer(bench)
    sent = bench.operator(Decision.CONFIRM, "p1", 1)
    offer(bench, 2, "p2")
    after = CommandDesk()
    after.restore(bench.desk.state())
    assert after.mission == mission
    assert after.state() == bench.desk.state()
    assert (
        after.guard.admit(frame_of(kinds(sent, SendFrame)[0].frame), Source.STATION, bench.now_ns).admitted
        is False
    )


def test_the_same_records_give_the_same_outputs(bench, offer, fresh):
    offer(bench)
    bench.operator(Decision.CONFIRM, "p1", 1)
    bench.tick(2.0)
    bench.operator(Decision.HOLD_ALL)
    bench.tick(12.0)
    first, second = CommandDesk(), CommandDesk(replay=True)
    for record, ingested in bench.records:
        outputs = first.handle(record, ingested)
        assert outputs == second.handle(record, ingested)
        for item in kinds(outputs, SendFrame):
            assert not second.guard.admit(frame_of(item.frame), Source.STATION, record.time_ns).admitted
    assert first.state() == second.state() == bench.desk.state()


def test_outcomes_are_counted(bench, offer):
    offer(bench)
    bench.operator(Decision.CONFIRM, "p1", 2)
    bench.operator(Decision.CONFIRM, "p1", 1)
    counted = {(c.name, *dict(c.labels).values()): c.value for c in bench.desk.counters()}
    assert counted["confirmations_total", "mismatch"] == 1
    assert counted["confirmations_total", "sent"] == 1
    assert counted["proposals_total", "confirmed"] == 1
    assert counted["grants_total", "issued"] == 1
