"""A real MAVSDK behind the guard: what it retries after a hold does not leave.

The vehicle is the simulator's ArduPilot; the radio between loses its acknowledgement of the
reposition, so that MAVSDK goes on retrying after its caller has given up.
"""

from __future__ import annotations

import asyncio
import math
import struct
import time
from dataclasses import dataclass, field, replace

import pytest

from groundstation.command.desk import CommandDesk
from groundstation.command.mavsdk_adapter import MavsdkAdapter
from groundstation.command.outputs import SendFrame
from groundstation.domain.errors import PeerError
from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.inputs import Decision, OperatorInput, Record, TickInput
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.framing import Frame, Framer, frame_of
from groundstation.mavlink.messages import Heartbeat
from groundstation.mavlink.vehicle_message import VehicleMessage
from groundstation.safety.guard import MAV_CMD_DO_REPOSITION, Source
from sim_sitl.commands import CommandHandler
from sim_sitl.vehicle import TICK_S, Vehicle, VehicleSettings

pytestmark = pytest.mark.peer

GUIDED, BRAKE = 4, 17
ACK = 77


@dataclass
class Radio:
    """Our side of one vehicle's radio: desk, guard, MAVSDK; the vehicle on the other side."""

    desk: CommandDesk
    vehicle: Vehicle
    guarded: bool = True
    lose_acknowledgements: bool = True
    refused: list[str] = field(default_factory=list)
    repositions_emitted: list[float] = field(default_factory=list)
    repositions_sent: list[float] = field(default_factory=list)

    def __post_init__(self):
        self.commands = CommandHandler(self.vehicle)
        self.parser = dialect.MAVLink(None)
        self.framer = Framer()
        self.start = time.monotonic()
        self.adapter = None

    def now_ns(self):
        return 1_800_000_000_000_000_000 + round(self.seconds() * 1e9)

    def seconds(self):
        return time.monotonic() - self.start

    def emitted_by_mavsdk(self, frame: Frame):
        moves = frame.message_id == 75
        if moves:
            self.repositions_emitted.append(self.seconds())
        verdict = self.desk.guard.admit(frame, Source.MAVSDK, self.now_ns())
        if not verdict.admitted and self.guarded:
            self.refused.append(verdict.reason)
            return
        if moves:
            self.repositions_sent.append(self.seconds())
        self.transmit(frame)

    def transmit(self, frame: Frame):
        for message in self.parser.parse_buffer(self.desk.guard.stamp(frame, "sim")) or []:
            self.commands.handle(message)

    def handle(self, value, *ingested):
        now = self.now_ns()
        for output in self.desk.handle(Record(0, now, now // 1000, value), ingested):
            if isinstance(output, SendFrame):
                frame = frame_of(output.frame)
                assert self.desk.guard.admit(frame, Source.STATION, now).admitted
                self.transmit(frame)

    async def fly(self, seconds):
        """Lets the vehicle live in real time and hands what it says to MAVSDK and the desk."""
        end = self.seconds() + seconds
        while self.seconds() < end:
            while self.vehicle.time_s < self.seconds():
                self.vehicle.step(self.vehicle.time_s + TICK_S)
            for raw in self.vehicle.take():
                (frame,) = self.framer.feed(raw)
                reposition_ack = frame.message_id == ACK and struct.unpack_from("<H", frame.payload)[0] == 192
                if not (self.lose_acknowledgements and reposition_ack):
                    self.adapter.feed(raw)
                if frame.message_id == 0:
                    heartbeat = Heartbeat(2, 3, 0x89, self.vehicle.custom_mode, 4)
                    self.handle(TickInput(), VehicleMessage(1, 1, "sim", self.now_ns(), heartbeat))
            await asyncio.sleep(0.02)

    async def until_discovered(self):
        while 1 not in self.adapter.known_vehicles():
            assert self.seconds() < 10.0
            await self.fly(0.1)


@pytest.fixture
def radio(vehicle, frame):
    sim = Vehicle(
        VehicleSettings(1, (0.0, 0.0, 0.0), start_enu_m=(0.0, 0.0, 50.0)), LocalFrame(frame.origin), 1
    )
    sim.custom_mode = GUIDED
    radio = Radio(CommandDesk(), sim)
    radio.handle(TickInput(), replace(vehicle(1, (0, 0, 50))))
    return radio


async def goto_then_cancel_then_hold(radio, target):
    """What an impatient operator does: send, give up, stop."""
    radio.desk.grants.issue("c1", 1, MAV_CMD_DO_REPOSITION, target, radio.now_ns())
    flight = asyncio.create_task(radio.adapter.goto_location(1, target))
    await radio.fly(0.3)
    flight.cancel()
    radio.handle(OperatorInput("anna", Decision.HOLD, None, 1))
    held_s = radio.seconds()
    await radio.fly(2.0)
    with pytest.raises(asyncio.CancelledError):
        await flight
    return held_s


async def test_a_cancelled_goto_is_not_sent_again_after_hold(radio, place):
    target = place(100.0, 50.0, 60.0)
    async with MavsdkAdapter(radio.emitted_by_mavsdk) as radio.adapter:
        await radio.until_discovered()
        held_s = await goto_then_cancel_then_hold(radio, target)
    before = [at for at in radio.repositions_sent if at < held_s]
    assert len(before) == 1, "the granted command itself must have left"
    assert [at for at in radio.repositions_emitted if at > held_s] != [], "MAVSDK must have tried again"
    assert [at for at in radio.repositions_sent if at > held_s] == []
    assert radio.refused.count("no_grant") >= 2
    assert radio.vehicle.custom_mode == BRAKE
    assert radio.refused.count("second_heartbeat") + radio.refused.count("no_grant") == len(radio.refused)


async def test_without_the_guard_the_held_vehicle_would_fly_on(radio, place):
    """The reason for the guard, shown on the same radio with its verdict ignored."""
    radio.guarded = False
    async with MavsdkAdapter(radio.emitted_by_mavsdk) as radio.adapter:
        await radio.until_discovered()
        held_s = await goto_then_cancel_then_hold(radio, place(100.0, 50.0, 60.0))
    assert [at for at in radio.repositions_sent if at > held_s] != []


async def test_a_granted_goto_is_acknowledged_and_flown(radio, place):
    radio.lose_acknowledgements = False
    target = place(100.0, 50.0, 60.0)
    async with MavsdkAdapter(radio.emitted_by_mavsdk) as radio.adapter:
        await radio.until_discovered()
        radio.desk.grants.issue("c1", 1, MAV_CMD_DO_REPOSITION, target, radio.now_ns())
        flight = asyncio.create_task(radio.adapter.goto_location(1, target))
        await radio.fly(3.0)
        await asyncio.wait_for(flight, 1.0)
    assert len(radio.repositions_sent) == 1
    east, north, _ = radio.vehicle.flight.position_enu_m
    assert math.hypot(east - 100.0, north - 50.0) < math.hypot(100.0, 50.0) - 2.0


async def test_without_a_grant_nothing_moves(radio, place):
    async with MavsdkAdapter(radio.emitted_by_mavsdk) as radio.adapter:
        await radio.until_discovered()
        flight = asyncio.create_task(radio.adapter.goto_location(1, place(100.0, 50.0, 60.0)))
        await radio.fly(2.5)
        with pytest.raises(PeerError, match="vehicle 1 did not take the place"):
            await asyncio.wait_for(flight, 3.0)
    assert radio.repositions_sent == []
    assert radio.repositions_emitted != []


async def test_a_vehicle_that_it_has_never_heard_is_a_peer_error(radio):
    async with MavsdkAdapter(radio.emitted_by_mavsdk) as radio.adapter:
        with pytest.raises(PeerError, match="has not heard vehicle 7"):
            await radio.adapter.goto_location(7, Geodetic(-35.0, 149.0, 600.0))
