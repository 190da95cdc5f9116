"""The command desk: who may move a vehicle, when, and how it ended.

A state machine over the journal's records: the same records give the same outputs. The
rules it keeps:

- a vehicle is sent somewhere only on an operator's confirmation that names proposal and
  vehicle, after the gate has been asked again with the poses of this moment;
- a hold works always, at once, without a fence; it revokes grants before anything else;
- after a restart or resume there is no grant, no command under way and no proposal.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import TypeAdapter

from groundstation.command import outgoing
from groundstation.command.outputs import DeskOutput, SendFrame
from groundstation.command.protocol import HoldRun, RepositionRun, Run, Step
from groundstation.command.settings import CommandSettings
from groundstation.command.under_way import UnderWay, event_of, status_of
from groundstation.domain.command import CommandKind, CommandPhase, Proposal, ProposalGone
from groundstation.domain.events import Counter, Severity
from groundstation.domain.geometry import Geodetic
from groundstation.domain.inputs import (
    Decision,
    MissionInput,
    OperatorInput,
    PlanInput,
    Record,
    SessionInput,
    TickInput,
)
from groundstation.domain.mission import Mission
from groundstation.domain.target import TargetState
from groundstation.domain.vehicle import AUTOPILOT_COMPONENT, Autopilot, VehicleState
from groundstation.guidance.plan import PlanRequest
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.messages import CommandAck, Heartbeat
from groundstation.mavlink.vehicle_message import VehicleMessage
from groundstation.safety.gate import Airspace, leg_refusals
from groundstation.safety.grants import Grants
from groundstation.safety.guard import Guard
from groundstation.safety.modes import REPOSITION_MODES, Airframe, airframe_of, hold_modes
from groundstation.safety.settings import SafetySettings

_MISSION = TypeAdapter(Mission)
_PROPOSALS = TypeAdapter(tuple[Proposal, ...])
_UNFINISHED = frozenset({CommandPhase.GATED, CommandPhase.SENT, CommandPhase.ACCEPTED, CommandPhase.FLYING})


class CommandDesk:
    """Keeps proposals, grants and commands; owns the guard that watches all that leaves."""

    def __init__(
        self,
        settings: CommandSettings | None = None,
        safety: SafetySettings | None = None,
        *,
        forward_commands: bool = False,
        replay: bool = False,
    ) -> None:
        self.settings = settings or CommandSettings()
        self.safety = safety or SafetySettings()
        self.grants = Grants(self.safety)
        self.guard = Guard(self.grants, forward_commands=forward_commands, replay=replay)
        self.mission = Mission()
        self._encoder = Encoder(self.settings.system_id, self.settings.component_id)
        self._vehicles: dict[int, VehicleState] = {}
        self._airframes: dict[int, Airframe] = {}
        self._proposals: dict[str, Proposal] = {}
        self._commands: dict[int, UnderWay] = {}
        self._going_to: dict[int, Geodetic] = {}
        self._command_count = 0
        self._counts: dict[tuple[str, str], int] = {}

    def handle(self, record: Record, ingest_outputs: Iterable[object]) -> list[DeskOutput]:
        """One record of the journal and what ingest made of it."""
        outputs: list[DeskOutput] = []
        now = record.time_ns
        for item in ingest_outputs:
            if isinstance(item, VehicleState):
                outputs += self._on_state(item, now)
            elif isinstance(item, VehicleMessage) and item.component_id == AUTOPILOT_COMPONENT:
                outputs += self._on_message(item, now)
        match record.input:
            case OperatorInput() as action:
                outputs += self._on_operator(action, now)
            case TickInput():
                outputs += self._on_tick(now)
            case PlanInput() as plan:
                outputs += self._on_plan(plan, now)
            case MissionInput(mission=mission):
                self.mission = mission
                outputs += self._withdraw_all("the mission was changed", now)
            case SessionInput(event="resumed"):
                outputs += self._on_resumed(now)
        return outputs

    def plan_request(self, time_ns: int, targets: Iterable[TargetState]) -> PlanRequest:
        """What a planner needs to know now. Changes nothing."""
        return PlanRequest(
            time_ns=time_ns,
            mission=self.mission,
            vehicles=tuple(self._vehicles[vehicle_id] for vehicle_id in sorted(self._vehicles)),
            targets=tuple(targets),
            going_to=tuple(sorted(self._going_to.items())),
            outstanding=tuple(self._proposals.values()),
        )

    def counters(self) -> list[Counter]:
        """Totals of proposals and commands by outcome, and the guard's."""
        own = [Counter(name, (("outcome", key),), n) for (name, key), n in sorted(self._counts.items())]
        grants = [
            Counter("grants_total", (("outcome", "issued"),), self.grants.issued_total),
            Counter("grants_total", (("outcome", "revoked"),), self.grants.revoked_total),
        ]
        return own + grants + self.guard.counters()

    def state(self) -> dict[str, Any]:
        """What outlives a restart: never grants nor commands under way."""
        return {
            "version": 1,
            "mission": _MISSION.dump_python(self.mission, mode="json"),
            "proposals": _PROPOSALS.dump_python(tuple(self._proposals.values()), mode="json"),
            "command_count": self._command_count,
            "counts": [[name, key, count] for (name, key), count in sorted(self._counts.items())],
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Takes back what ``state`` gave."""
        self._on_restart()
        self.mission = _MISSION.validate_python(state["mission"])
        self._proposals = {p.proposal_id: p for p in _PROPOSALS.validate_python(state["proposals"])}
        self._command_count = int(state["command_count"])
        self._counts = {(name, key): int(count) for name, key, count in state["counts"]}

    # -- what vehicles say -------------------------------------------------------------

    def _on_state(self, state: VehicleState, now: int) -> list[DeskOutput]:
        self._vehicles[state.vehicle_id] = state
        self._note_kind(state.vehicle_id)
        command = self._commands.get(state.vehicle_id)
        if command is not None:
            return self._advance(command, command.run.on_state(state, now), now)
        if state.mode not in REPOSITION_MODES[state.autopilot]:
            # Somebody else flies it now: our old target means nothing any more.
            self._going_to.pop(state.vehicle_id, None)
        return []

    def _on_message(self, item: VehicleMessage, now: int) -> list[DeskOutput]:
        if isinstance(item.message, Heartbeat):
            self._airframes[item.vehicle_id] = airframe_of(item.message.vehicle_type)
            self._note_kind(item.vehicle_id)
        command = self._commands.get(item.vehicle_id)
        if command is None or not isinstance(item.message, CommandAck):
            return []
        # Another ground station's acknowledgement must not pass for ours.
        if item.message.target_system not in (0, self.settings.system_id):
            return []
        if item.message.target_component not in (0, self.settings.component_id):
            return []
        return self._advance(command, command.run.on_ack(item.message, now), now)

    def _note_kind(self, vehicle_id: int) -> None:
        self.guard.note_vehicle(vehicle_id, *self._kind(vehicle_id))

    def _kind(self, vehicle_id: int) -> tuple[Autopilot, Airframe]:
        state = self._vehicles.get(vehicle_id)
        autopilot = state.autopilot if state else Autopilot.UNKNOWN
        return autopilot, self._airframes.get(vehicle_id, Airframe.OTHER)

    # -- what the operator does --------------------------------------------------------

    def _on_operator(self, action: OperatorInput, now: int) -> list[DeskOutput]:
        match action.decision:
            case Decision.HOLD_ALL:
                vehicle_ids = sorted(self._vehicles)
                for vehicle_id in vehicle_ids:
                    self.grants.hold(vehicle_id, now)
                outputs: list[DeskOutput] = []
                for vehicle_id in vehicle_ids:
                    outputs += self._hold(vehicle_id, action.who, now)
                nothing = event_of(now, "command.nothing_to_hold", Severity.WARNING, "no vehicle is known")
                return outputs or [nothing]
            case Decision.HOLD if action.vehicle_id is not None:
                return self._hold(action.vehicle_id, action.who, now)
            case Decision.DISMISS if action.proposal_id in self._proposals:
                return [self._withdraw(action.proposal_id, "dismissed", now)]
            case Decision.CONFIRM:
                return self._confirm(action, now)
        text = f"{action.decision.value} by {action.who} names no known vehicle or proposal: nothing done"
        return [event_of(now, "operator.incomplete", Severity.WARNING, text)]

    def _confirm(self, action: OperatorInput, now: int) -> list[DeskOutput]:
        proposal = self._proposals.get(action.proposal_id or "")
        if proposal is None:
            self._count("confirmations_total", "unknown")
            text = f"proposal {action.proposal_id} cannot be confirmed any more: it is gone"
            return [event_of(now, "confirm.unknown", Severity.WARNING, text, action.vehicle_id)]
        if action.vehicle_id != proposal.vehicle_id:
            self._count("confirmations_total", "mismatch")
            text = (
                f"the confirmation names vehicle {action.vehicle_id}, the proposal is for "
                f"{proposal.vehicle_id}: nothing was sent"
            )
            return [event_of(now, "confirm.mismatch", Severity.ERROR, text, proposal.vehicle_id)]
        if now >= proposal.expires_ns or proposal.mission_revision != self.mission.revision:
            self._count("confirmations_total", "expired")
            gone = self._withdraw(proposal.proposal_id, "expired", now)
            text = f"the proposal for vehicle {proposal.vehicle_id} had expired: nothing was sent"
            return [gone, event_of(now, "confirm.expired", Severity.WARNING, text, proposal.vehicle_id)]
        return self._send_to(proposal, action.who, now)

    def _send_to(self, proposal: Proposal, who: str, now: int) -> list[DeskOutput]:
        vehicle_id, target = proposal.vehicle_id, proposal.position
        airspace = Airspace(now, self.mission, self._vehicles, self._going_to)
        refusals = leg_refusals(vehicle_id, target, airspace, self.safety)
        state = self._vehicles.get(vehicle_id)
        autopilot = state.autopilot if state else Autopilot.UNKNOWN
        run = RepositionRun(vehicle_id, target, autopilot, self.settings)
        command = self._new_command(vehicle_id, CommandKind.REPOSITION, run, target, proposal.proposal_id)
        reasons = [refusal.text for refusal in refusals]
        if self._hold_under_way(vehicle_id):
            reasons.append(f"a hold of vehicle {vehicle_id} is still being verified")
        if reasons:
            self._count("confirmations_total", "refused")
            self._count("commands_total", CommandPhase.REFUSED.value)
            detail = "; ".join(reasons)
            text = f"vehicle {vehicle_id} was not sent: {detail}"
            # The proposal stays: what was against it may pass before it expires.
            return [
                status_of(command, CommandPhase.REFUSED, detail, now),
                event_of(now, "confirm.refused", Severity.WARNING, text, vehicle_id),
            ]
        self._count("confirmations_total", "sent")
        outputs = self._end_older(vehicle_id, CommandPhase.SUPERSEDED, "a newer command took its place", now)
        self.grants.issue(command.command_id, vehicle_id, outgoing.MAV_CMD_DO_REPOSITION, target, now)
        self._commands[vehicle_id] = command
        command.before = self._going_to.get(vehicle_id)
        self._going_to[vehicle_id] = target
        outputs.append(self._withdraw(proposal.proposal_id, "confirmed", now))
        outputs.append(status_of(command, CommandPhase.GATED, f"confirmed by {who}", now))
        return outputs + self._advance(command, run.start(now), now)

    def _hold_under_way(self, vehicle_id: int) -> bool:
        command = self._commands.get(vehicle_id)
        return command is not None and command.kind is CommandKind.HOLD and command.run.phase in _UNFINISHED

    def _hold(self, vehicle_id: int, who: str, now: int) -> list[DeskOutput]:
        self.grants.hold(vehicle_id, now)
        again = self._hold_under_way(vehicle_id)
        ended = CommandPhase.SUPERSEDED if again else CommandPhase.REVOKED
        outputs = self._end_older(vehicle_id, ended, f"held by {who}", now)
        outputs += self._withdraw_of(vehicle_id, "the vehicle was held", now)
        run = HoldRun(vehicle_id, hold_modes(*self._kind(vehicle_id)), self.settings)
        command = self._new_command(vehicle_id, CommandKind.HOLD, run, None, None)
        self._commands[vehicle_id] = command
        # First of all outputs: the frame.
        return self._advance(command, run.start(now), now) + outputs

    # -- plans, time, restarts ---------------------------------------------------------

    def _on_plan(self, plan: PlanInput, now: int) -> list[DeskOutput]:
        outputs: list[DeskOutput] = []
        if plan.mission_revision != self.mission.revision:
            self._count("proposals_total", "outdated")
            return []
        for proposal in plan.proposals:
            if proposal.vehicle_id not in self._vehicles or now >= proposal.expires_ns:
                self._count("proposals_total", "outdated")
                continue
            outputs += self._withdraw_of(proposal.vehicle_id, "replaced", now)
            self._proposals[proposal.proposal_id] = proposal
            self._count("proposals_total", "offered")
            outputs.append(proposal)
        return outputs

    def _on_tick(self, now: int) -> list[DeskOutput]:
        late = [p.proposal_id for p in self._proposals.values() if now >= p.expires_ns]
        outputs: list[DeskOutput] = [self._withdraw(proposal_id, "expired", now) for proposal_id in late]
        for vehicle_id in sorted(self._commands):
            command = self._commands[vehicle_id]
            outputs += self._advance(command, command.run.on_tick(now), now)
        return outputs

    def _on_resumed(self, now: int) -> list[DeskOutput]:
        outputs: list[DeskOutput] = []
        for vehicle_id in sorted(self._commands):
            outputs += self._end_older(vehicle_id, CommandPhase.REVOKED, "the station was restarted", now)
        outputs += self._withdraw_all("the station was restarted", now)
        self._on_restart()
        return outputs

    def _on_restart(self) -> None:
        self.grants.forget_all()
        self._vehicles.clear()
        self._airframes.clear()
        self._proposals.clear()
        self._commands.clear()
        self._going_to.clear()

    # -- a command's steps -------------------------------------------------------------

    def _new_command(
        self, vehicle_id: int, kind: CommandKind, run: Run, target: Geodetic | None, proposal_id: str | None
    ) -> UnderWay:
        self._command_count += 1
        return UnderWay(f"c{self._command_count}", vehicle_id, kind, run, target, proposal_id)

    def _advance(self, command: UnderWay, steps: list[Step], now: int) -> list[DeskOutput]:
        outputs: list[DeskOutput] = []
        for step in steps:
            if step.message is not None:
                outputs.append(SendFrame(command.vehicle_id, self._encoder.pack(step.message)))
            if step.phase is not None:
                outputs.append(status_of(command, step.phase, step.detail, now))
                outputs += self._on_phase(command, step, now)
        if command.run.done and self._commands.get(command.vehicle_id) is command:
            del self._commands[command.vehicle_id]
        return outputs

    def _on_phase(self, command: UnderWay, step: Step, now: int) -> list[DeskOutput]:
        assert step.phase is not None
        vehicle_id = command.vehicle_id
        if step.phase is not CommandPhase.SENT and command.kind is CommandKind.REPOSITION:
            # Acknowledged or over: nothing more has to leave for it.
            self.grants.revoke(vehicle_id)
        # A command that timed out may still be flown: its target stays taken until a hold.
        if step.phase is CommandPhase.HOLDING or (
            command.kind is CommandKind.REPOSITION and step.phase is CommandPhase.SUPERSEDED
        ):
            self._going_to.pop(vehicle_id, None)
        if command.kind is CommandKind.REPOSITION and step.phase is CommandPhase.REFUSED:
            self._going_to.pop(vehicle_id, None)
            if command.before is not None:
                # It did not take the new target and flies on to the old one.
                self._going_to[vehicle_id] = command.before
        if step.phase in _UNFINISHED:
            return []
        self._count("commands_total", step.phase.value)
        if step.phase in (CommandPhase.ARRIVED, CommandPhase.HOLDING):
            return []
        severity = Severity.ERROR if command.kind is CommandKind.HOLD else Severity.WARNING
        phase = step.phase.value.replace("_", " ")
        text = f"{command.kind.value} of vehicle {vehicle_id} {phase}: {step.detail}"
        return [event_of(now, f"command.{step.phase.value}", severity, text, vehicle_id)]

    def _end_older(self, vehicle_id: int, phase: CommandPhase, detail: str, now: int) -> list[DeskOutput]:
        older = self._commands.pop(vehicle_id, None)
        self.grants.revoke(vehicle_id)
        if older is None or older.run.phase not in _UNFINISHED:
            return []
        self._count("commands_total", phase.value)
        return [status_of(older, phase, detail, now)]

    def _withdraw(self, proposal_id: str, reason: str, now: int) -> ProposalGone:
        del self._proposals[proposal_id]
        self._count("proposals_total", reason if reason in _OUTCOMES else "withdrawn")
        return ProposalGone(proposal_id, now, reason)

    def _withdraw_of(self, vehicle_id: int, reason: str, now: int) -> list[DeskOutput]:
        own = [p.proposal_id for p in self._proposals.values() if p.vehicle_id == vehicle_id]
        return [self._withdraw(proposal_id, reason, now) for proposal_id in own]

    def _withdraw_all(self, reason: str, now: int) -> list[DeskOutput]:
        return [self._withdraw(proposal_id, reason, now) for proposal_id in list(self._proposals)]

    def _count(self, name: str, key: str) -> None:
        self._counts[name, key] = self._counts.get((name, key), 0) + 1


_OUTCOMES = frozenset({"confirmed", "dismissed", "expired", "replaced"})
