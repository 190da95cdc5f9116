"""GET routes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import httpx

from groundstation.domain.command import CommandKind, CommandPhase, CommandStatus
from groundstation.domain.events import Counter, Event
from groundstation.domain.geometry import Geodetic
from groundstation.domain.inputs import ConnectionInput
from groundstation.domain.mission import Mission
from groundstation.domain.target import TargetJoined, TargetWaiting
from groundstation.server.actions import Sources
from groundstation.server.app import create_app
from groundstation.server.hub import Hub
from groundstation.server.rest import HealthCheck, HistoryPoint


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
        ("targets/9/search-map", "none was drawn yet"),
        ("targets/9/explanation", "not worked out yet"),
        ("targets/7/history", "beacon 7 was never heard"),
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


async def test_the_newest_search_map_is_given_with_its_georeference(
    client: httpx.AsyncClient, hub: Hub, make: Any
) -> None:
    hub.apply(make.target(9))
    hub.apply(make.search_map(9, time_ns=1_000))
    hub.apply(make.search_map(9))
    found = (await client.get("/api/v1/targets/9/search-map")).json()
    assert (found["beacon_id"], found["time_ns"], found["server_time_ns"]) == ("9", "2000", "5000")
    assert (found["probability"], found["containment"]) == ([0.25, 0.75], [1.0, 0.75])
    assert (found["rows"], found["columns"], found["cell_size_m"]) == (1, 2, 2.5)
    assert (found["west_m"], found["north_m"]) == (-10.0, 4.0)
    assert (found["origin_latitude_deg"], found["origin_longitude_deg"]) == (-35.3625, 149.1654)
    assert found["corners_deg"] == [[2.0, 1.0], [3.0, 1.0], [3.0, 0.5], [2.0, 0.5]]
    assert (found["north_west_latitude_deg"], found["north_west_longitude_deg"]) == (1.0, 2.0)
    assert (found["south_east_latitude_deg"], found["south_east_longitude_deg"]) == (0.5, 3.0)
    # It goes with the estimate that it belongs to, and never rides on the stream.
    hub.apply(TargetWaiting(9, 5, 4, 1, "a vehicle must hear it"))
    assert (await client.get("/api/v1/targets/9/search-map")).status_code == 404


async def test_a_search_map_of_no_estimate_is_not_kept(hub: Hub, make: Any) -> None:
    hub.apply(make.search_map(9))
    hub.apply(make.explanation(9))
    assert (hub.picture.search_maps, len(hub.picture.explanations)) == ({}, 0)


async def test_the_file_of_a_search_map_comes_from_who_can_write_it(
    hub: Hub, actions: Any, make: Any
) -> None:
    hub.apply(make.target(9))
    hub.apply(make.search_map(9, time_ns=1_700_000_000_000_000_000))
    sources = Sources(search_map_file=lambda found: b"zip of " + str(found.beacon_id).encode())
    app = create_app(hub, actions, sources, page_directory=None)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost") as client:
        answer = await client.get("/api/v1/targets/9/search-map/file")
        assert (answer.content, answer.headers["content-type"]) == (b"zip of 9", "application/zip")
        assert 'filename="search-map-9-1700000000.zip"' in answer.headers["content-disposition"]
    app = create_app(hub, actions, Sources(), page_directory=None)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost") as client:
        assert (await client.get("/api/v1/targets/9/search-map/file")).status_code == 404


async def test_reasons_are_given(client: httpx.AsyncClient, hub: Hub, make: Any) -> None:
    hub.apply(make.target(9))
    hub.apply(make.explanation(9))
    found = (await client.get("/api/v1/targets/9/explanation")).json()
    assert (found["beacon_id"], found["sequence"]) == ("9", 3)
    (row,) = found["contributions"]
    assert (row["vehicle_id"], row["weight"], row["area_factor"]) == (1, 0.4, 2.5)
    assert (row["power_residual_db"], row["azimuth_residual_deg"]) == (6.1, None)


async def test_history_is_thinned_evenly_and_ends_with_the_newest(
    client: httpx.AsyncClient, hub: Hub, make: Any
) -> None:
    second = 1_000_000_000
    for half in range(1, 2001):
        hub.apply(make.target(9, time_ns=half * second // 2, radius_90_m=float(half)))
    points = (await client.get("/api/v1/targets/9/history?limit=50")).json()["points"]
    assert 25 < len(points) <= 50
    times = [int(point["time_ns"]) for point in points]
    assert times[-1] == 1000 * second
    gaps = {b - a for a, b in pairwise(times[:-1])}
    assert len(gaps) == 1
    assert points[-1]["radius_90_m"] == 2000.0
    assert points[-1]["latitude_deg"] == make.place.latitude_deg
    late = (await client.get(f"/api/v1/targets/9/history?since_ns={900 * second}")).json()["points"]
    assert all(int(point["time_ns"]) > 900 * second for point in late)
    assert late[-1] == points[-1]


async def test_history_comes_from_the_database_where_there_is_one(hub: Hub, actions: Any, make: Any) -> None:
    hub.apply(make.target(9))
    asked: list[tuple[int, int, int]] = []
    known = HistoryPoint(
        time_ns="5",
        latitude_deg=1.0,
        longitude_deg=2.0,
        altitude_amsl_m=3.0,
        radius_90_m=4.0,
        windows=5,
        links=6,
    )

    async def database(beacon_id: int, since_ns: int, limit: int) -> Sequence[HistoryPoint]:
        asked.append((beacon_id, since_ns, limit))
        return [known]

    app = create_app(hub, actions, Sources(history=database), page_directory=None)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost") as client:
        answer = (await client.get("/api/v1/targets/9/history?since_ns=3&limit=7")).json()
    assert answer["points"] == [known.model_dump()]
    assert asked == [(9, 3, 7)]


async def test_until_the_database_has_a_row_the_picture_s_own_history_is_given(
    hub: Hub, actions: Any, make: Any
) -> None:
    hub.apply(make.target(9, time_ns=2_000))

    async def database(_beacon_id: int, _since_ns: int, _limit: int) -> Sequence[HistoryPoint]:
        return []

    app = create_app(hub, actions, Sources(history=database), page_directory=None)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost") as client:
        answer = (await client.get("/api/v1/targets/9/history")).json()
    assert [point["time_ns"] for point in answer["points"]] == ["2000"]


async def test_a_joined_beacon_says_into_whom(client: httpx.AsyncClient, hub: Hub, make: Any) -> None:
    hub.apply(make.target(8, regions=make.regions()))
    hub.apply(make.search_map(8))
    hub.apply(make.target(9, joined_beacon_ids=(8,)))
    hub.apply(TargetJoined(8, 5, 3, 4, 9))
    row = (await client.get("/api/v1/targets/8")).json()
    assert (row["state"], row["joined_into"], row["position"], row["last_heard_ns"]) == (
        "joined",
        "9",
        None,
        "4",
    )
    assert (await client.get("/api/v1/targets/9")).json()["joined_beacon_ids"] == ["8"]
    for what in ("search-map", "regions", "explanation"):
        answer = await client.get(f"/api/v1/targets/8/{what}")
        assert "joined into beacon 9" in answer.json()["detail"]


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
    hub.apply(make.vehicle(2, clock_uncertainty_ns=3_400_000))
    hub.apply(Counter("frames_total", (("connection", 'a"b'),), 41))
    hub.apply(Counter("frames_total", (("connection", "c"),), 1))
    text = (await client.get("/metrics")).text
    assert 'groundstation_frames_total{connection="a\\"b"} 41.0' in text
    assert text.count("# TYPE groundstation_frames_total counter") == 1
    assert "groundstation_vehicles_lost 1.0" in text
    clocks = [line for line in text.splitlines() if line.startswith("groundstation_vehicle_clock")]
    assert clocks == ['groundstation_vehicle_clock_uncertainty_seconds{vehicle="2"} 0.0034']
    assert 'groundstation_server_rows_evicted_total{table="links"} 0.0' in text


async def test_the_documentation_needs_no_network(client: httpx.AsyncClient) -> None:
    answer = await client.get("/docs")
    assert answer.status_code == 200
    assert "/api/v1/proposals/{proposal_id}/confirm" in answer.text
    assert "https://" not in answer.text.split("<h1>Document</h1>")[0]
    assert "default-src 'none'" in answer.headers["content-security-policy"]
