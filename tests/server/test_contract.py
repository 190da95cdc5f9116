"""Schemathesis over the whole API: what the schema promises holds for inputs nobody thought of."""

from __future__ import annotations

from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, settings

from groundstation.domain.command import Proposal
from groundstation.domain.geometry import Geodetic
from groundstation.server.actions import ActionResult, Sources
from groundstation.server.app import create_app
from groundstation.server.hub import Hub
from groundstation.server.picture import Picture
from groundstation.server.settings import ServerSettings


class _Willing:
    async def confirm(self, proposal_id: str, vehicle_id: int, who: str) -> ActionResult:
        assert (proposal_id, vehicle_id) == ("p-1", 3), "only the open proposal with its vehicle passes"
        return ActionResult(True, "done")

    async def dismiss(self, proposal_id: str, who: str) -> ActionResult:
        return ActionResult(True, "done")

    async def hold(self, vehicle_id: int, who: str) -> ActionResult:
        assert type(vehicle_id) is int
        assert 1 <= vehicle_id <= 255
        return ActionResult(True, "done")

    async def hold_all(self, who: str) -> ActionResult:
        return ActionResult(True, "done")

    async def join(self, beacon_id: int, into_beacon_id: int, who: str) -> ActionResult:
        raise AssertionError("no beacon was heard: nothing can be joined")

    async def separate(self, beacon_id: int, who: str) -> ActionResult:
        raise AssertionError("no beacon was heard: nothing can be separated")


def _app() -> Any:
    hub = Hub(Picture("e", ServerSettings(allowed_hosts=("testserver",))), lambda: 5)
    hub.apply(Proposal("p-1", 3, 7, Geodetic(1.0, 2.0, 3.0), 50.0, "why", 1, 9, 1, 1))
    return create_app(hub, _Willing(), Sources(), page_directory=None)


schema = schemathesis.openapi.from_asgi("/openapi.json", _app())


@schema.parametrize()
@settings(max_examples=15, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@pytest.mark.timeout(60)
def test_the_api_keeps_its_schema(case: schemathesis.Case) -> None:
    case.call_and_validate()
