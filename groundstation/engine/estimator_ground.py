"""The estimator's frame and search area, from missions and the first place heard from.

Exists because both must outlive revisions of the mission. Rule: the frame is the first
mission origin of the session, whatever later revisions say, so that a revision costs no evidence.
"""

from __future__ import annotations

import numpy as np
import shapely

from groundstation.domain.errors import InputError
from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.mission import Area, Mission
from groundstation.localization import SearchArea


class Ground:
    """Frame, mission and area; each None until it is known."""

    def __init__(self, default_radius_m: float) -> None:
        self._default_radius_m = default_radius_m
        self.frame: LocalFrame | None = None
        self.mission: Mission | None = None
        self.first_place: Geodetic | None = None
        """The first valid place that a beacon was heard from."""
        self._area: SearchArea | None = None

    def take(self, mission: Mission) -> bool:
        """A new revision; False where it changes nothing of the ground."""
        before, self.mission = self.mission, mission
        if self.frame is None and mission.origin is not None:
            self.frame = LocalFrame(mission.origin)
        if before is not None and _same_ground(before, mission):
            return False
        self._area = None
        return True

    def area(self) -> SearchArea | None:
        """In the frame; None while origin or place are not known. Raises InputError."""
        if self._area is None and self.frame is not None and self.mission is not None:
            mission, frame = self.mission, self.frame
            ground = mission.ground_amsl_m
            if ground is None:
                ground = (mission.origin or frame.origin).altitude_amsl_m
            ground_up = ground - frame.origin.altitude_amsl_m
            low, high = ground_up + mission.target_height_min_m, ground_up + mission.target_height_max_m
            if mission.search_area is not None:
                self._area = SearchArea.of_polygon(_polygon(mission.search_area, frame), low, high)
            elif self.first_place is not None:
                east, north, _ = frame.to_enu(self.first_place)
                self._area = SearchArea(np.array([east, north]), self._default_radius_m, low, high)
        return self._area


def _same_ground(a: Mission, b: Mission) -> bool:
    return (
        a.search_area == b.search_area
        and a.origin == b.origin
        and a.ground_amsl_m == b.ground_amsl_m
        and a.target_height_min_m == b.target_height_min_m
        and a.target_height_max_m == b.target_height_max_m
    )


def _polygon(area: Area, frame: LocalFrame) -> shapely.MultiPolygon:
    altitude = frame.origin.altitude_amsl_m

    def ring(corners: tuple[tuple[float, float], ...]) -> list[tuple[float, float]]:
        return [frame.to_enu(Geodetic(latitude, longitude, altitude))[:2] for latitude, longitude in corners]

    try:
        polygons = [
            shapely.Polygon(ring(rings[0]), [ring(hole) for hole in rings[1:]]) for rings in area.polygons
        ]
    except (ValueError, IndexError) as error:
        raise InputError(f"a ring of the search area is no polygon ({error})") from error
    return shapely.MultiPolygon(polygons)
