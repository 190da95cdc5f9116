"""The estimator engine: link windows → verdicts, snapshots, beliefs.

Exists so that a live run and a replay execute the same code in the same order: a state
machine over windows, ticks, missions and session events that reads no clock. Rules: windows
are classified when they come and fused on ticks, all of a beacon's windows at once; nothing
is shared between beacons, and a fault in one never stops another; whatever is dropped is
counted; results are rounded.

Positions are kept in a frame of the estimator's own: the first mission origin of the
session, whatever later revisions say, so that a new revision costs no evidence.
"""

from __future__ import annotations

from collections import Counter as Tally
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import shapely

from groundstation.channel import ChannelCapture
from groundstation.domain.errors import GroundstationError, InputError
from groundstation.domain.events import Counter, Event, Severity
from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.inputs import MissionInput, SessionInput, TickInput
from groundstation.domain.mission import Area, Mission
from groundstation.domain.radio import LinkWindow
from groundstation.domain.target import (
    Environment,
    LinkVerdict,
    LosSource,
    SnapshotEstimate,
    TargetState,
    TargetWaiting,
)
from groundstation.engine.estimator_output import (
    HEARD_FIELDS,
    Heard,
    covariance_tuple,
    heard_row,
    places_enu,
    regions_geodetic,
    rounded_place,
    snapshot_from_state,
    snapshot_state,
)
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.localization import Links, SearchArea, environment_of, locate
from groundstation.localization.problem import FloatArray
from groundstation.tracking import Belief, TrackObservation, containment, region_rings

EstimatorInput = LinkWindow | TickInput | MissionInput | SessionInput
EstimatorOutput = LinkVerdict | TargetState | TargetWaiting | Event

_METHOD = "posterior-filter"
_STATE_VERSION = 1
# What an impossible problem or a solver may raise; anything else is a fault to be seen.
_SOLVER_FAULTS = (GroundstationError, ValueError, ArithmeticError, IndexError, np.linalg.LinAlgError)


class LinkClassifier(Protocol):
    """What the estimator needs of ``groundstation.channel``'s classifier."""

    def classify(
        self, links: Sequence[Sequence[ChannelCapture]], *, prior: float | None = None
    ) -> Sequence[Any]:
        """One verdict a link: ``los_probability``, ``status``, ``reason``."""
        ...


@dataclass(slots=True, eq=False)
class _Beacon:
    beacon_id: int
    first_heard_ns: int
    last_heard_ns: int
    pending: list[Heard] = field(default_factory=list)
    newest: dict[int, Heard] = field(default_factory=dict)
    belief: Belief | None = None
    sequence: int = 0
    windows: int = 0
    updated_ns: int | None = None
    snapshot_ns: int | None = None
    regions_ns: int | None = None
    snapshot: SnapshotEstimate | None = None
    failed: bool = False


class Estimator:
    """See the module. ``classifier`` None: links without a sensor's answer stay unclassified."""

    def __init__(self, settings: EstimatorSettings, classifier: LinkClassifier | None) -> None:
        self._settings = settings
        self._classifier = classifier
        self._beacons: dict[int, _Beacon] = {}
        self._frame: LocalFrame | None = None
        self._first_place: Geodetic | None = None
        self._mission: Mission | None = None
        self._area: SearchArea | None = None
        self._tally: Tally[str] = Tally()

    def handle(self, time_ns: int, item: EstimatorInput) -> list[EstimatorOutput]:
        """Take one input in order; what it changed."""
        if isinstance(item, LinkWindow):
            return self._window(time_ns, item)
        if isinstance(item, TickInput):
            return self._tick(time_ns)
        if isinstance(item, MissionInput):
            return self._new_mission(time_ns, item.mission)
        if item.event == "resumed":
            # Windows from before the stop are evidence still, but no longer a snapshot.
            for beacon in self._beacons.values():
                beacon.newest.clear()
                beacon.snapshot = None
            return self._tell_all(time_ns)
        if item.event == "ended":
            return [*self._tick(time_ns, final=True), *self._tell_all(time_ns)]
        return []

    def _tell_all(self, time_ns: int) -> list[EstimatorOutput]:
        """Every belief with its regions: for a page that starts again, for the file that is left."""
        outputs: list[EstimatorOutput] = []
        for beacon in self._beacons.values():
            if beacon.belief is not None:
                beacon.regions_ns = None
                outputs.append(self._target(time_ns, beacon, beacon.belief))
        return outputs

    def counters(self) -> list[Counter]:
        """Running totals, sorted by name."""
        return [Counter(f"estimator_{name}_total", (), self._tally[name]) for name in sorted(self._tally)]

    def _window(self, time_ns: int, window: LinkWindow) -> list[EstimatorOutput]:
        outputs: list[EstimatorOutput] = []
        self._tally["windows"] += 1
        verdict = self._verdict(time_ns, window, outputs)
        outputs.append(verdict)
        if not window.position.is_valid():
            self._tally["windows_without_position"] += 1
            return outputs
        beacon = self._beacons.get(window.beacon_id)
        if beacon is None:
            if len(self._beacons) >= self._settings.maximum_beacons:
                self._tally["windows_of_refused_beacons"] += 1
                return outputs
            beacon = _Beacon(window.beacon_id, window.start_ns, window.end_ns)
            self._beacons[window.beacon_id] = beacon
        beacon.first_heard_ns = min(beacon.first_heard_ns, window.start_ns)
        beacon.last_heard_ns = max(beacon.last_heard_ns, window.end_ns)
        beacon.windows += 1
        if self._first_place is None:
            self._first_place = window.position
        classified = verdict.source is not LosSource.PRIOR
        heard = Heard.of(window, verdict.los_probability, classified)
        beacon.pending.append(heard)
        if len(beacon.pending) > self._settings.maximum_pending:
            del beacon.pending[0]
            self._tally["windows_pending_dropped"] += 1
        held = beacon.newest.get(window.vehicle_id)
        if held is None or held.end_ns <= heard.end_ns:
            beacon.newest[window.vehicle_id] = heard
        return outputs

    def _verdict(self, time_ns: int, window: LinkWindow, outputs: list[EstimatorOutput]) -> LinkVerdict:
        probability, source, reason = self._settings.prior_los_probability, LosSource.PRIOR, "no capture"
        if window.captures and self._classifier is None:
            reason = "no classifier loaded"
        elif window.captures and self._classifier is not None:
            captures = [
                ChannelCapture(capture.magnitude, capture.tap_spacing_ns, capture.first_path_index)
                for capture in window.captures
            ]
            try:
                answer = self._classifier.classify([captures], prior=probability)[0]
                reason = str(answer.reason)
                if str(answer.status) == "classified":
                    probability, source = float(answer.los_probability), LosSource.CLASSIFIER
            except _SOLVER_FAULTS as error:
                self._tally["classifier_failures"] += 1
                reason = f"classifier failed: {error}"
                outputs.append(
                    Event(
                        time_ns, "link.classifier_failed", Severity.ERROR, reason,
                        window.vehicle_id, window.beacon_id,
                    )
                )  # fmt: skip
        if source is LosSource.PRIOR and window.sensor_los_probability is not None:
            probability, source = float(window.sensor_los_probability), LosSource.SENSOR
            reason = ""
        self._tally[f"links_by_{source.value}"] += 1
        return LinkVerdict(
            window.vehicle_id, window.beacon_id, window.end_ns, round(probability, 6), source, reason,
            window.rss_dbm, window.azimuth_rad, window.elevation_rad, len(window.captures),
        )  # fmt: skip

    def _new_mission(self, time_ns: int, mission: Mission) -> list[EstimatorOutput]:
        before = self._mission
        self._mission = mission
        if self._frame is None and mission.origin is not None:
            self._frame = LocalFrame(mission.origin)
        if before is not None and _same_ground(before, mission):
            return []
        self._area = None
        outputs: list[EstimatorOutput] = []
        try:
            self._ensure_area()
        except InputError as error:
            self._tally["areas_refused"] += 1
            text = f"search area of mission revision {mission.revision} cannot be used: {error}"
            return [Event(time_ns, "mission.area_refused", Severity.ERROR, text)]
        for beacon in self._beacons.values():
            if beacon.belief is not None and self._area is not None:
                beacon.belief.set_area(self._area)
                beacon.snapshot = None
                outputs.append(self._target(time_ns, beacon, beacon.belief))
        return outputs

    def _ensure_area(self) -> SearchArea | None:
        """The search area in the estimator's frame; None while origin or place are not known."""
        if self._area is None and self._frame is not None and self._mission is not None:
            mission, frame = self._mission, self._frame
            ground = mission.ground_amsl_m
            if ground is None:
                ground = (mission.origin or frame.origin).altitude_amsl_m
            ground_up = ground - frame.origin.altitude_amsl_m
            low, high = ground_up + mission.target_height_min_m, ground_up + mission.target_height_max_m
            if mission.search_area is not None:
                self._area = SearchArea.of_polygon(_polygon(mission.search_area, frame), low, high)
            elif self._first_place is not None:
                east, north, _ = frame.to_enu(self._first_place)
                radius = self._settings.default_radius_m
                self._area = SearchArea(np.array([east, north]), radius, low, high)
        return self._area

    def _tick(self, time_ns: int, *, final: bool = False) -> list[EstimatorOutput]:
        outputs: list[EstimatorOutput] = []
        interval_ns = int(self._settings.update_interval_s * 1e9)
        for beacon in self._beacons.values():
            if not beacon.pending:
                continue
            recent = beacon.updated_ns is not None and time_ns - beacon.updated_ns < interval_ns
            if recent and not final:
                continue
            beacon.updated_ns = time_ns
            waiting = len(beacon.pending)
            try:
                outputs.append(self._update(time_ns, beacon, outputs))
                beacon.failed = False
            except _SOLVER_FAULTS as error:
                self._tally["update_failures"] += 1
                self._tally["windows_lost_to_failures"] += waiting - len(beacon.pending)
                if not beacon.failed:
                    text = f"beacon {beacon.beacon_id} could not be updated: {error}"
                    outputs.append(
                        Event(time_ns, "target.update_failed", Severity.ERROR, text, None, beacon.beacon_id)
                    )
                beacon.failed = True
        return outputs

    def _update(
        self, time_ns: int, beacon: _Beacon, outputs: list[EstimatorOutput]
    ) -> TargetState | TargetWaiting:
        area = self._ensure_area()
        if area is None or self._frame is None:
            needed = (
                f"heard by {len(beacon.newest)} vehicle(s); the mission's origin is needed:"
                " a vehicle's home position, or set it by hand"
            )
            return TargetWaiting(beacon.beacon_id, time_ns, beacon.first_heard_ns, len(beacon.newest), needed)
        frame = self._frame
        batch, beacon.pending = beacon.pending, []
        belief = beacon.belief
        if belief is None:
            belief = Belief(area, self._settings.localization.model, self._settings.tracking)
        result = belief.update(
            [_observation(heard, place) for heard, place in zip(batch, places_enu(batch, frame), strict=True)]
        )
        for name in ("taken", "redundant", "empty", "outliers", "forgotten"):
            self._tally[f"windows_{name}"] += getattr(result, name)
        if belief.windows == 0:
            needed = (
                f"heard by {len(beacon.newest)} vehicle(s), but no window had received power"
                " or line-of-sight angles; one is needed"
            )
            return TargetWaiting(beacon.beacon_id, time_ns, beacon.first_heard_ns, len(beacon.newest), needed)
        if beacon.belief is None:
            beacon.belief = belief
            text = f"beacon {beacon.beacon_id}: first estimate, from {len(belief.vehicles)} vehicle(s)"
            outputs.append(
                Event(time_ns, "target.first_estimate", Severity.INFO, text, None, beacon.beacon_id)
            )
        return self._target(time_ns, beacon, belief)

    def _fresh(self, time_ns: int, beacon: _Beacon) -> list[Heard]:
        """The newest window of each vehicle, by vehicle, within age and distance limits."""
        limits = self._settings.localization
        oldest = time_ns - int(limits.window_age_s * 1e9)
        chosen = []
        for vehicle in sorted(beacon.newest):
            heard = beacon.newest[vehicle]
            if heard.end_ns < oldest:
                continue
            if heard.path_length_m > limits.window_path_m or heard.rss_dbm is None:
                continue
            chosen.append(heard)
        return chosen

    def _target(self, time_ns: int, beacon: _Beacon, belief: Belief) -> TargetState:
        frame, mission = self._frame, self._mission
        assert frame is not None
        assert mission is not None
        mass = belief.mass
        summary = containment(belief.mesh, mass)
        fresh = self._fresh(time_ns, beacon)
        model = self._settings.localization.model
        environment, los_count = Environment.UNKNOWN, 0
        if fresh:
            links = _links(fresh, frame)
            environment = environment_of(links, model)
            los_count = int(links.los(model.los_threshold).sum())
            self._snapshot(time_ns, beacon, fresh, links, belief.area)
        else:
            beacon.snapshot = None
        regions: tuple[Any, ...] = ()
        due = int(self._settings.regions_interval_s * 1e9)
        if beacon.regions_ns is None or time_ns - beacon.regions_ns >= due:
            beacon.regions_ns = time_ns
            regions = regions_geodetic(region_rings(belief.mesh, mass), frame)
        beacon.sequence += 1
        east, north, up = (float(value) for value in summary.position_enu_m)
        return TargetState(
            beacon_id=beacon.beacon_id,
            time_ns=time_ns,
            first_heard_ns=beacon.first_heard_ns,
            last_heard_ns=beacon.last_heard_ns,
            position=rounded_place(frame.to_geodetic((east, north, up))),
            covariance_enu_m2=covariance_tuple(summary.covariance_m2),
            radius_90_m=round(summary.radius_90_m, 2),
            environment=environment,
            los_links=los_count,
            links=len(fresh),
            windows=beacon.windows,
            method=_METHOD,
            height_reference=mission.height_reference,
            sequence=beacon.sequence,
            snapshot=beacon.snapshot,
            regions=regions,
        )

    def _snapshot(
        self, time_ns: int, beacon: _Beacon, fresh: list[Heard], links: Links, area: SearchArea
    ) -> None:
        """Algorithm 1 on the newest windows, when it is due and has enough of them."""
        settings = self._settings.localization
        if len(fresh) < settings.model.minimum_links:
            self._tally["snapshots_too_few_links"] += 1
            beacon.snapshot = None
            return
        due = int(self._settings.snapshot_interval_s * 1e9)
        if beacon.snapshot_ns is not None and time_ns - beacon.snapshot_ns < due:
            return
        beacon.snapshot_ns = time_ns
        try:
            estimate = locate(links, area, "adaptive", settings.model, settings.choice)
        except _SOLVER_FAULTS:
            # The belief does not need the snapshot; all vehicles in one place is a normal sight.
            self._tally["snapshot_failures"] += 1
            beacon.snapshot = None
            return
        self._tally["snapshots"] += 1
        frame = self._frame
        assert frame is not None
        east, north, up = (float(value) for value in estimate.position_enu_m)
        los = links.los(settings.model.los_threshold)
        power = estimate.transmit_power_dbm
        beacon.snapshot = SnapshotEstimate(
            time_ns=time_ns,
            position=rounded_place(frame.to_geodetic((east, north, up))),
            covariance_enu_m2=covariance_tuple(estimate.covariance_m2),
            environment=estimate.environment,
            method=estimate.method,
            transmit_power_dbm=round(power, 3) if np.isfinite(power) else None,
            path_loss_exponent=tuple(round(float(value), 4) for value in estimate.path_loss_exponent),
            vehicle_ids=tuple(heard.vehicle_id for heard in fresh),
            los_vehicle_ids=tuple(h.vehicle_id for h, is_los in zip(fresh, los, strict=True) if is_los),
            status=estimate.status,
        )

    def state(self) -> dict[str, Any]:
        """Everything but settings, classifier and mission; ``restore`` continues bit for bit.

        The mission is part of the tree by what the estimator uses of it; its own records
        bring the rest.
        """
        beacons = []
        for beacon in self._beacons.values():
            newest = list(beacon.newest.values())
            beacons.append(
                {
                    "beacon_id": beacon.beacon_id,
                    "first_heard_ns": beacon.first_heard_ns,
                    "last_heard_ns": beacon.last_heard_ns,
                    "pending": [heard_row(heard) for heard in beacon.pending],
                    "newest": [heard_row(heard) for heard in newest],
                    "belief": None if beacon.belief is None else beacon.belief.state(),
                    "sequence": beacon.sequence,
                    "windows": beacon.windows,
                    "updated_ns": beacon.updated_ns,
                    "snapshot_ns": beacon.snapshot_ns,
                    "regions_ns": beacon.regions_ns,
                    "snapshot": None if beacon.snapshot is None else snapshot_state(beacon.snapshot),
                    "failed": beacon.failed,
                }
            )
        return {
            "version": _STATE_VERSION,
            "beacons": beacons,
            "frame": None if self._frame is None else _place_state(self._frame.origin),
            "first_place": None if self._first_place is None else _place_state(self._first_place),
            "mission": None if self._mission is None else _mission_state(self._mission),
            "counters": dict(self._tally),
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take the place of the estimator whose ``state`` this is. Raises InputError on another version."""
        if tree.get("version") != _STATE_VERSION:
            raise InputError(
                f"estimator state has version {tree.get('version')}; version {_STATE_VERSION} is needed"
            )
        self._tally = Tally({str(name): int(value) for name, value in tree["counters"].items()})
        self._frame = None if tree["frame"] is None else LocalFrame(_place(tree["frame"]))
        self._first_place = None if tree["first_place"] is None else _place(tree["first_place"])
        self._mission = None if tree["mission"] is None else _mission(tree["mission"])
        self._area = None
        area = self._ensure_area()
        self._beacons = {}
        for entry in tree["beacons"]:
            beacon = _Beacon(
                int(entry["beacon_id"]), int(entry["first_heard_ns"]), int(entry["last_heard_ns"])
            )
            beacon.pending = [_heard(row) for row in entry["pending"]]
            for heard in (_heard(row) for row in entry["newest"]):
                beacon.newest[heard.vehicle_id] = heard
            if entry["belief"] is not None and area is not None:
                beacon.belief = Belief.restore(
                    entry["belief"], area, self._settings.localization.model, self._settings.tracking
                )
            beacon.sequence, beacon.windows = int(entry["sequence"]), int(entry["windows"])
            beacon.updated_ns, beacon.snapshot_ns = entry["updated_ns"], entry["snapshot_ns"]
            beacon.regions_ns, beacon.failed = entry["regions_ns"], bool(entry["failed"])
            if entry["snapshot"] is not None:
                beacon.snapshot = snapshot_from_state(entry["snapshot"])
            self._beacons[beacon.beacon_id] = beacon


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


def _observation(heard: Heard, place: FloatArray) -> TrackObservation:
    return TrackObservation(
        heard.vehicle_id, (float(place[0]), float(place[1]), float(place[2])),
        heard.rss_dbm, heard.rss_std_error_db,
        heard.azimuth_rad, heard.elevation_rad, heard.azimuth_std_rad, heard.elevation_std_rad,
        heard.los_probability, heard.classified,
    )  # fmt: skip


def _links(fresh: list[Heard], frame: LocalFrame) -> Links:
    def numbers(name: str) -> list[float]:
        return [np.nan if getattr(heard, name) is None else getattr(heard, name) for heard in fresh]

    return Links(
        places_enu(fresh, frame),
        np.array(numbers("rss_dbm")),
        np.array(numbers("azimuth_rad")),
        np.array(numbers("elevation_rad")),
        # A link that nobody judged counts as NLOS.
        np.array([heard.los_probability if heard.classified else 0.0 for heard in fresh]),
    )


def _heard(row: list[Any]) -> Heard:
    return Heard(**dict(zip(HEARD_FIELDS, row, strict=True)))


def _place_state(place: Geodetic) -> list[float]:
    return [place.latitude_deg, place.longitude_deg, place.altitude_amsl_m]


def _place(values: Any) -> Geodetic:
    return Geodetic(float(values[0]), float(values[1]), float(values[2]))


def _mission_state(mission: Mission) -> dict[str, Any]:
    area = mission.search_area
    return {
        "revision": mission.revision,
        "origin": None if mission.origin is None else _place_state(mission.origin),
        "search_area": None
        if area is None
        else [[[list(corner) for corner in ring] for ring in polygon] for polygon in area.polygons],
        "search_area_name": "" if area is None else area.name,
        "target_height_min_m": mission.target_height_min_m,
        "target_height_max_m": mission.target_height_max_m,
        "ground_amsl_m": mission.ground_amsl_m,
        "height_reference": mission.height_reference,
    }


def _mission(tree: dict[str, Any]) -> Mission:
    area = None
    if tree["search_area"] is not None:
        polygons = tuple(
            tuple(tuple((float(lat), float(lon)) for lat, lon in ring) for ring in polygon)
            for polygon in tree["search_area"]
        )
        area = Area(polygons, str(tree["search_area_name"]))
    return Mission(
        revision=int(tree["revision"]),
        origin=None if tree["origin"] is None else _place(tree["origin"]),
        search_area=area,
        target_height_min_m=float(tree["target_height_min_m"]),
        target_height_max_m=float(tree["target_height_max_m"]),
        ground_amsl_m=None if tree["ground_amsl_m"] is None else float(tree["ground_amsl_m"]),
        height_reference=str(tree["height_reference"]),
    )
