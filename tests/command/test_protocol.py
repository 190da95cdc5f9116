"""Acknowledge, retry, verify: each row of the protocol, and both ways to take half a command."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from groundstation.command.protocol import HoldRun, RepositionRun
from groundstation.command.settings import CommandSettings
from groundstation.domain.command import CommandPhase
from groundstation.domain.vehicle import Autopilot
from groundstation.mavlink.messages import CommandAck
from groundstation.safety.modes import Airframe, hold_modes

SETTINGS = CommandSettings()
SECOND = 10**9


def ack(command, result):
    return CommandAck(command=command, result=result, progress=None, target_system=255, target_component=190)


def phases(steps):
    return [step.phase for step in steps if step.phase is not None]


def messages(steps):
    return [step.message for step in steps if step.message is not None]


@pytest.fixture
def target(place):
    return place(100.0, 0.0, 60.0)


@pytest.fixture
def at(vehicle, now_ns):
    """The vehicle ``seconds`` after the start, at a place, with a fresh heartbeat."""

    def build(seconds, east=0.0, **changes):
        now = now_ns + round(seconds * SECOND)
        height = changes.pop("height", 50.0 + 10.0 * east / 100.0)
        return vehicle(
            1, (east, 0.0, height), time_ns=now, last_heartbeat_ns=now, position_time_ns=now, **changes
        )

    return build


class TestReposition:
    @pytest.fixture
    def run(self, target):
        return RepositionRun(1, target, Autopilot.ARDUPILOT, SETTINGS)

    def test_what_is_sent(self, run, target, now_ns):
        (message,) = messages(run.start(now_ns))
        assert message.get_type() == "COMMAND_INT"
        assert (message.target_system, message.target_component) == (1, 1)
        assert (message.command, message.frame, message.param2) == (192, 0, 1.0)
        assert message.x == round(target.latitude_deg * 1e7)
        assert message.y == round(target.longitude_deg * 1e7)
        assert message.z == pytest.approx(644.0)
        assert math.isnan(message.param4)

    def test_the_whole_life(self, run, at, now_ns, target):
        assert phases(run.start(now_ns)) == [CommandPhase.SENT]
        assert phases(run.on_ack(ack(192, 0), now_ns + SECOND // 5)) == [CommandPhase.ACCEPTED]
        told = at(1.0, 1.0, position_target=target)
        assert phases(run.on_state(told, told.time_ns)) == [CommandPhase.FLYING]
        near = at(12.0, 97.0)
        assert phases(run.on_state(near, near.time_ns)) == [CommandPhase.ARRIVED]
        assert run.done

    def test_without_an_acknowledgement_it_is_sent_three_times(self, run, now_ns):
        run.start(now_ns)
        sent = [
            (tick / 10, len(messages(run.on_tick(now_ns + tick * SECOND // 10)))) for tick in range(1, 60)
        ]
        assert [at_s for at_s, count in sent if count] == [1.0, 2.0]
        assert run.attempts == 3
        assert run.phase is CommandPhase.TIMED_OUT

    def test_a_lost_acknowledgement_does_not_matter_when_the_vehicle_says_where_it_goes(
        self, run, at, now_ns, target
    ):
        run.start(now_ns)
        told = at(1.5, 2.0, position_target=target)
        assert phases(run.on_state(told, told.time_ns)) == [CommandPhase.FLYING]
        assert messages(run.on_tick(now_ns + 2 * SECOND)) == []

    @pytest.mark.parametrize("result", [2, 3, 4, 6, 9, 77])
    def test_a_refusal_is_final(self, run, now_ns, result):
        run.start(now_ns)
        steps = run.on_ack(ack(192, result), now_ns + 1)
        assert phases(steps) == [CommandPhase.REFUSED]
        assert "answered" in steps[0].detail
        assert messages(run.on_tick(now_ns + 5 * SECOND)) == []

    def test_temporarily_rejected_is_tried_again(self, run, now_ns):
        run.start(now_ns)
        assert run.on_ack(ack(192, 1), now_ns + 1) == []
        assert len(messages(run.on_tick(now_ns + SECOND))) == 1
        assert phases(run.on_ack(ack(192, 0), now_ns + SECOND + 1)) == [CommandPhase.ACCEPTED]

    def test_in_progress_is_waited_for_without_repeating(self, run, now_ns):
        run.start(now_ns)
        assert run.on_ack(ack(192, 5), now_ns + 1) == []
        assert messages(run.on_tick(now_ns + 9 * SECOND)) == []
        assert phases(run.on_ack(ack(192, 0), now_ns + 9 * SECOND)) == [CommandPhase.ACCEPTED]

    def test_in_progress_for_ever_times_out(self, run, now_ns):
        run.start(now_ns)
        run.on_ack(ack(192, 5), now_ns)
        assert phases(run.on_tick(now_ns + 10 * SECOND)) == [CommandPhase.TIMED_OUT]

    def test_an_acknowledgement_of_something_else_is_not_ours(self, run, now_ns):
        run.start(now_ns)
        assert run.on_ack(ack(511, 0), now_ns + 1) == []
        assert run.phase is CommandPhase.SENT

    def test_the_mode_without_the_target_is_not_flying(self, run, at, now_ns, place):
        run.start(now_ns)
        run.on_ack(ack(192, 0), now_ns)
        stays = at(2.0, 0.0, position_target=place(0.0, 0.0, 50.0))
        assert run.on_state(stays, stays.time_ns) == []
        steps = run.on_tick(now_ns + 5 * SECOND)
        assert phases(steps) == [CommandPhase.TIMED_OUT]
        assert "mode and target" in steps[0].detail

    def test_the_target_without_the_mode_is_not_flying(self, run, at, now_ns, target):
        run.start(now_ns)
        run.on_ack(ack(192, 0), now_ns)
        loiters = at(2.0, 0.0, mode="LOITER", position_target=target)
        assert run.on_state(loiters, loiters.time_ns) == []
        assert phases(run.on_tick(now_ns + 5 * SECOND)) == [CommandPhase.TIMED_OUT]

    def test_a_mode_from_before_the_command_proves_nothing(self, run, at, now_ns, target):
        run.start(now_ns)
        run.on_ack(ack(192, 0), now_ns + SECOND // 5)
        old = replace(at(0.5, 0.0, position_target=target), last_heartbeat_ns=now_ns - 1)
        assert run.on_state(old, old.time_ns) == []

    def test_coming_nearer_proves_the_target_where_the_autopilot_does_not_say_it(self, run, at, now_ns):
        run.start(now_ns)
        first = at(0.1, 0.0)
        run.on_state(first, first.time_ns)
        run.on_ack(ack(192, 0), now_ns + SECOND // 5)
        slow = at(1.0, 3.0)
        assert run.on_state(slow, slow.time_ns) == []
        nearer = at(2.0, 7.0)
        assert phases(run.on_state(nearer, nearer.time_ns)) == [CommandPhase.FLYING]

    def test_a_pilot_or_fail_safe_that_takes_over_ends_it(self, run, at, now_ns, target):
        run.start(now_ns)
        told = at(1.0, 1.0, position_target=target)
        run.on_state(told, told.time_ns)
        home = at(5.0, 20.0, mode="RTL")
        steps = run.on_state(home, home.time_ns)
        assert phases(steps) == [CommandPhase.SUPERSEDED]
        assert "RTL" in steps[0].detail

    def test_a_flight_that_never_arrives_times_out(self, run, at, now_ns, target):
        run.start(now_ns)
        told = at(1.0, 0.0, position_target=target)
        run.on_state(told, told.time_ns)
        assert run.on_tick(now_ns + 100 * SECOND) == []
        assert phases(run.on_tick(now_ns + 140 * SECOND)) == [CommandPhase.TIMED_OUT]


class TestHold:
    @pytest.fixture
    def run(self):
        return HoldRun(1, hold_modes(Autopilot.ARDUPILOT, Airframe.COPTER), SETTINGS)

    def test_brakes_and_verifies_by_mode(self, run, at, now_ns):
        (message,) = messages(run.start(now_ns))
        assert (message.command, message.param1, message.param2) == (176, 1.0, 17.0)
        assert phases(run.on_ack(ack(176, 0), now_ns + 1)) == [CommandPhase.ACCEPTED]
        still = at(0.2, mode="GUIDED")
        assert run.on_state(still, still.time_ns) == []
        braking = at(1.2, mode="BRAKE")
        assert phases(run.on_state(braking, braking.time_ns)) == [CommandPhase.HOLDING]

    def test_loiters_where_brake_is_refused(self, run, now_ns):
        run.start(now_ns)
        (message,) = messages(run.on_ack(ack(176, 4), now_ns + 1))
        assert message.param2 == 5.0
        steps = run.on_ack(ack(176, 4), now_ns + 2)
        assert phases(steps) == [CommandPhase.REFUSED]

    def test_goes_on_until_verified_with_rising_confirmation(self, run, now_ns):
        sent = messages(run.start(now_ns))
        for tick in range(1, 200):
            sent += messages(run.on_tick(now_ns + tick * SECOND // 10))
        assert len(sent) == SETTINGS.hold_attempts
        assert [m.confirmation for m in sent] == list(range(SETTINGS.hold_attempts))
        assert {m.param2 for m in sent[:10]} == {17.0}
        assert {m.param2 for m in sent[10:]} == {5.0}
        assert run.phase is CommandPhase.TIMED_OUT

    def test_an_acknowledgement_alone_does_not_end_it(self, run, now_ns):
        run.start(now_ns)
        run.on_ack(ack(176, 0), now_ns + 1)
        assert len(messages(run.on_tick(now_ns + SECOND))) == 1

    def test_a_late_frame_that_moves_it_is_answered_by_another_hold(self, run, at, now_ns):
        run.start(now_ns)
        braking = at(1.0, mode="BRAKE")
        run.on_state(braking, braking.time_ns)
        assert not run.done
        strayed = at(2.0, mode="GUIDED")
        steps = run.on_state(strayed, strayed.time_ns)
        assert phases(steps) == [CommandPhase.SENT]
        assert len(messages(steps)) == 1
        again = at(3.0, mode="BRAKE")
        assert phases(run.on_state(again, again.time_ns)) == [CommandPhase.HOLDING]
        run.on_tick(again.time_ns + 6 * SECOND)
        assert run.done

    def test_px4_stops_in_place_and_must_have_stopped(self, at, now_ns):
        run = HoldRun(1, hold_modes(Autopilot.PX4, Airframe.COPTER), SETTINGS)
        (message,) = messages(run.start(now_ns))
        assert message.command == 192
        assert math.isnan(message.param5)
        assert math.isnan(message.param6)
        moving = at(0.2, mode="AUTO.LOITER", velocity_ned_m_s=(0.0, 8.0, 0.0))
        assert run.on_state(moving, moving.time_ns) == []
        stopped = at(0.4, mode="AUTO.LOITER", velocity_ned_m_s=(0.1, 0.2, 0.0))
        assert phases(run.on_state(stopped, stopped.time_ns)) == [CommandPhase.HOLDING]

    def test_px4_that_knows_no_stop_in_place_gets_its_mode(self, now_ns):
        run = HoldRun(1, hold_modes(Autopilot.PX4, Airframe.COPTER), SETTINGS)
        run.start(now_ns)
        (message,) = messages(run.on_ack(ack(192, 2), now_ns + 1))
        assert (message.command, message.param2, message.param3) == (176, 4.0, 3.0)

    def test_an_unknown_autopilot_is_paused(self, now_ns):
        run = HoldRun(1, (), SETTINGS)
        (message,) = messages(run.start(now_ns))
        assert (message.command, message.param1) == (193, 0.0)
        steps = run.on_ack(ack(193, 0), now_ns + 1)
        assert phases(steps) == [CommandPhase.HOLDING]
        assert "cannot be verified" in steps[0].detail
