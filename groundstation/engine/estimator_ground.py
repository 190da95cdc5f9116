"""The estimator's frame, search area and priors, from missions and the first place heard from.

Exists because they must outlive revisions of the mission. Rules: the frame is the first
mission origin of the session, whatever later revisions say, so that a revision costs no evidence;
over terrain the heights of targets count from the ground under them, elsewhere from the mission's
ground, and what is told says which.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import shapely

from groundstation.domain.errors import InputError
from groundstation.domain.events import Event, Severity
from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.mission import Area, Mission
from groundstation.engine.estimator_terrain import MOST_TIED_M, ground_heights
from groundstation.localization import SearchArea
from groundstation.localization.problem import FloatArray
from groundstation.tracking.belief import Field
from groundstation.tracking.prior import LastKnown, prior_field


class Ground:
    """Frame, mission and area; each None until it is known."""

    def __init__(self, default_radius_m: float) -> None:
        self._default_radius_m = default_radius_m
        self.frame: LocalFrame | None = None
        self.mission: Mission | None = None
        self.first_place: Geodetic | None = None
        """The first valid place that a beacon was heard from."""
        self._area: SearchArea | None = None
        self._tied_m: float | None = None

    def take(self, mission: Mission) -> bool:
        """A new revision; False where it changes nothing of the ground."""
        before, self.mission = self.mission, mission
        if self.frame is None and mission.origin is not None:
            self.frame = LocalFrame(mission.origin)
        if before is not None and _same_ground(before, mission):
            return False
        self._area = None
        self._tied_m = None
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
            if self._area is not None and mission.terrain is not None:
                heights, self._tied_m = ground_heights(mission, frame, self._area, ground_up)
                low, high = mission.target_height_min_m, mission.target_height_max_m
                self._area = self._area.over(heights, low, high)
        return self._area

    def height_reference(self, position_enu_m: FloatArray) -> str:
        """What the heights at a place are measured from, in the words of ``TargetState``."""
        area, mission = self._area, self.mission
        if area is not None and area.ground is not None:
            east, north = float(position_enu_m[0]), float(position_enu_m[1])
            if area.ground.is_known(east, north):
                return "terrain"
        return "unknown" if mission is None else mission.height_reference

    def prior(self, beacon_ids: Collection[int], doubt: float) -> Field | None:
        """What is known of a beacon's place, by any of its ids, before it is heard; None: nothing."""
        area, frame, mission = self.area(), self.frame, self.mission
        if area is None or frame is None or mission is None:
            return None
        altitude = frame.origin.altitude_amsl_m
        places = []
        for known in mission.last_known:
            if known.beacon_id is None or known.beacon_id in beacon_ids:
                east, north, _ = frame.to_enu(Geodetic(known.latitude_deg, known.longitude_deg, altitude))
                places.append(LastKnown(east, north, known.radius_m))
        return prior_field(places, area, doubt)

    def events(self, time_ns: int) -> list[Event]:
        """What the operator must know of the terrain since the mission's last change."""
        terrain, tied_m = None if self.mission is None else self.mission.terrain, self._tied_m
        if terrain is None or tied_m is None:
            return []
        self._tied_m = None
        away = f"{abs(tied_m):.1f} m {'lower' if tied_m > 0.0 else 'higher'} than the vehicles' home"
        if abs(tied_m) > MOST_TIED_M:
            text = (
                f"terrain {terrain.source} is {away}: too far to be shifted; its heights are used as they"
                " stand: are they metres above mean sea level?"
            )
            return [Event(time_ns, "terrain.disagrees", Severity.WARNING, text)]
        text = f"terrain {terrain.source} is {away} there; it is shifted to meet it"
        return [Event(time_ns, "terrain.tied", Severity.INFO, text)]


def _same_ground(a: Mission, b: Mission) -> bool:
    return (
        a.search_area == b.search_area
        and a.origin == b.origin
        and a.ground_amsl_m == b.ground_amsl_m
        and a.target_height_min_m == b.target_height_min_m
        and a.target_height_max_m == b.target_height_max_m
        and a.last_known == b.last_known
        and a.terrain == b.terrain
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
