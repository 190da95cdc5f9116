"""Where the beacons are, for other programs: pure encoders from values to bytes.

Rule: the same beliefs give the same bytes. Numbers are rounded to what they are worth,
integers that can pass 2⁵³ are decimal text, and nothing here opens a file or reads a clock.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from groundstation.domain.errors import UsageError
from groundstation.domain.target import TargetState
from groundstation.export.geojson import encode_geojson
from groundstation.export.gpx import encode_gpx
from groundstation.export.kml import encode_kml
from groundstation.export.search_map import search_map_archive, search_map_files
from groundstation.export.tables import encode_csv, encode_json

ENCODERS: dict[str, Callable[[Sequence[TargetState]], bytes]] = {
    "json": encode_json,
    "geojson": encode_geojson,
    "kml": encode_kml,
    "gpx": encode_gpx,
    "csv": encode_csv,
}
"""Encoder of each format; the names are those of ``--format`` and the usual file endings."""


def encode(file_format: str, targets: Sequence[TargetState]) -> bytes:
    """``targets`` in ``file_format``, one of ``ENCODERS``. Raises UsageError for another one."""
    encoder = ENCODERS.get(file_format)
    if encoder is None:
        raise UsageError(f"unknown format {file_format!r}; one of {', '.join(ENCODERS)} is needed")
    return encoder(targets)


__all__ = [
    "ENCODERS",
    "encode",
    "encode_csv",
    "encode_geojson",
    "encode_gpx",
    "encode_json",
    "encode_kml",
    "search_map_archive",
    "search_map_files",
]
