"""Every value that leaves or enters over HTTP: strict Pydantic models, one union for the stream.

Rule: units in the names, a description on every field, integers that can pass 2⁵³ as
decimal strings. The page's types are generated from here (``python -m
groundstation.server.schema``); a test fails when they are stale. A change that an older
page cannot read raises ``SCHEMA_VERSION``.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

SCHEMA_VERSION: Literal[1] = 1
"""Of the stream and of the REST answers."""

DecimalString = Annotated[str, Field(pattern=r"^[0-9]{1,20}$")]
"""An unsigned integer that may pass 2⁵³."""
VehicleId = Annotated[int, Field(ge=1, le=255)]
"""MAVLink system id."""


class Model(BaseModel):
    """Strict (no coercion), closed (no unknown fields), frozen."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class Place(Model):
    """A place on WGS84."""

    latitude_deg: float = Field(description="Latitude, degrees north.")
    longitude_deg: float = Field(description="Longitude, degrees east.")
    altitude_amsl_m: float = Field(description="Altitude above mean sea level, metres.")


class VehicleRow(Model):
    """The newest picture of one vehicle. What was never heard is null."""

    vehicle_id: VehicleId = Field(description="MAVLink system id.")
    time_ns: DecimalString = Field(description="Station time of this picture, ns since the Unix epoch.")
    connections: list[str] = Field(description="Connections it is heard on, newest first.")
    autopilot: Literal["unknown", "ardupilot", "px4"] = Field(description="Family of the autopilot.")
    mode: str = Field(description="Flight mode in the autopilot's own word.")
    armed: bool = Field(description="Motors armed.")
    ready: bool = Field(description="Position valid and pre-arm checks healthy.")
    lost: bool = Field(description="No heartbeat for five seconds.")
    last_heartbeat_ns: DecimalString = Field(description="Station time of the last heartbeat, ns.")
    position: Place | None = Field(description="Where it is; null until it has a valid position.")
    position_time_ns: DecimalString | None = Field(description="Station time of the position, ns.")
    height_above_home_m: float | None = Field(description="Height above its home, metres.")
    home: Place | None = Field(description="Its home position.")
    heading_deg: float | None = Field(description="Where its nose points, degrees clockwise from north.")
    ground_speed_m_s: float | None = Field(description="Horizontal speed, metres per second.")
    climb_rate_m_s: float | None = Field(description="Vertical speed, up positive, metres per second.")
    battery_percent: float | None = Field(description="Battery left, percent.")
    battery_voltage_v: float | None = Field(description="Battery voltage, volts.")
    gps_fix_type: int | None = Field(description="MAVLink GPS_FIX_TYPE.")
    satellites: int | None = Field(description="Satellites in use.")
    position_accuracy_m: float | None = Field(description="Its horizontal RMS error, as it says, m.")
    position_target: Place | None = Field(description="Where its autopilot says it is going.")
    sensor_heard_ns: DecimalString | None = Field(description="Station time of its sensor's last frame, ns.")
    packet_loss_percent: float | None = Field(
        description="Frames lost on the way here in the last minute, percent."
    )
    clock_offset_known: bool = Field(description="Its times can be mapped to station time.")
    clock_uncertainty_s: float | None = Field(
        description="How far its autopilot's times may be off station time, seconds; null until they can "
        "be mapped."
    )


class Trail(Model):
    """The path of one vehicle, thinned."""

    vehicle_id: VehicleId = Field(description="MAVLink system id.")
    points_deg: list[list[float]] = Field(description="[longitude, latitude] pairs, degrees, oldest first.")


class LinkRow(Model):
    """One vehicle hearing one beacon."""

    vehicle_id: VehicleId = Field(description="MAVLink system id of the vehicle.")
    beacon_id: DecimalString = Field(description="Device id of the transmitter.")
    last_heard_ns: DecimalString = Field(description="Station time of the newest sample or verdict, ns.")
    rss_dbm: float | None = Field(description="Received power of the newest sample, dBm.")
    noise_dbm: float | None = Field(description="Noise level of the newest sample, dBm.")
    samples_total: int = Field(description="Samples heard so far.")
    captures_total: int = Field(description="Whole channel impulse responses so far.")
    captures_incomplete_total: int = Field(description="Impulse responses that lost a fragment.")
    los_probability: float | None = Field(
        description="Calibrated probability that the link is line of sight, 0 to 1; null before a verdict."
    )
    los_source: Literal["classifier", "sensor", "prior"] | None = Field(
        description="Who says so; ``prior`` means the link is unclassified."
    )
    los_reason: str = Field(description="Why it could not be classified; empty when it was.")
    verdict_time_ns: DecimalString | None = Field(description="Station time of the verdict, ns.")
    azimuth_rad: float | None = Field(
        description="Bearing to the beacon, radians counter-clockwise from east."
    )
    elevation_rad: float | None = Field(description="Elevation to the beacon, radians, up positive.")


class TargetRow(Model):
    """What is believed of one beacon; ``state`` says whether there is a position."""

    beacon_id: DecimalString = Field(description="Device id of the transmitter.")
    state: Literal["located", "waiting", "joined"] = Field(
        description="Whether there is an estimate; joined: the operator says that it is another beacon's id."
    )
    joined_into: DecimalString | None = Field(description="The beacon whose belief counts for this id.")
    joined_beacon_ids: list[DecimalString] = Field(
        description="Other ids of the same transmitter: what they say counts here."
    )
    walking_probability: float | None = Field(
        description="Probability that the person walks, 0 to 1; null where it was not asked."
    )
    time_ns: DecimalString = Field(description="Station time of this belief, ns.")
    first_heard_ns: DecimalString = Field(description="Station time it was first heard, ns.")
    last_heard_ns: DecimalString = Field(description="Station time it was last heard, ns.")
    links: int = Field(description="Vehicles that hear it.")
    los_links: int | None = Field(description="Of these, links taken as line of sight.")
    needed: str = Field(description="What is missing for an estimate; empty when located.")
    position: Place | None = Field(description="The estimate; null while waiting.")
    covariance_enu_m2: list[float] | None = Field(
        description="Upper triangle EE, EN, EU, NN, NU, UU, square metres."
    )
    radius_90_m: float | None = Field(description="Radius of the circle that holds 90 % of the belief, m.")
    environment: Literal["unknown", "los", "mixed", "nlos"] = Field(
        description="Environment found by Algorithm 1."
    )
    method: str = Field(description="Method behind the position; empty while waiting.")
    windows: int = Field(description="Link windows taken in so far.")
    height_reference: str = Field(
        description="Where the ground's altitude comes from: terrain, home, settings or unknown."
    )
    sequence: int = Field(description="Counts this beacon's updates.")
    snapshot_position: Place | None = Field(description="Algorithm 1's newest answer, for comparison.")
    snapshot_method: str | None = Field(description="The method of that answer.")
    snapshot_status: str | None = Field(description="``ok`` or what its solver said.")


class RegionRow(Model):
    """Where a given share of the belief lies: the smallest such area."""

    share: float = Field(description="Share of the belief within, 0 to 1.")
    polygons_deg: list[list[list[list[float]]]] = Field(
        description="GeoJSON MultiPolygon: polygons of closed rings of [longitude, latitude], deg."
    )


class RegionsRow(Model):
    """Where one beacon could be; sent when it changes, at most every two seconds a beacon."""

    beacon_id: DecimalString = Field(description="Device id of the transmitter.")
    time_ns: DecimalString = Field(description="Station time of the belief that was drawn, ns.")
    regions: list[RegionRow] = Field(description="Nested, the smallest share first: 0.5, 0.9 and 0.95.")


class ContributionRow(Model):
    """What one vehicle brought to a belief, and how well it agrees with it."""

    vehicle_id: VehicleId = Field(description="MAVLink system id.")
    weight: float = Field(
        description="Share of the information about the place that it brought, 0 to 1; all add up to 1."
    )
    area_factor: float = Field(
        description="Without it the space where the beacon may be were so many times as large; below 1: "
        "it contradicts the others."
    )
    windows: int = Field(description="Link windows taken in.")
    redundant: int = Field(description="Windows from a place heard from often enough: not taken in.")
    outliers: int = Field(description="Windows weighed down: implausible at every likely place.")
    power_residual_db: float | None = Field(
        description="How much stronger it hears the beacon than the estimate explains, decibels."
    )
    power_score: float | None = Field(description="The same in standard deviations.")
    azimuth_residual_deg: float | None = Field(
        description="How far its bearing points to the right of the estimate, degrees."
    )
    azimuth_score: float | None = Field(description="The same in standard deviations.")
    elevation_residual_deg: float | None = Field(
        description="How far its bearing points above the estimate, degrees."
    )
    elevation_score: float | None = Field(description="The same in standard deviations.")
    los_probability: float | None = Field(
        description="Mean probability of line of sight of its judged windows, 0 to 1; null: none was judged."
    )


class ExplanationRow(Model):
    """Why the belief of one beacon is what it is; sent when it changes, at most every five seconds."""

    beacon_id: DecimalString = Field(description="Device id of the transmitter.")
    time_ns: DecimalString = Field(description="Station time of the belief that is explained, ns.")
    sequence: int = Field(description="Number of the beacon's update that is explained.")
    contributions: list[ContributionRow] = Field(description="By vehicle.")


class ProposalRow(Model):
    """A place offered to the operator."""

    proposal_id: str = Field(description="Unique within the session.")
    vehicle_id: VehicleId = Field(description="The vehicle it is for; a confirmation must name it.")
    beacon_id: DecimalString = Field(description="The beacon it would help to find.")
    position: Place = Field(description="Where the vehicle would fly.")
    height_above_home_m: float = Field(description="At which height above its home, metres.")
    reason: str = Field(description="Why, in the operator's words.")
    created_ns: DecimalString = Field(description="Station time it was made, ns.")
    expires_ns: DecimalString = Field(description="Station time it runs out, ns.")
    mission_revision: int = Field(description="The mission it was planned under.")
    target_sequence: int = Field(description="The belief it was based on.")


CommandPhaseName = Literal[
    "gated", "sent", "accepted", "flying", "arrived", "holding",
    "refused", "timed_out", "revoked", "superseded",
]  # fmt: skip


class CommandRow(Model):
    """The newest step of one command's life."""

    command_id: str = Field(description="Unique within the session.")
    vehicle_id: VehicleId = Field(description="The vehicle commanded.")
    kind: Literal["reposition", "hold"] = Field(description="What it was told.")
    phase: CommandPhaseName = Field(description="Where the command is in its life.")
    time_ns: DecimalString = Field(description="Station time of this step, ns.")
    detail: str = Field(description="Why it was refused, what the vehicle answered.")
    target: Place | None = Field(description="Where it was sent.")
    proposal_id: str | None = Field(description="The proposal behind it.")
    attempts: int = Field(description="How often it was sent.")


class ConnectionRow(Model):
    """A connection to vehicles."""

    connection: str = Field(description="Its name, the URL it was opened with.")
    state: str = Field(description="open, closed, waiting or failed.")
    detail: str = Field(description="What happened.")
    time_ns: DecimalString = Field(description="Station time of the change, ns.")


class CounterRow(Model):
    """A running total: drops, rejections, late samples."""

    name: str = Field(description="Prometheus style, ending in _total.")
    labels: dict[str, str] = Field(description="What it counts for.")
    value_count: int = Field(description="The total.")


class AreaRow(Model):
    """Polygons on WGS84."""

    name: str = Field(description="Name given by the operator.")
    polygons_deg: list[list[list[list[float]]]] = Field(
        description="GeoJSON MultiPolygon: polygons of closed rings of [longitude, latitude], deg."
    )


class LimitsRow(Model):
    """What the gate allows."""

    floor_m: float = Field(description="Lowest commanded height above home, metres.")
    ceiling_m: float = Field(description="Highest commanded height above home, metres.")
    separation_m: float = Field(description="Smallest distance to another vehicle, metres.")
    fence_margin_m: float = Field(description="How far inside the fence a command stays, metres.")
    stale_pose_s: float = Field(description="Age at which a pose is too old, seconds.")
    max_leg_m: float = Field(description="Longest leg, metres.")


class LastKnownRow(Model):
    """Where a person was last known to be: a prior of the search, no limit to it."""

    latitude_deg: float = Field(description="Latitude of the middle, degrees north.")
    longitude_deg: float = Field(description="Longitude of the middle, degrees east.")
    radius_m: float = Field(
        description="Radius of the circle that is trusted to hold the person nine times in ten, metres."
    )
    name: str = Field(description="Name given by the operator; may be empty.")
    beacon_id: DecimalString | None = Field(description="The beacon that it is known of; null: any of them.")


class MissionRow(Model):
    """What the operator set."""

    revision: int = Field(description="Grows by one at each change.")
    origin: Place | None = Field(description="Origin of the local frame.")
    search_area: AreaRow | None = Field(description="Where the people may be.")
    fence: AreaRow | None = Field(description="Where vehicles may go; without it nothing is commanded.")
    target_height_min_m: float = Field(description="Lowest target height above the ground, metres.")
    target_height_max_m: float = Field(description="Highest target height above the ground, metres.")
    ground_amsl_m: float | None = Field(description="Altitude of the ground, metres; null: not known.")
    height_reference: str = Field(
        description="Where the ground's altitude comes from: terrain, home, settings or unknown."
    )
    limits: LimitsRow = Field(description="What the gate allows.")
    last_known: list[LastKnownRow] = Field(description="Where people were last known to be.")


class ForwardRow(Model):
    """Another ground station that gets our vehicles' frames."""

    url: str = Field(description="Where it is.")
    commanding: bool = Field(description="It may command vehicles.")
    connected: bool = Field(description="It was heard lately.")


class EventRow(Model):
    """Something happened. Never dropped on the way to the page."""

    number: int = Field(description="Counts from 1 within the epoch; 0 for one read from the database.")
    time_ns: DecimalString = Field(description="Station time, ns.")
    code: str = Field(description="Dotted and stable, for machines.")
    severity: Literal["info", "warning", "error"] = Field(description="How much it matters.")
    text: str = Field(description="One line, for people.")
    vehicle_id: int | None = Field(description="The vehicle concerned.")
    beacon_id: DecimalString | None = Field(description="The beacon concerned.")


class StationRow(Model):
    """What does not belong to a vehicle or a beacon."""

    version: str = Field(description="Version of the ground station.")
    title: str = Field(description="What runs: a session's name, a file being replayed.")
    source: Literal["live", "replay", "demo"] = Field(description="Where the frames come from.")
    commands_enabled: bool = Field(description="Whether any vehicle can be commanded now.")
    commands_reason: str = Field(description="Why not; empty when they can.")


class Removed(Model):
    """A row that went away."""

    kind: Literal[
        "vehicle", "link", "target", "regions", "explanation", "proposal", "command", "connection"
    ] = Field(description="Which table.")
    key: str = Field(description="The row's id; vehicle:beacon for a link.")
    reason: str = Field(description="confirmed, expired, replaced, evicted, …")


class Rows(Model):
    """Rows of every table; in a delta only those that changed."""

    vehicles: list[VehicleRow] = Field(description="Vehicles.")
    links: list[LinkRow] = Field(description="Radio links.")
    targets: list[TargetRow] = Field(description="Beacons.")
    regions: list[RegionsRow] = Field(description="Where beacons could be, one row a beacon.")
    explanations: list[ExplanationRow] = Field(description="Why the beliefs are what they are.")
    proposals: list[ProposalRow] = Field(description="Open proposals.")
    commands: list[CommandRow] = Field(description="Commands, newest step of each.")
    connections: list[ConnectionRow] = Field(description="Connections.")
    counters: list[CounterRow] = Field(description="Totals.")
    forwards: list[ForwardRow] | None = Field(description="Other ground stations; null: unchanged.")
    mission: MissionRow | None = Field(description="The mission; null: unchanged or none.")
    station: StationRow | None = Field(description="The station; null: unchanged.")


class Snapshot(Model):
    """The whole picture; first message of a stream that does not resume."""

    type: Literal["snapshot"] = Field(description="Tells the messages apart.")
    schema_version: Literal[1] = Field(description="Of this stream.")
    epoch: str = Field(description="Names the run of the server; seq counts within it.")
    seq: int = Field(description="Number of the newest delta it includes.")
    server_time_ns: DecimalString = Field(description="Station time when it was made, ns.")
    rows: Rows = Field(description="All rows.")
    trails: list[Trail] = Field(description="Where the vehicles have been.")
    events: list[EventRow] = Field(description="The newest events, oldest first.")


class Delta(Model):
    """What changed since ``previous_seq``; state coalesced, events complete."""

    type: Literal["delta"] = Field(description="Tells the messages apart.")
    schema_version: Literal[1] = Field(description="Of this stream.")
    epoch: str = Field(description="Names the run of the server.")
    seq: int = Field(description="Number of this delta.")
    previous_seq: int = Field(description="The delta it follows; a gap means: reconnect.")
    server_time_ns: DecimalString = Field(description="Station time when it was made, ns.")
    rows: Rows = Field(description="Rows that are new or changed.")
    removed: list[Removed] = Field(description="Rows that went away; apply before ``rows``.")
    events: list[EventRow] = Field(description="Every event since ``previous_seq``, oldest first.")


class Heartbeat(Model):
    """Nothing changed; the stream lives."""

    type: Literal["heartbeat"] = Field(description="Tells the messages apart.")
    schema_version: Literal[1] = Field(description="Of this stream.")
    epoch: str = Field(description="Names the run of the server.")
    seq: int = Field(description="Number of the newest delta.")
    server_time_ns: DecimalString = Field(description="Station time, ns.")


StreamMessage = Annotated[Snapshot | Delta | Heartbeat, Field(discriminator="type")]
"""Everything that ``/api/v1/stream`` sends."""
