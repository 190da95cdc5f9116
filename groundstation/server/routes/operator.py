"""POST routes: an operator's actions. Each is checked against the picture, then handed on.

Rule: a confirmation is bound to the vehicle that the operator saw; anything else is a
conflict. A hold needs no picture: it is handed on whatever is known.
"""

from __future__ import annotations

from http import HTTPStatus

from fastapi import APIRouter

from groundstation.server.actions import ActionResult
from groundstation.server.problems import ProblemError
from groundstation.server.rest import ActionAnswer, ConfirmBody, JoinBody
from groundstation.server.routes.common import (
    ActionsDep,
    BeaconPath,
    HubDep,
    ProposalPath,
    VehiclePath,
    WhoDep,
    problems,
)
from groundstation.server.wire import TargetRow

router = APIRouter(prefix="/api/v1", tags=["actions"])


def _answer(result: ActionResult) -> ActionAnswer:
    if not result.accepted:
        raise ProblemError(HTTPStatus.CONFLICT, "refused", result.text)
    return ActionAnswer(accepted=True, text=result.text, command_ids=list(result.command_ids))


def _gone(proposal_id: str) -> ProblemError:
    return ProblemError(
        HTTPStatus.NOT_FOUND,
        "unknown-proposal",
        f"proposal {proposal_id} is not open (confirmed, dismissed, expired or replaced)",
    )


@router.post(
    "/proposals/{proposal_id}/confirm", status_code=202, responses=problems(400, 403, 404, 409, 413, 422, 503)
)
async def confirm(
    proposal_id: ProposalPath, body: ConfirmBody, hub: HubDep, actions: ActionsDep, who: WhoDep
) -> ActionAnswer:
    """Fly a proposal with the vehicle it is for."""
    proposal = hub.picture.proposals.get(proposal_id)
    if proposal is None:
        raise _gone(proposal_id)
    if proposal.vehicle_id != body.vehicle_id:
        raise ProblemError(
            HTTPStatus.CONFLICT,
            "vehicle-mismatch",
            f"proposal {proposal_id} is for vehicle {proposal.vehicle_id}, not {body.vehicle_id}; "
            "nothing was sent",
        )
    return _answer(await actions.confirm(proposal_id, body.vehicle_id, who))


@router.post(
    "/proposals/{proposal_id}/dismiss", status_code=202, responses=problems(403, 404, 409, 413, 422, 503)
)
async def dismiss(proposal_id: ProposalPath, hub: HubDep, actions: ActionsDep, who: WhoDep) -> ActionAnswer:
    """Drop a proposal."""
    if proposal_id not in hub.picture.proposals:
        raise _gone(proposal_id)
    return _answer(await actions.dismiss(proposal_id, who))


@router.post("/vehicles/{vehicle_id}/hold", status_code=202, responses=problems(403, 404, 409, 413, 422, 503))
async def hold(vehicle_id: VehiclePath, actions: ActionsDep, who: WhoDep) -> ActionAnswer:
    """Hold one vehicle where it is."""
    return _answer(await actions.hold(vehicle_id, who))


@router.post("/hold-all", status_code=202, responses=problems(403, 409, 413, 503))
async def hold_all(actions: ActionsDep, who: WhoDep) -> ActionAnswer:
    """Hold every vehicle where it is."""
    return _answer(await actions.hold_all(who))


def _known(hub: HubDep, beacon_id: str) -> TargetRow:
    row = hub.picture.targets.row(int(beacon_id))
    if row is None:
        raise ProblemError(
            HTTPStatus.NOT_FOUND, "unknown-beacon", f"beacon {beacon_id} was never heard in this session"
        )
    return row


@router.post(
    "/targets/{beacon_id}/join", status_code=202, responses=problems(400, 403, 404, 409, 413, 422, 503)
)
async def join(
    beacon_id: BeaconPath, body: JoinBody, hub: HubDep, actions: ActionsDep, who: WhoDep
) -> ActionAnswer:
    """Say that this id is another one's (a phone that changed its address); can be taken back."""
    row, into = _known(hub, beacon_id), _known(hub, body.into_beacon_id)
    root = into.joined_into or into.beacon_id
    if row.joined_into is not None:
        raise ProblemError(
            HTTPStatus.CONFLICT,
            "joined-already",
            f"beacon {row.beacon_id} is joined into {row.joined_into} already; separate it first",
        )
    if root == row.beacon_id:
        raise ProblemError(
            HTTPStatus.CONFLICT,
            "joined-already",
            f"beacon {row.beacon_id} and beacon {into.beacon_id} are one already",
        )
    return _answer(await actions.join(int(row.beacon_id), int(root), who))


@router.post(
    "/targets/{beacon_id}/separate", status_code=202, responses=problems(403, 404, 409, 413, 422, 503)
)
async def separate(beacon_id: BeaconPath, hub: HubDep, actions: ActionsDep, who: WhoDep) -> ActionAnswer:
    """Take a join back: this id stands for itself again."""
    row = _known(hub, beacon_id)
    if row.joined_into is None:
        raise ProblemError(
            HTTPStatus.CONFLICT, "not-joined", f"beacon {row.beacon_id} is not joined into another"
        )
    return _answer(await actions.separate(int(row.beacon_id), who))
