"""GET routes: what the picture knows, and the beacon's search map."""

from __future__ import annotations

from collections.abc import Sequence
from http import HTTPStatus
from typing import Annotated, TypeVar

from fastapi import APIRouter, Query, Response

from groundstation.domain.target import SearchMap
from groundstation.server import rest, rows, target_rows
from groundstation.server.problems import ProblemError
from groundstation.server.routes.common import BeaconPath, HubDep, SourcesDep, problems
from groundstation.server.wire import SCHEMA_VERSION, ExplanationRow, RegionsRow, TargetRow

router = APIRouter(prefix="/api/v1", tags=["state"])

Found = TypeVar("Found")


@router.get("/targets")
async def targets(hub: HubDep) -> rest.Targets:
    """All beacons that are heard."""
    return rest.Targets(
        schema_version=SCHEMA_VERSION,
        server_time_ns=str(hub.clock()),
        targets=hub.picture.target_rows(),
    )


def _target(hub: HubDep, beacon_id: str) -> TargetRow:
    row = hub.picture.targets.row(int(beacon_id))
    if row is None:
        raise ProblemError(
            HTTPStatus.NOT_FOUND, "unknown-beacon", f"beacon {beacon_id} was never heard in this session"
        )
    return row


@router.get("/targets/{beacon_id}", responses=problems(404, 422))
async def target(hub: HubDep, beacon_id: BeaconPath) -> TargetRow:
    """One beacon."""
    return _target(hub, beacon_id)


def _of_beacon(
    hub: HubDep, beacon_id: str, found: Found | None, code: str, missing: str, else_: str
) -> Found:
    """``found``, or a problem with the reason why a beacon has none; ``else_`` when it is located."""
    row = _target(hub, beacon_id)
    if found is not None:
        return found
    if row.state == "joined":
        why = f"it is joined into beacon {row.joined_into}, see there"
    else:
        why = row.needed if row.state == "waiting" else else_
    raise ProblemError(HTTPStatus.NOT_FOUND, code, f"{missing}: {why}")


def _search_map(hub: HubDep, beacon_id: str) -> SearchMap:
    return _of_beacon(
        hub,
        beacon_id,
        hub.picture.search_maps.get(int(beacon_id)),
        "no-search-map",
        f"there is no search map of beacon {beacon_id}",
        "none was drawn yet, see its radius_90_m",
    )


@router.get("/targets/{beacon_id}/search-map", responses=problems(404, 422))
async def search_map(hub: HubDep, beacon_id: BeaconPath) -> rest.SearchMap:
    """Where the beacon could be, as a raster with its georeference: the newest one drawn."""
    return target_rows.search_map(_search_map(hub, beacon_id), hub.clock())


@router.get(
    "/targets/{beacon_id}/search-map/file",
    response_class=Response,
    responses={
        200: {"content": {"application/zip": {}}, "description": "The archive."},
        **problems(404, 422),
    },
)
async def search_map_file(hub: HubDep, sources: SourcesDep, beacon_id: BeaconPath) -> Response:
    """The same for a GIS: a ZIP archive with two ESRI ASCII grids and their projection."""
    found = _search_map(hub, beacon_id)
    if sources.search_map_file is None:
        raise ProblemError(
            HTTPStatus.NOT_FOUND, "no-search-map", "this server writes no files of search maps"
        )
    name = f"search-map-{int(beacon_id)}-{found.time_ns // 1_000_000_000}.zip"
    return Response(
        sources.search_map_file(found),
        media_type="application/zip",
        headers={"content-disposition": f'attachment; filename="{name}"'},
    )


@router.get("/targets/{beacon_id}/explanation", responses=problems(404, 422))
async def explanation(hub: HubDep, beacon_id: BeaconPath) -> ExplanationRow:
    """Why the belief is what it is: each vehicle's weight and how well it agrees."""
    return _of_beacon(
        hub,
        beacon_id,
        hub.picture.explanations.row(int(beacon_id)),
        "no-explanation",
        f"beacon {beacon_id} cannot be explained",
        "it was not worked out yet",
    )


@router.get("/targets/{beacon_id}/history", responses=problems(404, 422))
async def history(
    hub: HubDep,
    sources: SourcesDep,
    beacon_id: BeaconPath,
    limit: Annotated[int, Query(ge=2, le=2000, description="How many points at most.")] = 200,
    since_ns: Annotated[
        str, Query(pattern=r"^[0-9]{1,18}$", description="Only beliefs after this station time, ns.")
    ] = "0",
) -> rest.TargetHistory:
    """How the estimate came about: positions and radii, evenly over the time, the newest last."""
    _target(hub, beacon_id)
    points: Sequence[rest.HistoryPoint] | None = None
    if sources.history is not None:
        points = await sources.history(int(beacon_id), int(since_ns), limit)
    if not points:
        points = target_rows.history(hub.picture.histories.of(int(beacon_id), int(since_ns), limit))
    return rest.TargetHistory(
        schema_version=SCHEMA_VERSION,
        server_time_ns=str(hub.clock()),
        beacon_id=beacon_id,
        points=list(points),
    )


@router.get("/targets/{beacon_id}/regions", responses=problems(404, 422))
async def regions(hub: HubDep, beacon_id: BeaconPath) -> RegionsRow:
    """Where one beacon could be: nested areas that hold 50, 90 and 95 % of the belief."""
    return _of_beacon(
        hub,
        beacon_id,
        hub.picture.regions.row(int(beacon_id)),
        "no-regions",
        f"there are no regions of beacon {beacon_id}",
        "its tracker drew none, see its radius_90_m",
    )


@router.get("/links")
async def links(hub: HubDep) -> rest.Links:
    """All radio links: one vehicle hearing one beacon each."""
    return rest.Links(
        schema_version=SCHEMA_VERSION, server_time_ns=str(hub.clock()), links=hub.picture.link_rows()
    )


@router.get("/vehicles")
async def vehicles(hub: HubDep) -> rest.Vehicles:
    """All vehicles."""
    return rest.Vehicles(
        schema_version=SCHEMA_VERSION,
        server_time_ns=str(hub.clock()),
        vehicles=hub.picture.vehicle_rows(),
    )


@router.get("/proposals")
async def proposals(hub: HubDep) -> rest.Proposals:
    """Proposals that can be confirmed."""
    return rest.Proposals(
        schema_version=SCHEMA_VERSION,
        server_time_ns=str(hub.clock()),
        proposals=sorted(hub.picture.proposals.rows(), key=lambda row: int(row.created_ns)),
    )


@router.get("/commands")
async def commands(hub: HubDep) -> rest.Commands:
    """Commands of this run and how far they are."""
    return rest.Commands(
        schema_version=SCHEMA_VERSION,
        server_time_ns=str(hub.clock()),
        commands=sorted(hub.picture.commands.rows(), key=lambda row: int(row.time_ns)),
    )


@router.get("/events", responses=problems(422))
async def events(
    hub: HubDep,
    sources: SourcesDep,
    limit: Annotated[int, Query(ge=1, le=2000, description="How many at most.")] = 200,
    before_ns: Annotated[
        str | None, Query(pattern=r"^[0-9]{1,19}$", description="Only events before this station time, ns.")
    ] = None,
) -> rest.Events:
    """Events, oldest first: the newest before a time, from memory and then from the database."""
    before = None if before_ns is None else int(before_ns)
    found = [row for row in hub.picture.events if before is None or int(row.time_ns) < before][-limit:]
    missing = limit - len(found)
    if missing > 0 and sources.older_events is not None:
        oldest = int(found[0].time_ns) if found else (before if before is not None else hub.clock())
        older = await sources.older_events(oldest, missing)
        found = [*(rows.event_row(event, 0) for event in older), *found]
    return rest.Events(schema_version=SCHEMA_VERSION, server_time_ns=str(hub.clock()), events=found)


@router.get("/mission")
async def mission(hub: HubDep) -> rest.MissionAnswer:
    """Search area, fence and limits."""
    return rest.MissionAnswer(
        schema_version=SCHEMA_VERSION, server_time_ns=str(hub.clock()), mission=hub.picture.mission_row()
    )
