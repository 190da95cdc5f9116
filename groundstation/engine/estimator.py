"""The estimator engine: link windows → verdicts, snapshots, beliefs.

Exists so that a live run and a replay execute the same code in the same order: a state
machine over windows, ticks, missions and session events that reads no clock. Rules: windows
are classified when they come and fused on ticks, all of a beacon's windows at once; nothing
is shared between beacons, and a fault in one never stops another; whatever is dropped is
counted; results are rounded.
"""

from __future__ import annotations

from collections import Counter as Tally
from typing import Any

from groundstation.domain.errors import InputError
from groundstation.domain.events import Counter, Event, Severity
from groundstation.domain.geometry import LocalFrame
from groundstation.domain.inputs import MissionInput, SessionInput, TickInput
from groundstation.domain.mission import Mission
from groundstation.domain.radio import LinkWindow
from groundstation.domain.target import LinkVerdict, LosSource, TargetState, TargetWaiting
from groundstation.engine.estimator_beacon import Beacon
from groundstation.engine.estimator_ground import Ground
from groundstation.engine.estimator_output import Heard, places_enu
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.engine.estimator_state import (
    beacon_from,
    beacon_state,
    mission_from,
    mission_state,
    place_from,
    place_state,
)
from groundstation.engine.estimator_targets import observation, target_state
from groundstation.engine.estimator_verdicts import SOLVER_FAULTS, LinkClassifier, judge
from groundstation.tracking import Belief

EstimatorInput = LinkWindow | TickInput | MissionInput | SessionInput
EstimatorOutput = LinkVerdict | TargetState | TargetWaiting | Event

_STATE_VERSION = 2


class Estimator:
    """See the module. ``classifier`` None: links without a sensor's answer stay unclassified."""

    def __init__(self, settings: EstimatorSettings, classifier: LinkClassifier | None) -> None:
        self._settings = settings
        self._classifier = classifier
        self._beacons: dict[int, Beacon] = {}
        self._ground = Ground(settings.default_radius_m)
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
        self._tally["windows"] += 1
        prior = self._settings.prior_los_probability
        verdict, events = judge(window, time_ns, self._classifier, prior, self._tally)
        outputs: list[EstimatorOutput] = [*events, verdict]
        if not window.position.is_valid():
            self._tally["windows_without_position"] += 1
            return outputs
        beacon = self._beacons.get(window.beacon_id)
        if beacon is None:
            if len(self._beacons) >= self._settings.maximum_beacons:
                self._tally["windows_of_refused_beacons"] += 1
                return outputs
            beacon = Beacon(window.beacon_id, window.start_ns, window.end_ns)
            self._beacons[window.beacon_id] = beacon
        beacon.first_heard_ns = min(beacon.first_heard_ns, window.start_ns)
        beacon.last_heard_ns = max(beacon.last_heard_ns, window.end_ns)
        beacon.windows += 1
        if self._ground.first_place is None:
            self._ground.first_place = window.position
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

    def _new_mission(self, time_ns: int, mission: Mission) -> list[EstimatorOutput]:
        if not self._ground.take(mission):
            return []
        try:
            area = self._ground.area()
        except InputError as error:
            self._tally["areas_refused"] += 1
            text = f"search area of mission revision {mission.revision} cannot be used: {error}"
            return [Event(time_ns, "mission.area_refused", Severity.ERROR, text)]
        outputs: list[EstimatorOutput] = []
        for beacon in self._beacons.values():
            if beacon.belief is not None and area is not None:
                beacon.belief.set_area(area)
                beacon.snapshot = None
                outputs.append(self._target(time_ns, beacon, beacon.belief))
        return outputs

    def _tick(self, time_ns: int, *, final: bool = False) -> list[EstimatorOutput]:
        outputs: list[EstimatorOutput] = []
        for beacon in self._due(time_ns, final):
            beacon.updated_ns = time_ns
            waiting = len(beacon.pending)
            try:
                outputs.append(self._update(time_ns, beacon, outputs))
                beacon.failed = False
            except SOLVER_FAULTS as error:
                self._tally["update_failures"] += 1
                self._tally["windows_lost_to_failures"] += waiting - len(beacon.pending)
                if not beacon.failed:
                    text = f"beacon {beacon.beacon_id} could not be updated: {error}"
                    outputs.append(
                        Event(time_ns, "target.update_failed", Severity.ERROR, text, None, beacon.beacon_id)
                    )
                beacon.failed = True
        return outputs

    def _due(self, time_ns: int, final: bool) -> list[Beacon]:
        """Whom this tick updates: all that wait at the end, else those that may and waited longest."""
        waiting = [beacon for beacon in self._beacons.values() if beacon.pending]
        if final:
            return waiting
        latest_ns = time_ns - int(self._settings.update_interval_s * 1e9)
        due = [b for b in waiting if b.updated_ns is None or b.updated_ns <= latest_ns]
        due.sort(key=lambda b: -1 if b.updated_ns is None else b.updated_ns)
        if len(due) > self._settings.updates_per_tick:
            self._tally["updates_put_off"] += len(due) - self._settings.updates_per_tick
        return due[: self._settings.updates_per_tick]

    def _update(
        self, time_ns: int, beacon: Beacon, outputs: list[EstimatorOutput]
    ) -> TargetState | TargetWaiting:
        area, frame = self._ground.area(), self._ground.frame
        if area is None or frame is None:
            needed = (
                f"heard by {len(beacon.newest)} vehicle(s); the mission's origin is needed:"
                " a vehicle's home position, or set it by hand"
            )
            return TargetWaiting(beacon.beacon_id, time_ns, beacon.first_heard_ns, len(beacon.newest), needed)
        batch, beacon.pending = beacon.pending, []
        belief = beacon.belief
        if belief is None:
            belief = Belief(area, self._settings.localization.model, self._settings.tracking)
        result = belief.update(
            [observation(heard, place) for heard, place in zip(batch, places_enu(batch, frame), strict=True)]
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

    def _target(self, time_ns: int, beacon: Beacon, belief: Belief) -> TargetState:
        frame, mission = self._ground.frame, self._ground.mission
        # A belief exists only on an area, and an area only in a frame.
        assert frame is not None
        assert mission is not None
        return target_state(
            time_ns, beacon, belief, frame, mission.height_reference, self._settings, self._tally
        )

    def state(self) -> dict[str, Any]:
        """Everything but settings, classifier and mission; ``restore`` continues bit for bit.

        The mission is part of the tree by what the estimator uses of it; its own records
        bring the rest.
        """
        ground = self._ground
        return {
            "version": _STATE_VERSION,
            "beacons": [beacon_state(beacon) for beacon in self._beacons.values()],
            "frame": None if ground.frame is None else place_state(ground.frame.origin),
            "first_place": None if ground.first_place is None else place_state(ground.first_place),
            "mission": None if ground.mission is None else mission_state(ground.mission),
            "counters": dict(self._tally),
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take the place of the estimator whose ``state`` this is. Raises InputError on another version."""
        if tree.get("version") != _STATE_VERSION:
            raise InputError(
                f"estimator state has version {tree.get('version')}; version {_STATE_VERSION} is needed"
            )
        self._tally = Tally({str(name): int(value) for name, value in tree["counters"].items()})
        ground = self._ground = Ground(self._settings.default_radius_m)
        ground.frame = None if tree["frame"] is None else LocalFrame(place_from(tree["frame"]))
        ground.first_place = None if tree["first_place"] is None else place_from(tree["first_place"])
        ground.mission = None if tree["mission"] is None else mission_from(tree["mission"])
        area = ground.area()
        self._beacons = {}
        for entry in tree["beacons"]:
            beacon = beacon_from(entry, area, self._settings)
            self._beacons[beacon.beacon_id] = beacon
