"""What all routes share: how they reach the hub, and the problems they document."""

from __future__ import annotations

from typing import Annotated, Any, cast

from fastapi import Depends, Path, Request

from groundstation.server.actions import Actions, Sources
from groundstation.server.hub import Hub
from groundstation.server.problems import MEDIA_TYPE
from groundstation.server.rest import Problem


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """OpenAPI entries of the problem documents that a route may answer with."""
    schema = {"$ref": "#/components/schemas/Problem"}
    return {
        status: {
            "description": "Refused; ``detail`` says why in one line.",
            "model": Problem,
            "content": {MEDIA_TYPE: {"schema": schema}},
        }
        for status in statuses
    }


def get_hub(request: Request) -> Hub:
    """The hub of this app."""
    return cast(Hub, request.app.state.hub)


def get_actions(request: Request) -> Actions:
    """The station's actions."""
    return cast(Actions, request.app.state.actions)


def get_sources(request: Request) -> Sources:
    """What other rooms know."""
    return cast(Sources, request.app.state.sources)


def get_who(request: Request) -> str:
    """Who acts, for the journal."""
    return f"page@{request.client.host}" if request.client else "page"


HubDep = Annotated[Hub, Depends(get_hub)]
ActionsDep = Annotated[Actions, Depends(get_actions)]
SourcesDep = Annotated[Sources, Depends(get_sources)]
WhoDep = Annotated[str, Depends(get_who)]
BeaconPath = Annotated[str, Path(pattern=r"^[0-9]{1,20}$", description="Device id of the transmitter.")]
VehiclePath = Annotated[int, Path(ge=1, le=255, description="MAVLink system id.")]
ProposalPath = Annotated[str, Path(min_length=1, max_length=128, description="Id of the proposal.")]
