"""Ingest, telemetry, planner, desk and guard round the simulator's autopilots, frame by frame.

Nothing is set up for the vehicles: they send only heartbeats until the station asks them
(the PX4 flavour streams by itself), and fly where an operator's confirmation sends them.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from groundstation.command.desk import CommandDesk
from groundstation.command.outputs import SendFrame
from groundstation.command.telemetry import TelemetryDesk
from groundstation.domain.command import CommandPhase, CommandStatus
from groundstation.domain.events import Event
from groundstation.domain.inputs import (
    Decision,
    Direction,
    FrameInput,
    MissionInput,
    OperatorInput,
    Record,
    SessionInput,
    TickInput,
)
from groundstation.domain.target import Environment, TargetState
from groundstation.engine.ingest import Ingest
from groundstation.guidance import GuidanceSettings, propose
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.framing import frame_of
from groundstation.safety.guard import Source
from sim_sitl.commands import CommandHandler
from sim_sitl.modes import Flavour
from sim_sitl.vehicle import TICK_S, Vehicle, VehicleSettings

SECOND = 10**9


class Field:
    """Vehicles on one side, the station's rooms on the other, in simulated time."""

    def __init__(self, now_ns, frame, flavours):
        self.now_ns = now_ns
        self.start_ns = now_ns
        self.vehicles = {}
        for index, flavour in enumerate(flavours):
            start = (-60.0 + 40.0 * index, -70.0, 50.0)
            settings = VehicleSettings(index + 1, (start[0], start[1], 0.0), flavour, start_enu_m=start)
            self.vehicles[index + 1] = Vehicle(settings, frame, 5)
        self.handlers = {vehicle_id: CommandHandler(v) for vehicle_id, v in self.vehicles.items()}
        self.parser = dialect.MAVLink(None)
        self.ingest, self.desk, self.telemetry = Ingest(), CommandDesk(), TelemetryDesk()
        self.targets = ()
        self.outputs = []
        self.seq = 0
        self.ticks = 0

    def feed(self, value):
        record = Record(self.seq, self.now_ns, self.now_ns // 1000, value)
        self.seq += 1
        ingested = self.ingest.handle(record)
        outputs = self.desk.handle(record, ingested)
        sends = [o for o in outputs if isinstance(o, SendFrame)]
        sends += self.telemetry.handle(record, ingested, self.targets)
        self.outputs += [o for o in outputs if not isinstance(o, SendFrame)]
        for send in sends:
            self.transmit(send)
        return outputs

    def transmit(self, send):
        frame = frame_of(send.frame)
        verdict = self.desk.guard.admit(frame, Source.STATION, self.now_ns)
        assert verdict.admitted, verdict
        (message,) = self.parser.parse_buffer(self.desk.guard.stamp(frame, "sim"))
        for vehicle_id, handler in self.handlers.items():
            if send.vehicle_id in (None, vehicle_id):
                handler.handle(message)

    def fly(self, seconds, until_arrived=()):
        """Runs for ``seconds`` or until these vehicles have arrived; returns what the desk said."""
        self.outputs = []
        end_ns = self.now_ns + round(seconds * SECOND)
        while self.now_ns < end_ns and not self.arrived(until_arrived):
            self.now_ns += round(TICK_S * SECOND)
            for vehicle in self.vehicles.values():
                vehicle.step((self.now_ns - self.start_ns) / SECOND)
                for raw in vehicle.take():
                    self.feed(FrameInput("sim", Direction.IN, raw))
            if (self.now_ns - self.start_ns) // (SECOND // 10) > self.ticks:
                self.ticks += 1
                self.feed(TickInput())
        return self.outputs

    def arrived(self, vehicle_ids):
        done = [o.vehicle_id for o in self.outputs if getattr(o, "phase", None) is CommandPhase.ARRIVED]
        return bool(vehicle_ids) and set(vehicle_ids) <= set(done)

    def at(self, vehicle_id):
        return self.vehicles[vehicle_id].flight.position_enu_m

    def phases(self, outputs, vehicle_id):
        return [o.phase for o in outputs if isinstance(o, CommandStatus) and o.vehicle_id == vehicle_id]


@pytest.fixture
def field(now_ns, frame, mission):
    field = Field(now_ns, frame, [Flavour.ARDUPILOT, Flavour.PX4, Flavour.ARDUPILOT])
    field.feed(SessionInput("began", "1"))
    field.feed(MissionInput(mission, "anna"))
    field.fly(8.0)
    return field


@pytest.fixture
def belief(place, now_ns):
    return TargetState(
        beacon_id=7,
        time_ns=now_ns,
        first_heard_ns=now_ns,
        last_heard_ns=now_ns + 60 * SECOND,
        position=place(0.0, 0.0, 1.0),
        covariance_enu_m2=(900.0, 0.0, 0.0, 900.0, 0.0, 25.0),
        radius_90_m=60.0,
        environment=Environment.MIXED,
        los_links=2,
        links=3,
        windows=20,
        method="adaptive",
        height_reference="home",
        sequence=5,
        snapshot=None,
    )


def plan(field, belief):
    return propose(field.desk.plan_request(field.now_ns, [belief]), GuidanceSettings(), field.desk.safety)


def test_vehicles_are_asked_planned_for_confirmed_and_flown(field, belief, frame):
    planned = plan(field, belief)
    assert planned.proposals, planned.notes
    field.feed(planned)
    sent = {}
    for proposal in planned.proposals:
        outputs = field.feed(
            OperatorInput("anna", Decision.CONFIRM, proposal.proposal_id, proposal.vehicle_id)
        )
        statuses = [o for o in outputs if isinstance(o, CommandStatus)]
        if statuses[-1].phase is CommandPhase.SENT:
            sent[proposal.vehicle_id] = proposal
    assert len(sent) >= 2
    outputs = field.fly(60.0, until_arrived=sent)
    for vehicle_id, proposal in sent.items():
        assert field.phases(outputs, vehicle_id) == [
            CommandPhase.ACCEPTED,
            CommandPhase.FLYING,
            CommandPhase.ARRIVED,
        ]
        assert math.dist(field.at(vehicle_id), frame.to_enu(proposal.position)) < 6.0
    assert not [o for o in outputs if isinstance(o, Event)]
    again = plan(field, belief)
    assert not {p.vehicle_id for p in again.proposals} & set(sent)


def test_hold_all_stops_every_flavour_in_flight(field, belief):
    planned = plan(field, belief)
    field.feed(planned)
    for proposal in planned.proposals:
        field.feed(OperatorInput("anna", Decision.CONFIRM, proposal.proposal_id, proposal.vehicle_id))
    field.fly(3.0)
    moving = [v for v in field.vehicles.values() if math.hypot(*v.flight.velocity_enu_m_s) > 2.0]
    assert len(moving) >= 2
    outputs = field.feed(OperatorInput("anna", Decision.HOLD_ALL))
    assert [o.vehicle_id for o in outputs if isinstance(o, SendFrame)] == [1, 2, 3]
    outputs = field.fly(8.0)
    for vehicle_id in field.vehicles:
        assert CommandPhase.HOLDING in field.phases(outputs, vehicle_id)
        assert field.desk.grants.live(vehicle_id, field.now_ns) is None
    before = {vehicle_id: field.at(vehicle_id) for vehicle_id in field.vehicles}
    field.fly(6.0)
    for vehicle_id, place in before.items():
        assert math.dist(place, field.at(vehicle_id)) < 2.0
    assert field.vehicles[1].mode == "BRAKE"


def test_a_held_vehicle_can_be_sent_on(field, belief, place):
    field.feed(OperatorInput("anna", Decision.HOLD_ALL))
    field.fly(7.0)
    planned = plan(field, replace(belief, radius_90_m=80.0))
    field.feed(planned)
    first = planned.proposals[0]
    field.feed(OperatorInput("anna", Decision.CONFIRM, first.proposal_id, first.vehicle_id))
    assert CommandPhase.ARRIVED in field.phases(
        field.fly(60.0, until_arrived=[first.vehicle_id]), first.vehicle_id
    )


def test_a_pilot_who_takes_over_is_reported_and_not_fought(field, belief):
    planned = plan(field, belief)
    field.feed(planned)
    proposal = next(p for p in planned.proposals if field.vehicles[p.vehicle_id].flavour is Flavour.ARDUPILOT)
    field.feed(OperatorInput("anna", Decision.CONFIRM, proposal.proposal_id, proposal.vehicle_id))
    field.fly(3.0)
    vehicle = field.vehicles[proposal.vehicle_id]
    vehicle.enter_mode(6)
    assert vehicle.mode == "RTL"
    outputs = field.fly(5.0)
    assert field.phases(outputs, proposal.vehicle_id) == [CommandPhase.SUPERSEDED]
    assert vehicle.mode == "RTL"
    notes = plan(field, belief).notes
    assert any(f"vehicle {proposal.vehicle_id} " in note and "RTL" in note for note in notes)
