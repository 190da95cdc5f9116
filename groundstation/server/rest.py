"""Bodies and answers of the REST routes; same rules as ``wire``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from groundstation.server.wire import (
    CommandRow,
    ConnectionRow,
    DecimalString,
    EventRow,
    ForwardRow,
    LinkRow,
    MissionRow,
    Model,
    ProposalRow,
    TargetRow,
    VehicleId,
    VehicleRow,
)


class Problem(Model):
    """RFC 9457: what went wrong, in one line."""

    type: str = Field(description="A stable name of the kind of problem.")
    title: str = Field(description="The kind of problem, for people.")
    status: int = Field(description="The HTTP status.")
    detail: str = Field(description="What was seen and what is needed, one line.")


class Page(Model):
    """Common head of every answer that lists rows."""

    schema_version: Literal[1] = Field(description="Of this answer.")
    server_time_ns: DecimalString = Field(description="Station time of the answer, ns.")


class Targets(Page):
    """All beacons."""

    targets: list[TargetRow] = Field(description="Beacons in order of their id.")


class Links(Page):
    """All radio links."""

    links: list[LinkRow] = Field(description="Links in order of vehicle and beacon.")


class Vehicles(Page):
    """All vehicles."""

    vehicles: list[VehicleRow] = Field(description="Vehicles in order of their id.")


class Commands(Page):
    """Commands of this run."""

    commands: list[CommandRow] = Field(description="Commands, the one that changed last at the end.")


class Proposals(Page):
    """All open proposals."""

    proposals: list[ProposalRow] = Field(description="Oldest first.")


class Events(Page):
    """Events, oldest first."""

    events: list[EventRow] = Field(description="Oldest first.")


class MissionAnswer(Page):
    """The mission as the station knows it."""

    mission: MissionRow | None = Field(description="Null before one was set.")


class HealthCheck(Model):
    """One thing that can be in order or not."""

    name: str = Field(description="What was looked at.")
    ok: bool = Field(description="In order.")
    detail: str = Field(description="What was seen.")


class Health(Page):
    """Whether the station works."""

    status: Literal["ok", "degraded"] = Field(description="degraded: at least one check is not in order.")
    version: str = Field(description="Version of the ground station.")
    epoch: str = Field(description="Names the run of the server.")
    seq: int = Field(description="Number of the newest delta.")
    clients: int = Field(description="Pages connected to the stream.")
    vehicles: int = Field(description="Vehicles known.")
    targets: int = Field(description="Beacons known.")
    connections: list[ConnectionRow] = Field(description="Connections.")
    forwards: list[ForwardRow] = Field(description="Other ground stations.")
    checks: list[HealthCheck] = Field(description="Checks of the other rooms.")


class SearchMap(Page):
    """Probability that the beacon is in each cell of a raster aligned with east and north."""

    beacon_id: DecimalString = Field(description="Device id of the transmitter.")
    time_ns: DecimalString = Field(description="Station time of the belief, ns.")
    north_west_latitude_deg: float = Field(description="Outer corner of the first cell, degrees north.")
    north_west_longitude_deg: float = Field(description="Outer corner of the first cell, degrees east.")
    south_east_latitude_deg: float = Field(description="Outer corner of the last cell, degrees north.")
    south_east_longitude_deg: float = Field(description="Outer corner of the last cell, degrees east.")
    corners_deg: list[list[float]] = Field(
        description="Outer corners as [longitude, latitude], degrees: north-west, north-east, south-east, "
        "south-west. North of the plane is true north at its origin only."
    )
    origin_latitude_deg: float = Field(
        description="Origin of the plane that the cells lie in, degrees north."
    )
    origin_longitude_deg: float = Field(description="Origin of that plane, degrees east.")
    west_m: float = Field(description="East coordinate of the western edge, metres from the origin.")
    north_m: float = Field(description="North coordinate of the northern edge, metres from the origin.")
    cell_size_m: float = Field(description="Side of a cell, metres.")
    rows: int = Field(description="Rows, from north to south.")
    columns: int = Field(description="Columns, from west to east.")
    probability: list[float] = Field(description="rows × columns values, row by row, summing to 1.")
    containment: list[float] = Field(
        description="For each cell the share of the belief in the cells that are at least as likely, 0 to 1: "
        "those up to 0.9 are where 90 % lie."
    )


class HistoryPoint(Model):
    """One belief of a beacon's past."""

    time_ns: DecimalString = Field(description="Station time of the belief, ns.")
    latitude_deg: float = Field(description="Latitude, degrees north.")
    longitude_deg: float = Field(description="Longitude, degrees east.")
    altitude_amsl_m: float = Field(description="Altitude above mean sea level, metres.")
    radius_90_m: float | None = Field(description="Radius of the circle that holds 90 % of the belief, m.")
    windows: int = Field(description="Link windows taken in until then.")
    links: int = Field(description="Vehicles that heard it then.")


class TargetHistory(Page):
    """How the estimate of one beacon came about."""

    beacon_id: DecimalString = Field(description="Device id of the transmitter.")
    points: list[HistoryPoint] = Field(
        description="Oldest first, evenly over the time asked for, the newest belief last."
    )


class JoinBody(Model):
    """Two ids that are one transmitter."""

    into_beacon_id: DecimalString = Field(description="The beacon whose belief the windows shall count for.")


def _whole(value: object) -> object:
    # In JSON 3.0 is the integer 3; a boolean is not.
    return int(value) if isinstance(value, float) and value.is_integer() else value


class ConfirmBody(Model):
    """A confirmation names the vehicle that the operator saw."""

    vehicle_id: Annotated[VehicleId, BeforeValidator(_whole)] = Field(
        description="Must be the proposal's vehicle."
    )


class ActionAnswer(Model):
    """What became of an operator's action."""

    accepted: bool = Field(description="The station took it; its commands appear in the stream.")
    text: str = Field(description="One line for the operator.")
    command_ids: list[str] = Field(description="Commands that it started.")
