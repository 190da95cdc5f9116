"""Live grants: the only thing that lets a command frame leave the station.

A grant names vehicle, command and target and dies by itself within seconds. A hold revokes
all grants of its vehicle before anything else happens, so a retry that a library still has
in its queue finds no grant. Grants are never stored: nothing survives a restart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from groundstation.domain.geometry import Geodetic
from groundstation.safety.settings import SafetySettings

_METRES_PER_DEGREE = 111_320.0


@dataclass(frozen=True, slots=True)
class Grant:
    """Leave to send one command, retries included."""

    grant_id: str
    vehicle_id: int
    command: int
    """MAV_CMD."""
    target: Geodetic
    expires_ns: int
    """Station time after which it matches nothing."""


class Grants:
    """All live grants; at most one for each vehicle."""

    def __init__(self, settings: SafetySettings | None = None) -> None:
        self._settings = settings or SafetySettings()
        self._by_vehicle: dict[int, Grant] = {}
        self._held_ns: dict[int, int] = {}
        self.issued_total = 0
        self.revoked_total = 0

    def issue(self, grant_id: str, vehicle_id: int, command: int, target: Geodetic, time_ns: int) -> Grant:
        """A new grant, in place of any older one of the vehicle."""
        lifetime_ns = round(self._settings.grant_lifetime_s * 1e9)
        grant = Grant(grant_id, vehicle_id, command, target, time_ns + lifetime_ns)
        self._by_vehicle[vehicle_id] = grant
        self.issued_total += 1
        return grant

    def revoke(self, vehicle_id: int) -> Grant | None:
        """Ends the vehicle's grant, at once; returns it if there was one."""
        grant = self._by_vehicle.pop(vehicle_id, None)
        self.revoked_total += grant is not None
        return grant

    def hold(self, vehicle_id: int, time_ns: int) -> Grant | None:
        """Revokes and remembers when, for ``in_hold_shadow``."""
        self._held_ns[vehicle_id] = time_ns
        return self.revoke(vehicle_id)

    def forget_all(self) -> None:
        """On a restart or resume."""
        self._by_vehicle.clear()
        self._held_ns.clear()

    def live(self, vehicle_id: int, time_ns: int) -> Grant | None:
        """The vehicle's grant, unless it has expired."""
        grant = self._by_vehicle.get(vehicle_id)
        return grant if grant is not None and time_ns <= grant.expires_ns else None

    def match(self, vehicle_id: int, command: int, target: Geodetic, time_ns: int) -> Grant | None:
        """The live grant that covers this command, target equal to within the rounding of the wire."""
        grant = self.live(vehicle_id, time_ns)
        if grant is None or grant.command != command:
            return None
        north_m = (target.latitude_deg - grant.target.latitude_deg) * _METRES_PER_DEGREE
        east_m = (target.longitude_deg - grant.target.longitude_deg) * _METRES_PER_DEGREE
        up_m = target.altitude_amsl_m - grant.target.altitude_amsl_m
        # Written so that a NaN never matches.
        near = math.hypot(north_m, east_m, up_m) <= self._settings.grant_tolerance_m
        return grant if near else None

    def in_hold_shadow(self, vehicle_id: int, time_ns: int) -> bool:
        """Whether the vehicle was held so recently that other stations' retries must not move it."""
        held_ns = self._held_ns.get(vehicle_id)
        return held_ns is not None and time_ns - held_ns <= self._settings.hold_shadow_s * 1e9
