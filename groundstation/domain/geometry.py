"""Places and directions: WGS84, the mission's local frame, attitudes.

Inside the station positions are east, north, up (ENU) metres from the mission's origin;
at its edges (vehicles, map, files) they are WGS84 with altitude above mean sea level.
Over a search area the geoid's undulation is constant to centimetres, so altitudes above
mean sea level take the place of ellipsoidal heights in both directions of the conversion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import pymap3d

Enu = tuple[float, float, float]
"""East, north, up from the mission's origin, metres."""

Quaternion = tuple[float, float, float, float]
"""(w, x, y, z), unit norm, rotating the airframe (forward, right, down) to north, east, down."""


@dataclass(frozen=True, slots=True)
class Geodetic:
    """A place on WGS84."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    """Above mean sea level."""

    def is_valid(self) -> bool:
        """Whether the numbers are finite and in range, and not the 0/0 of a receiver without a fix."""
        return (
            math.isfinite(self.latitude_deg)
            and math.isfinite(self.longitude_deg)
            and math.isfinite(self.altitude_amsl_m)
            and abs(self.latitude_deg) <= 90.0
            and abs(self.longitude_deg) <= 180.0
            and not (self.latitude_deg == 0.0 and self.longitude_deg == 0.0)
        )


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """East–north–up tangent plane at ``origin``."""

    origin: Geodetic

    def to_enu(self, place: Geodetic) -> Enu:
        """ENU metres of ``place``."""
        east, north, up = pymap3d.geodetic2enu(
            place.latitude_deg,
            place.longitude_deg,
            place.altitude_amsl_m,
            self.origin.latitude_deg,
            self.origin.longitude_deg,
            self.origin.altitude_amsl_m,
        )
        return float(east), float(north), float(up)

    def to_geodetic(self, position_enu_m: Enu) -> Geodetic:
        """WGS84 place of an ENU position."""
        latitude, longitude, altitude = pymap3d.enu2geodetic(
            position_enu_m[0],
            position_enu_m[1],
            position_enu_m[2],
            self.origin.latitude_deg,
            self.origin.longitude_deg,
            self.origin.altitude_amsl_m,
        )
        return Geodetic(float(latitude), float(longitude), float(altitude))


def distance_m(a: Enu, b: Enu) -> float:
    """Euclidean distance of two ENU positions."""
    return math.dist(a, b)


def wrap_angle_rad(angle_rad: float) -> float:
    """The same angle in [−π, π)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi
