"""``python -m groundstation.server.schema``: the JSON Schema that the page's types come from."""

from __future__ import annotations

import hashlib
import json
import sys
from typing import Any

from pydantic import Field, TypeAdapter

from groundstation.server import rest, wire


class Wire(wire.Model):
    """Everything that passes between the station and the page."""

    stream: wire.StreamMessage = Field(description="What the stream sends.")
    confirm_body: rest.ConfirmBody = Field(description="Body of a confirmation.")
    action_answer: rest.ActionAnswer = Field(description="Answer to an action.")
    problem: rest.Problem = Field(description="Answer to what was refused.")
    join_body: rest.JoinBody = Field(description="Body of a join.")
    target_history: rest.TargetHistory = Field(description="How an estimate came about.")
    search_map: rest.SearchMap = Field(description="Raster of one beacon.")
    health: rest.Health = Field(description="Whether the station works.")
    events: rest.Events = Field(description="Older events.")


def json_schema() -> dict[str, Any]:
    """The schema, in the form in which values leave the server."""
    schema = TypeAdapter(Wire).json_schema(mode="serialization")
    _drop_titles(schema)
    return schema


def _drop_titles(node: Any, inside_properties: bool = False) -> None:
    # Each field's title would become a type alias of its own in TypeScript, and each reference
    # with a description beside it a copy of the type.
    if isinstance(node, dict):
        if "$ref" in node:
            node.pop("description", None)
        if not inside_properties and "properties" not in node and "$defs" not in node:
            node.pop("title", None)
        for key, value in node.items():
            _drop_titles(value, inside_properties=key in {"properties", "$defs"})
    elif isinstance(node, list):
        for value in node:
            _drop_titles(value)


def text() -> str:
    """The schema as text, the same every time."""
    return json.dumps(json_schema(), indent=2, sort_keys=True) + "\n"


def digest() -> str:
    """SHA-256 of the text; the generated types carry it in their first lines."""
    return hashlib.sha256(text().encode()).hexdigest()


if __name__ == "__main__":
    sys.stdout.write(text())
