"""GET routes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import httpx

from groundstation.domain.command import CommandKind, CommandPhase, CommandStatus
from groundstation.domain.events import Counter, Event
from groundstation.domain.geometry import Geodetic
from groundstation.domain.inputs import ConnectionInput
from groundstation.domain.mission import Mission
from groundstation.domain.target import TargetWaiting
from groundstation.server.actions import Sources
from groundstation.server.app import create_app
from groundstation.server.hub import Hub
from groundstation.server.rest import HealthCheck, SearchMap


def _raster(beacon_id: int) -> SearchMap:
    return SearchMap(
        schema_version=1,
        server_time_ns="1",
        beacon_id=str(beacon_id),
        time_ns="1",
        north_west_latitude_deg=1.0,
        north_west_longitude_deg=1.0,
        south_east_latitude_deg=0.5,
        south_east_longitude_deg=1.5,
        cell_size_m=5.0,
        rows=1,
        columns=2,
        probability=[0.25, 0.75],
    )


async def test_tables(client: httpx.AsyncClient, hub: Hub, make: Any) -> None:
    big = 2**64 - 1
    for output in (
        make.vehicle(2),
        make.vehicle(1),
        make.target(big),
        make.activity(1, big),
        make.proposal(),
    ):
        hub.apply(output)
    vehicles = (await client.get("/api/v1/vehicles")).json()
    assert [row["vehicle_id"] for row in vehicles["vehicles"]] == [1, 2]
    assert (vehicles["schema_version"], vehicles["server_time_ns"]) == (1, "5000")
    targets = (await client.get("/api/v1/targets")).json()["targets"]
    assert targets[0]["beacon_id"] == str(big)
    assert (await client.get(f"/api/v1/targets/{big}")).json() == targets[0]
    assert (await client.get("/api/v1/links")).json()["links"][0]["beacon_id"] == str(big)
    assert (await client.get("/api/v1/proposals")).json()["proposals"][0]["proposal_id"] == "p-1"
    hub.apply(make.target(big, regions=make.regions()))
    regions = (await client.get(f"/api/v1/targets/{big}/regions")).json()
    assert regions["beacon_id"] == str(big)
    assert [region["share"] for region in regions["regions"]] == [0.5, 0.9, 0.95]
    longitude, latitude = regions["regions"][0]["polygons_deg"][0][0][0]
    assert (longitude, latitude) == (149.16555, -35.3625)
    assert (await client.get("/api/v1/mission")).json()["mission"] is None
    hub.apply(Mission(revision=4))
    assert (await client.get("/api/v1/mission")).json()["mission"]["revision"] == 4


async def test_commands_are_listed_with_their_newest_step(client: httpx.AsyncClient, hub: Hub) -> None:
    answer = (await client.get("/api/v1/commands")).json()
    assert (answer["commands"], answer["schema_version"]) == ([], 1)

    def step(command_id: str, phase: CommandPhase, time_ns: int, detail: str = "") -> CommandStatus:
        return CommandStatus(
            command_id, 3, CommandKind.REPOSITION, phase, time_ns, detail, Geodetic(1.0, 2.0, 3.0), "p-1", 1
        )

    hub.apply(step("c-1", CommandPhase.SENT, 10))
    hub.apply(step("c-2", CommandPhase.REFUSED, 20, "leaves the fence by 12 m"))
    hub.apply(step("c-1", CommandPhase.FLYING, 30))
    commands = (await client.get("/api/v1/commands")).json()["commands"]
    assert [(row["command_id"], row["phase"], row["time_ns"]) for row in commands] == [
        ("c-2", "refused", "20"),
        ("c-1", "flying", "30"),
    ]
    assert commands[0]["detail"] == "leaves the fence by 12 m"
    assert commands[1]["target"]["longitude_deg"] == 2.0


async def test_what_is_not_there_is_said_in_one_line(client: httpx.AsyncClient, hub: Hub, make: Any) -> None:
    hub.apply(TargetWaiting(8, 5, 4, 1, "2 more vehicles must hear it"))
    hub.apply(make.target(9))
    for path, words in (
        ("targets/7", "beacon 7 was never heard"),
        ("targets/8/search-map", "2 more vehicles must hear it"),
        ("targets/9/search-map", "keeps no raster"),
        ("targets/7/regions", "beacon 7 was never heard"),
        ("targets/8/regions", "2 more vehicles must hear it"),
        ("targets/9/regions", "drew none"),
    ):
        answer = await client.get(f"/api/v1/{path}")
        assert answer.status_code == 404
        assert answer.headers["content-type"] == "application/problem+json"
        assert words in answer.json()["detail"]
        assert answer.json()["status"] == 404
    for path in ("targets/x", "targets/-1", "events?limit=0", "events?before_ns=soon"):
        answer = await client.get(f"/api/v1/{path}")
        assert answer.status_code == 422
        assert "\n" not in answer.json()["detail"]


async def test_a_search_map_is_passed_on(hub: Hub, actions: Any, make: Any) -> None:
    hub.apply(make.target(9))
    app = create_app(hub, actions, Sources(search_map=_raster), page_directory=None)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://[::1]:8000") as client:
        answer = await client.get("/api/v1/targets/9/search-map")
        assert answer.json()["probability"] == [0.25, 0.75]


async def test_older_events_come_from_the_database(hub: Hub, actions: Any, make: Any) -> None:
    asked: list[tuple[int, int]] = []

    async def database(before_ns: int, limit: int) -> Sequence[Event]:
        asked.append((before_ns, limit))
        return [make.event("old", 10)]

    for time_ns in (100, 200, 300):
        hub.apply(make.event(str(time_ns), time_ns))
    app = create_app(hub, actions, Sources(older_events=database), page_directory=None)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost") as client:
        two = (await client.get("/api/v1/events?limit=2")).json()["events"]
        assert [event["text"] for event in two] == ["200", "300"]
        assert asked == []
        all_before = (await client.get("/api/v1/events?limit=5&before_ns=250")).json()["events"]
        assert [(event["text"], event["number"]) for event in all_before] == [
            ("old", 0),
            ("100", 1),
            ("200", 2),
        ]
        assert asked == [(100, 3)]


async def test_health(hub: Hub, actions: Any) -> None:
    hub.apply(ConnectionInput("udpin:0.0.0.0:14550", "open", "listening"))
    checks = [HealthCheck(name="journal", ok=False, detail="disk full")]
    app = create_app(hub, actions, Sources(health=lambda: checks, version="9"), page_directory=None)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost") as client:
        health = (await client.get("/api/v1/health")).json()
    assert (health["status"], health["version"], health["epoch"]) == ("degraded", "9", "epoch-1")
    assert health["connections"][0]["state"] == "open"


async def test_metrics_carry_the_totals_of_every_room(client: httpx.AsyncClient, hub: Hub, make: Any) -> None:
    hub.apply(make.vehicle(1, lost=True))
    hub.apply(Counter("frames_total", (("connection", 'a"b'),), 41))
    hub.apply(Counter("frames_total", (("connection", "c"),), 1))
    text = (await client.get("/metrics")).text
    assert 'groundstation_frames_total{connection="a\\"b"} 41.0' in text
    assert text.count("# TYPE groundstation_frames_total counter") == 1
    assert "groundstation_vehicles_lost 1.0" in text
    assert 'groundstation_server_rows_evicted_total{table="links"} 0.0' in text


async def test_the_documentation_needs_no_network(client: httpx.AsyncClient) -> None:
    answer = await client.get("/docs")
    assert answer.status_code == 200
    assert "/api/v1/proposals/{proposal_id}/confirm" in answer.text
    assert "https://" not in answer.text.split("<h1>Document</h1>")[0]
    assert "default-src 'none'" in answer.headers["content-security-policy"]
