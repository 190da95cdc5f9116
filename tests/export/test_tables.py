"""CSV and JSON: every number, same names, same bytes."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable

import pytest

from groundstation.domain.errors import UsageError
from groundstation.domain.target import TargetState
from groundstation.export import ENCODERS, encode
from groundstation.export.tables import encode_csv, encode_json

Belief = Callable[..., TargetState]


def test_csv_has_every_belief_in_order(belief: Belief) -> None:
    beliefs = [belief(beacon_id=2, time_ns=n) for n in (3, 1)] + [belief(beacon_id=1)]
    data = encode_csv(beliefs)
    assert data.count(b"\r\n") == 4
    rows = list(csv.DictReader(io.StringIO(data.decode(), newline="")))
    assert [(row["beacon_id"], row["time_ns"]) for row in rows][1:] == [("2", "1"), ("2", "3")]
    assert rows[0]["method"] == "posterior <&>"
    assert rows[0]["covariance_ee_m2"] == "9.1235"
    assert rows[0]["latitude_deg"] == "-35.3625123"


def test_csv_and_json_tell_joined_ids_and_a_walk_in_their_last_columns(belief: Belief) -> None:
    told = belief(walking_probability=0.61249, joined_beacon_ids=(2**64 - 2, 5))
    rows = list(csv.DictReader(io.StringIO(encode_csv([told, belief(beacon_id=9)]).decode(), newline="")))
    assert list(rows[0])[-2:] == ["walking_probability", "joined_beacon_ids"]
    cells = [(row["walking_probability"], row["joined_beacon_ids"]) for row in rows]
    assert cells == [("", ""), ("0.612", "5 18446744073709551614")]
    (item,) = json.loads(encode_json([told]))["targets"]
    assert item["walking_probability"] == 0.612
    assert item["joined_beacon_ids"] == ["5", "18446744073709551614"]


def test_csv_of_nothing_has_its_header_and_quotes_survive(belief: Belief) -> None:
    assert encode_csv([]).startswith(b"beacon_id,time_ns,time,latitude_deg,longitude_deg,altitude_amsl_m,")
    odd = 'a,"b"\nc'
    (row,) = csv.DictReader(io.StringIO(encode_csv([belief(method=odd)]).decode(), newline=""))
    assert row["method"] == odd


def test_json_has_a_version_and_the_snapshot(belief: Belief) -> None:
    document = json.loads(encode_json([belief(beacon_id=2), belief(), belief(beacon_id=1, snapshot=None)]))
    assert (document["format"], document["format_version"]) == ("groundstation-targets", 1)
    assert [item["beacon_id"] for item in document["targets"]] == ["1", "2", "18446744073709551615"]
    assert document["targets"][0]["snapshot"] is None
    snapshot = document["targets"][1]["snapshot"]
    assert snapshot["transmit_power_dbm"] == 14.12
    assert snapshot["path_loss_exponent"] == [2.0, 2.712]
    assert snapshot["los_vehicle_ids"] == [1]


def test_formats_by_name(belief: Belief) -> None:
    assert set(ENCODERS) == {"json", "geojson", "kml", "gpx", "csv"}
    for name in ENCODERS:
        data = encode(name, [belief()])
        assert data == encode(name, [belief()])
        assert data.endswith(b"\n")
        assert b"18446744073709551615" in data
    with pytest.raises(
        UsageError, match="unknown format 'shp'; one of json, geojson, kml, gpx, csv is needed"
    ):
        encode("shp", [])
