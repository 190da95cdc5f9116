"""Who is let in: hosts against DNS rebinding, origins against foreign pages."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from groundstation.server.access import host_allowed, origin_allowed


@pytest.mark.parametrize(
    ("host", "allowed"),
    [
        ("localhost", True), ("localhost:8000", True), ("127.0.0.1:8000", True), ("[::1]:8000", True),
        ("192.168.1.7", True), ("station.lan:8000", True), ("STATION.lan", True),
        ("evil.example", False), ("127.0.0.1.evil.example", False), ("localhost.evil.example", False),
        ("", False), ("[::1", False), ("evil.example:80@localhost", True), ("localhost@evil.example", False),
    ],
)  # fmt: skip
def test_hosts(host: str, allowed: bool) -> None:
    assert host_allowed(host, ("station.lan",)) is allowed


@pytest.mark.parametrize(
    ("origin", "allowed"),
    [
        ("http://localhost:8000", True), ("https://localhost:8000", True), ("http://LOCALHOST:8000", True),
        ("http://localhost:9000", False), ("http://127.0.0.1:8000", False), ("null", False),
        ("https://evil.example", False), ("file://localhost:8000", False), ("http://[", False),
    ],
)  # fmt: skip
def test_origins(origin: str, allowed: bool) -> None:
    assert origin_allowed(origin, "localhost:8000") is allowed


@pytest.mark.parametrize(
    "headers",
    [
        {"host": "evil.example"},
        {"origin": "https://evil.example"},
        {"origin": "null"},
        {"origin": "http://localhost:9000"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
    ],
)
async def test_a_foreign_page_holds_nothing(
    client: httpx.AsyncClient, actions: Any, headers: dict[str, str]
) -> None:
    answer = await client.post("/api/v1/hold-all", headers=headers)
    assert answer.status_code == 403
    assert answer.headers["content-type"] == "application/problem+json"
    assert actions.taken == []


async def test_a_rebound_name_reads_nothing(client: httpx.AsyncClient) -> None:
    answer = await client.get("/api/v1/vehicles", headers={"host": "evil.example"})
    assert answer.status_code == 403
    assert "'evil.example' is not this station's" in answer.json()["detail"]


async def test_the_own_page_and_the_command_line_may_act(client: httpx.AsyncClient, actions: Any) -> None:
    own = {"origin": "http://localhost:8000", "sec-fetch-site": "same-origin"}
    assert (await client.post("/api/v1/hold-all", headers=own)).status_code == 202
    assert (await client.post("/api/v1/hold-all")).status_code == 202
    assert len(actions.taken) == 2
