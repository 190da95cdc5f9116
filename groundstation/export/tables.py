"""CSV and JSON: every number of a belief, for scripts and spreadsheets.

Rule: column and key names end in their unit and stay; new ones come last.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

import orjson

from groundstation.domain.target import SnapshotEstimate, TargetState
from groundstation.export.rounding import (
    PROBABILITY_DECIMALS,
    degrees,
    iso_time,
    joined_ids,
    newest,
    number,
)

FORMAT = "groundstation-targets"
FORMAT_VERSION = 1
_AXES = ("ee", "en", "eu", "nn", "nu", "uu")


def encode_csv(targets: Sequence[TargetState]) -> bytes:
    """A row for every belief given (all of a beacon's history), by beacon and time; RFC 4180."""
    rows = sorted(targets, key=lambda target: (target.beacon_id, target.time_ns, target.sequence))
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(_COLUMNS), lineterminator="\r\n")
    writer.writeheader()
    for row in map(_row, rows):
        # A list in one cell: spaces need no quotes and are no separator of any spreadsheet.
        writer.writerow({**row, "joined_beacon_ids": " ".join(row["joined_beacon_ids"])})
    return text.getvalue().encode("utf-8", "replace")


def encode_json(targets: Sequence[TargetState]) -> bytes:
    """The newest belief of each beacon, by beacon id, with its snapshot estimate."""
    document = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "targets": [{**_row(target), "snapshot": _snapshot(target.snapshot)} for target in newest(targets)],
    }
    return orjson.dumps(document, option=orjson.OPT_INDENT_2) + b"\n"


def _row(target: TargetState) -> dict[str, Any]:
    place = target.position
    covariance = zip(_AXES, target.covariance_enu_m2, strict=True)
    return {
        "beacon_id": str(target.beacon_id),
        "time_ns": str(target.time_ns),
        "time": iso_time(target.time_ns),
        "latitude_deg": number(place.latitude_deg, 7),
        "longitude_deg": number(place.longitude_deg, 7),
        "altitude_amsl_m": number(place.altitude_amsl_m),
        "radius_90_m": number(target.radius_90_m),
        "environment": target.environment.name,
        "los_links": target.los_links,
        "links": target.links,
        "windows": target.windows,
        "method": target.method,
        "height_reference": target.height_reference,
        "first_heard_ns": str(target.first_heard_ns),
        "last_heard_ns": str(target.last_heard_ns),
        "sequence": target.sequence,
        **{f"covariance_{axes}_m2": number(value, 4) for axes, value in covariance},
        "walking_probability": number(target.walking_probability, PROBABILITY_DECIMALS),
        "joined_beacon_ids": joined_ids(target),
    }


_COLUMNS = (
    "beacon_id",
    "time_ns",
    "time",
    "latitude_deg",
    "longitude_deg",
    "altitude_amsl_m",
    "radius_90_m",
    "environment",
    "los_links",
    "links",
    "windows",
    "method",
    "height_reference",
    "first_heard_ns",
    "last_heard_ns",
    "sequence",
    *(f"covariance_{axes}_m2" for axes in _AXES),
    "walking_probability",
    "joined_beacon_ids",
)


def _snapshot(snapshot: SnapshotEstimate | None) -> dict[str, Any] | None:
    if snapshot is None:
        return None
    place = snapshot.position
    return {
        "time_ns": str(snapshot.time_ns),
        "latitude_deg": degrees(place.latitude_deg),
        "longitude_deg": degrees(place.longitude_deg),
        "altitude_amsl_m": number(place.altitude_amsl_m),
        "environment": snapshot.environment.name,
        "method": snapshot.method,
        "transmit_power_dbm": number(snapshot.transmit_power_dbm),
        "path_loss_exponent": [number(value, 3) for value in snapshot.path_loss_exponent],
        "vehicle_ids": list(snapshot.vehicle_ids),
        "los_vehicle_ids": list(snapshot.los_vehicle_ids),
        "status": snapshot.status,
    }
