"""The schema is documented, and the page's types are those of this schema."""

from __future__ import annotations

import inspect
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from groundstation.server import rest, schema, wire

ROOT = Path(__file__).resolve().parents[2]
MODELS = sorted(
    {
        model
        for module in (wire, rest)
        for model in vars(module).values()
        if inspect.isclass(model) and issubclass(model, wire.Model) and model is not wire.Model
    },
    key=lambda model: model.__name__,
)
UNITS = (
    "_m",
    "_s",
    "_ns",
    "_deg",
    "_rad",
    "_dbm",
    "_db",
    "_hz",
    "_percent",
    "_v",
    "_m_s",
    "_m2",
    "_count",
    "_total",
)
UNITLESS = {
    "gps_fix_type", "satellites", "los_probability", "links", "los_links", "windows", "sequence", "revision",
    "attempts", "number", "seq", "previous_seq", "schema_version", "status", "clients", "vehicles", "targets",
    "rows", "columns", "probability", "share", "vehicle_id", "mission_revision", "target_sequence",
    "weight", "area_factor", "redundant", "outliers", "power_score", "azimuth_score", "elevation_score",
    "containment", "walking_probability",
}  # fmt: skip


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_every_field_is_described_and_names_its_unit(model: type[wire.Model]) -> None:
    assert model.__doc__
    for name, field in model.model_fields.items():
        assert field.description, f"{model.__name__}.{name} has no description"
        numeric = re.search(r"\b(int|float)\b", str(field.annotation))
        if numeric and name not in UNITLESS and not name.endswith("_id"):
            unit = name.endswith(UNITS) or "_90_m" in name or "_amsl_m" in name
            assert unit, f"{model.__name__}.{name} is a number without a unit in its name"


def test_the_page_types_are_of_this_schema() -> None:
    types = (ROOT / "web" / "src" / "wire.ts").read_text()
    stamp = re.search(r"schema-sha256: ([0-9a-f]{64})", types)
    assert stamp is not None
    assert stamp[1] == schema.digest(), "web/src/wire.ts is stale: run `npm run wire` in web/ and commit it"


@pytest.mark.skipif(
    shutil.which("node") is None or not (ROOT / "web" / "node_modules").is_dir(),
    reason="needs node and web/node_modules (cd web && npm ci)",
)
def test_the_page_types_were_not_edited_by_hand() -> None:
    done = subprocess.run(
        ["node", "scripts/wire.mjs", "--check"], cwd=ROOT / "web", capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_the_schema_is_the_same_every_time() -> None:
    assert schema.text() == schema.text()
    stream = schema.json_schema()["properties"]["stream"]
    assert stream["discriminator"]["propertyName"] == "type"
