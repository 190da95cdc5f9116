"""What the page may ask for, turned into inputs of the station.

The answer to the operator is read off what the command desk made of the input at once: a
refusal says why, an acceptance names the commands that began.
"""

from __future__ import annotations

from typing import Protocol

from groundstation.domain.command import CommandPhase, CommandStatus, ProposalGone
from groundstation.domain.events import Event
from groundstation.domain.inputs import AnyInput, Decision, JoinInput, OperatorInput
from groundstation.pipeline import Step
from groundstation.server.actions import ActionResult

_REFUSALS = frozenset({CommandPhase.REFUSED})


class Taker(Protocol):
    """The station, as far as an operator's action needs it."""

    def take(self, entry: AnyInput) -> Step:
        """Stamp, journal and handle one input."""
        ...


class OperatorActions:
    """Implements the server's ``Actions``."""

    def __init__(self, station: Taker) -> None:
        self._station = station

    async def confirm(self, proposal_id: str, vehicle_id: int, who: str) -> ActionResult:
        """Fly the proposal with this vehicle."""
        action = OperatorInput(who, Decision.CONFIRM, proposal_id=proposal_id, vehicle_id=vehicle_id)
        return self._result(self._station.take(action), f"vehicle {vehicle_id} is being sent")

    async def dismiss(self, proposal_id: str, who: str) -> ActionResult:
        """Drop the proposal."""
        step = self._station.take(OperatorInput(who, Decision.DISMISS, proposal_id=proposal_id))
        gone = any(isinstance(output, ProposalGone) for output in step.desk)
        return ActionResult(gone, "the proposal was dismissed" if gone else "the proposal is gone already")

    async def hold(self, vehicle_id: int, who: str) -> ActionResult:
        """Hold one vehicle now."""
        step = self._station.take(OperatorInput(who, Decision.HOLD, vehicle_id=vehicle_id))
        return self._result(step, f"vehicle {vehicle_id} is told to hold")

    async def hold_all(self, who: str) -> ActionResult:
        """Hold every vehicle now."""
        return self._result(
            self._station.take(OperatorInput(who, Decision.HOLD_ALL)), "all vehicles are told to hold"
        )

    async def join(self, beacon_id: int, into_beacon_id: int, who: str) -> ActionResult:
        """Take two ids for one transmitter."""
        self._station.take(JoinInput(who, beacon_id, into_beacon_id))
        return ActionResult(True, f"beacon {beacon_id} counts for beacon {into_beacon_id} from now on")

    async def separate(self, beacon_id: int, who: str) -> ActionResult:
        """Take a join back."""
        self._station.take(JoinInput(who, beacon_id, None))
        return ActionResult(True, f"beacon {beacon_id} stands for itself again")

    def _result(self, step: Step, text: str) -> ActionResult:
        statuses = [o for o in step.desk if isinstance(o, CommandStatus)]
        refused = [s.detail for s in statuses if s.phase in _REFUSALS]
        begun = tuple(dict.fromkeys(s.command_id for s in statuses if s.phase not in _REFUSALS))
        if begun and not refused:
            return ActionResult(True, text, begun)
        reasons = refused or [o.text for o in step.desk if isinstance(o, Event)]
        return ActionResult(False, "; ".join(reasons) or "nothing was done")
