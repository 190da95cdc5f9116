"""POST routes: what reaches the desk and what does not."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from groundstation.domain.errors import InternalError, PeerError, ResourceError
from groundstation.domain.target import TargetJoined
from groundstation.server.actions import ActionResult
from groundstation.server.hub import Hub

WHO = "page@127.0.0.1"


async def test_a_confirmation_reaches_the_desk_with_its_vehicle(
    client: httpx.AsyncClient, hub: Hub, actions: Any, make: Any
) -> None:
    hub.apply(make.proposal("p-1", 3))
    answer = await client.post("/api/v1/proposals/p-1/confirm", json={"vehicle_id": 3})
    assert answer.status_code == 202
    assert answer.json() == {"accepted": True, "text": "done", "command_ids": ["c-1"]}
    assert actions.taken == [("confirm", "p-1", 3, WHO)]


async def test_the_wrong_vehicle_is_a_conflict_and_nothing_is_sent(
    client: httpx.AsyncClient, hub: Hub, actions: Any, make: Any
) -> None:
    hub.apply(make.proposal("p-1", 3))
    answer = await client.post("/api/v1/proposals/p-1/confirm", json={"vehicle_id": 4})
    assert answer.status_code == 409
    assert "is for vehicle 3, not 4" in answer.json()["detail"]
    assert actions.taken == []


async def test_a_proposal_that_is_not_open_cannot_be_confirmed(
    client: httpx.AsyncClient, actions: Any
) -> None:
    for action, body in (("confirm", {"vehicle_id": 3}), ("dismiss", None)):
        answer = await client.post(f"/api/v1/proposals/p-9/{action}", json=body)
        assert answer.status_code == 404
        assert "p-9 is not open" in answer.json()["detail"]
    assert actions.taken == []


@pytest.mark.parametrize(
    "body",
    [
        b"", b"{", b"[]", b"null", b"{}", b'{"vehicle_id": false}', b'{"vehicle_id": "3"}',
        b'{"vehicle_id": 3.0001}', b'{"vehicle_id": 0}', b'{"vehicle_id": 256}', b'{"vehicle_id": null}',
        b'{"vehicle_id": 3, "alt_m": false}', b'{"vehicle_id": NaN}',
    ],
)  # fmt: skip
async def test_a_lax_body_is_refused(
    client: httpx.AsyncClient, hub: Hub, actions: Any, make: Any, body: bytes
) -> None:
    hub.apply(make.proposal("p-1", 3))
    headers = {"content-type": "application/json"}
    answer = await client.post("/api/v1/proposals/p-1/confirm", content=body, headers=headers)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert "\n" not in answer.json()["detail"]
    assert actions.taken == []


async def test_holds_need_no_knowledge_of_the_vehicle(client: httpx.AsyncClient, actions: Any) -> None:
    assert (await client.post("/api/v1/vehicles/9/hold")).status_code == 202
    assert (await client.post("/api/v1/hold-all")).status_code == 202
    assert actions.taken == [("hold", 9, WHO), ("hold_all", WHO)]
    assert (await client.post("/api/v1/vehicles/256/hold")).status_code == 422


async def test_what_the_station_refuses_is_a_conflict_with_its_reason(
    client: httpx.AsyncClient, hub: Hub, actions: Any, make: Any
) -> None:
    hub.apply(make.proposal("p-1", 3))
    actions.result = ActionResult(False, "leaves the fence by 12 m")
    answer = await client.post("/api/v1/proposals/p-1/confirm", json={"vehicle_id": 3})
    assert (answer.status_code, answer.json()["detail"]) == (409, "leaves the fence by 12 m")


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (PeerError("vehicle 3 is lost"), 409, "vehicle 3 is lost"),
        (ResourceError("the journal is full"), 503, "the journal is full"),
        (InternalError("seq went\nbackwards"), 500, "seq went backwards"),
        (KeyError("secret"), 500, "internal fault (KeyError)"),
    ],
)
async def test_a_fault_is_one_line_and_no_traceback(
    client: httpx.AsyncClient, actions: Any, error: Exception, status: int, words: str
) -> None:
    async def broken(who: str) -> ActionResult:
        raise error

    actions.hold_all = broken
    answer = await client.post("/api/v1/hold-all")
    assert answer.status_code == status
    assert words in answer.json()["detail"]
    assert "Traceback" not in answer.text
    assert "secret" not in answer.text


async def test_a_body_too_large_is_refused(client: httpx.AsyncClient, hub: Hub, make: Any) -> None:
    hub.apply(make.proposal("p-1", 3))
    path = "/api/v1/proposals/p-1/confirm"
    assert (await client.post(path, content=b"x" * 70_000)).status_code == 413

    async def chunks() -> Any:
        for _ in range(70):
            yield b" " * 1000

    assert (await client.post(path, content=chunks())).status_code == 413


async def test_a_body_that_is_no_text_is_refused_in_one_line(
    client: httpx.AsyncClient, hub: Hub, actions: Any, make: Any
) -> None:
    hub.apply(make.proposal())
    headers = {"content-type": "application/json"}
    answer = await client.post("/api/v1/proposals/p-1/confirm", content=b"\xa9", headers=headers)
    assert answer.status_code == 400
    assert answer.headers["content-type"] == "application/problem+json"
    assert actions.taken == []


async def test_two_ids_are_joined_and_separated(
    client: httpx.AsyncClient, hub: Hub, actions: Any, make: Any
) -> None:
    for beacon_id in (7, 8, 9):
        hub.apply(make.target(beacon_id))
    answer = await client.post("/api/v1/targets/8/join", json={"into_beacon_id": "7"})
    assert answer.status_code == 202
    hub.apply(TargetJoined(8, 5, 3, 4, 7))
    # Into one that is joined itself means into the one that it is joined into.
    assert (await client.post("/api/v1/targets/9/join", json={"into_beacon_id": "8"})).status_code == 202
    assert (await client.post("/api/v1/targets/8/separate")).status_code == 202
    assert actions.taken == [("join", 8, 7, WHO), ("join", 9, 7, WHO), ("separate", 8, WHO)]


@pytest.mark.parametrize(
    ("path", "into", "status", "words"),
    [
        ("7/join", "7", 409, "are one already"),
        ("7/join", "8", 409, "are one already"),
        ("8/join", "9", 409, "joined into 7 already"),
        ("7/join", "5", 404, "beacon 5 was never heard"),
        ("5/join", "7", 404, "beacon 5 was never heard"),
        ("7/join", "seven", 422, "into_beacon_id"),
        ("7/separate", None, 409, "not joined"),
        ("5/separate", None, 404, "never heard"),
    ],
)
async def test_what_cannot_be_joined_says_why(
    client: httpx.AsyncClient, hub: Hub, actions: Any, make: Any,
    path: str, into: str | None, status: int, words: str,
) -> None:  # fmt: skip
    hub.apply(make.target(7))
    hub.apply(make.target(9))
    hub.apply(TargetJoined(8, 5, 3, 4, 7))
    body = None if into is None else {"into_beacon_id": into}
    answer = await client.post(f"/api/v1/targets/{path}", json=body)
    assert answer.status_code == status
    assert words in answer.json()["detail"]
    assert actions.taken == []
