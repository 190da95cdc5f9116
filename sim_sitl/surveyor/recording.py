"""The recording of a survey, as a ground station would have kept it: a ``.tlog`` and an area.

Rule: frames say what a vehicle's do, with its units and its rounding, and nothing of the truth.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.tlog import TlogWriter
from sim_sitl.modes import Flavour
from sim_sitl.surveyor.flight import POSE_HZ, Flight
from sim_sitl.surveyor.survey import Survey
from sim_sitl.telemetry import Picture, build

ORIGIN = Geodetic(47.3769, 8.5417, 420.0)
START_UNIX_USEC = 1_760_000_000_000_000
BEACON_ID = 0xA17
_HEARTBEAT, _ATTITUDE, _POSITION, _HOME = 0, 30, 33, 242


def write_tlog(flight: Flight, path: Path) -> None:
    """The recording of a flight: heartbeat, home, poses and SAR_RSS, as a vehicle sends them."""
    frame = LocalFrame(ORIGIN)
    encoder = Encoder(1, 1)
    records: list[tuple[float, int, Any]] = []
    for i, time_s in enumerate(flight.pose_s):
        picture = _picture(flight, i, frame)
        wanted = [_ATTITUDE, _POSITION]
        if i % POSE_HZ == 0:
            wanted = [_HEARTBEAT, *wanted]
        if i % (10 * POSE_HZ) == 0:
            wanted.append(_HOME)
        records += [(float(time_s), 0, build(message, picture)) for message in wanted]
    for n, (time_s, power_db) in enumerate(zip(flight.sample_s, flight.power_db, strict=True)):
        message = dialect.MAVLink_sar_rss_message(
            START_UNIX_USEC + round(float(time_s) * 1e6), BEACON_ID, round(flight.survey.frequency_hz),
            round(float(power_db) * 100.0), -32768, n & 0xFFFF,
        )  # fmt: skip
        records.append((float(time_s) + 0.05, 1, message))
    records.sort(key=lambda record: record[:2])
    with TlogWriter(path) as writer:
        for time_s, _, message in records:
            writer.write(START_UNIX_USEC + round(time_s * 1e6), encoder.pack(message))


def _picture(flight: Flight, i: int, frame: LocalFrame) -> Picture:
    roll, pitch, yaw = (float(value) for value in flight.attitude_rad[i])
    east, north, up = (float(value) for value in flight.position_enu_m[i])
    half = [0.5 * angle for angle in (roll, pitch, yaw)]
    (cr, cp, cy), (sr, sp, sy) = map(math.cos, half), map(math.sin, half)
    return Picture(
        flavour=Flavour.ARDUPILOT,
        boot_ms=10_000 + round(float(flight.pose_s[i]) * 1e3),
        unix_usec=START_UNIX_USEC + round(float(flight.pose_s[i]) * 1e6),
        position=frame.to_geodetic((east, north, up)),
        height_above_home_m=up,
        velocity_enu_m_s=(
            float(flight.velocity_enu_m_s[i, 0]),
            float(flight.velocity_enu_m_s[i, 1]),
            float(flight.velocity_enu_m_s[i, 2]),
        ),
        roll_rad=roll,
        pitch_rad=pitch,
        yaw_rad=yaw,
        rates_rad_s=(0.0, 0.0, 0.0),
        attitude=(
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
        home=ORIGIN,
        target=None,
        custom_mode=4,
        armed=True,
        landed=False,
        booting=False,
        aligned=True,
        prearm_healthy=True,
        estimator_ready=True,
        guided=False,
        battery_percent=80.0,
    )


def area_geojson(survey: Survey) -> dict[str, Any]:
    """The search area as a GeoJSON Feature."""
    frame, half = LocalFrame(ORIGIN), survey.half_width_m
    corners = [(-half, -half), (half, -half), (half, half), (-half, half), (-half, -half)]
    places = [frame.to_geodetic((east, north, 0.0)) for east, north in corners]
    ring = [[round(place.longitude_deg, 8), round(place.latitude_deg, 8)] for place in places]
    return {
        "type": "Feature",
        "properties": {"name": "survey"},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }


def write_area(survey: Survey, path: Path) -> None:
    """``area_geojson`` as a file."""
    path.write_text(json.dumps(area_geojson(survey)) + "\n", encoding="utf-8")
