"""GPX 1.1: a waypoint for each beacon, for handheld receivers.

Elevations are above mean sea level, as GPX has them. Elements stand in the order that the
GPX schema demands.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree.ElementTree import Element

from groundstation.domain.target import TargetState
from groundstation.export.markup import child, document
from groundstation.export.rounding import degrees, describe, iso_time, newest, number


def encode_gpx(targets: Sequence[TargetState]) -> bytes:
    """The newest belief of each beacon, by beacon id."""
    root = Element("gpx", version="1.1", creator="groundstation", xmlns="http://www.topografix.com/GPX/1/1")
    for target in newest(targets):
        place = target.position
        latitude, longitude = degrees(place.latitude_deg), degrees(place.longitude_deg)
        waypoint = child(root, "wpt", lat=f"{latitude:.7f}", lon=f"{longitude:.7f}")
        altitude = number(place.altitude_amsl_m)
        if altitude is not None:
            child(waypoint, "ele", f"{altitude:.2f}")
        if when := iso_time(target.time_ns):
            child(waypoint, "time", when)
        child(waypoint, "name", str(target.beacon_id))
        child(waypoint, "desc", describe(target))
        child(waypoint, "sym", "Beacon")
        child(waypoint, "type", target.environment.name)
    return document(root)
