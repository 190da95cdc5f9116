"""The estimator engine: link windows → verdicts, snapshots, beliefs.

Exists so that a live run and a replay execute the same code in the same order: a state
machine over windows, ticks, missions and session events that reads no clock. Rules: windows
are classified when they come and fused on ticks, all of a beacon's windows at once; nothing
is shared between beacons, and a fault in one never stops another; whatever is dropped is
counted; results are rounded.
"""

from __future__ import annotations

from collections import Counter as Tally
from collections.abc import Sequence
from typing import Any

from groundstation.domain.errors import InputError
from groundstation.domain.events import Counter, Event, Severity
from groundstation.domain.geometry import LocalFrame
from groundstation.domain.inputs import JoinInput, MissionInput, SessionInput, TickInput
from groundstation.domain.mission import Mission
from groundstation.domain.radio import LinkWindow, Listening
from groundstation.domain.target import (
    LinkVerdict,
    LosSource,
    SearchMap,
    TargetExplanation,
    TargetJoined,
    TargetState,
    TargetWaiting,
)
from groundstation.engine.estimator_beacon import Beacon
from groundstation.engine.estimator_explanations import due_explanation, explanation
from groundstation.engine.estimator_ground import Ground
from groundstation.engine.estimator_joins import Joins
from groundstation.engine.estimator_listening import Attention
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
from groundstation.localization import SearchArea
from groundstation.tracking import Tracker

EstimatorInput = LinkWindow | Listening | TickInput | MissionInput | SessionInput | JoinInput
EstimatorOutput = (
    LinkVerdict | TargetState | TargetWaiting | TargetJoined | TargetExplanation | SearchMap | Event
)

_STATE_VERSION = 3
_LIVELY_NS = 10_000_000_000
"""A beacon updated within the last ten seconds counts among those that take turns; the others rest."""
_AWAKE = 100
"""Of more lively beacons none keeps the megabytes (up to eight each) that make its next update cheaper."""


class Estimator:
    """See the module. ``classifier`` None: links without a sensor's answer stay unclassified."""

    def __init__(self, settings: EstimatorSettings, classifier: LinkClassifier | None) -> None:
        self._settings = settings
        self._classifier = classifier
        self._beacons: dict[int, Beacon] = {}
        self._ground = Ground(settings.default_radius_m)
        self._joins = Joins()
        self._attention = Attention(settings)
        self._explained_ns: int | None = None
        self._tally: Tally[str] = Tally()

    def handle(self, time_ns: int, item: EstimatorInput) -> list[EstimatorOutput]:
        """Take one input in order; what it changed."""
        if isinstance(item, LinkWindow):
            return self._window(time_ns, item)
        if isinstance(item, Listening):
            return self._listening(item)
        if isinstance(item, TickInput):
            return self._tick(time_ns)
        if isinstance(item, MissionInput):
            return self._new_mission(time_ns, item.mission)
        if isinstance(item, JoinInput):
            return self._join(time_ns, item)
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
        self._joins.tell_again()
        for beacon in self._believed():
            if beacon.belief is not None:
                beacon.regions_ns = None
                outputs.extend(self._tell(time_ns, beacon))
                outputs.append(explanation(time_ns, beacon, beacon.belief))
        return outputs

    def _believed(self) -> list[Beacon]:
        """Who has a belief to tell: ids that stand for themselves, and joint beacons."""
        alone = [b for b in self._beacons.values() if self._joins.joint_of(b.beacon_id) is None]
        return [*alone, *self._joins.joints()]

    def _join(self, time_ns: int, item: JoinInput) -> list[EstimatorOutput]:
        """What an operator says of two ids; a refusal is an event."""
        named = [item.beacon_id] if item.into_beacon_id is None else [item.beacon_id, item.into_beacon_id]
        for beacon_id in dict.fromkeys(part for name in named for part in self._joins.group_of(name)):
            if beacon_id in self._beacons:
                self._settle(self._beacons[beacon_id])
        try:
            if item.into_beacon_id is None:
                root_id = self._joins.separate(item.beacon_id, self._beacons, self._merged)
                text = f"beacon {item.beacon_id} was separated from {root_id} again by {item.who}"
            else:
                root_id = self._joins.join(item.beacon_id, item.into_beacon_id, self._beacons, self._merged)
                text = f"beacon {item.beacon_id} was joined into {root_id} by {item.who}"
        except InputError as error:
            self._tally["joins_refused"] += 1
            text = f"{item.who} asked to join or to separate beacons: {error}"
            return [Event(time_ns, "target.join_refused", Severity.WARNING, text, None, item.beacon_id)]
        self._tally["joins"] += 1
        outputs: list[EstimatorOutput] = [
            Event(time_ns, "target.joined", Severity.INFO, text, None, item.beacon_id)
        ]
        for beacon in self._believed():
            if beacon.beacon_id in (item.beacon_id, root_id):
                beacon.regions_ns = None
                outputs.extend(self._tell(time_ns, beacon))
        return outputs

    def _settle(self, beacon: Beacon) -> None:
        """Take in what waits, telling nobody: the beacon's own belief is wanted whole."""
        try:
            self._fuse(beacon)
        except SOLVER_FAULTS:
            self._tally["update_failures"] += 1

    def _merged(self, parts: list[Beacon]) -> Tracker | None:
        """One belief of the windows of several ids."""
        area = self._ground.area()
        beliefs = [part.belief for part in parts if part.belief is not None]
        if area is None or not beliefs:
            return None
        joint = self._new_belief(area, [part.beacon_id for part in parts])
        for belief in beliefs:
            joint.absorb(belief)
        return joint

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
            self._attention.begin(beacon)
        if self._ground.first_place is None:
            self._ground.first_place = window.position
        classified = verdict.source is not LosSource.PRIOR
        assumed_m = self._settings.localization.model.vehicle_std_m
        heard = Heard.of(window, verdict.los_probability, classified, assumed_m)
        joint = self._joins.joint_of(window.beacon_id)
        frame = self._ground.frame
        for holder in (beacon,) if joint is None else (beacon, joint):
            if frame is not None:
                self._attention.window(holder, window, heard, frame)
            if not holder.take(heard, window.start_ns, self._settings.maximum_pending):
                # An id that is joined keeps its windows only for the case that it is separated again.
                apart = holder is not joint and joint is not None
                self._tally["windows_apart_dropped" if apart else "windows_pending_dropped"] += 1
        return outputs

    def _listening(self, item: Listening) -> list[EstimatorOutput]:
        if self._ground.frame is None:
            self._tally["listening_without_frame"] += 1
            return []
        joints = [(joint, self._joins.group_of(joint.beacon_id)) for joint in self._joins.joints()]
        alone = [(beacon, (beacon.beacon_id,)) for beacon in self._beacons.values()]
        self._attention.listening(item, self._ground.frame, [*alone, *joints])
        return []

    def _renew_silences(self, time_ns: int) -> list[Beacon]:
        """Weigh anew what nobody heard where that is due, of a few beacons a tick; whose belief it moved."""
        moved: list[Beacon] = []
        for beacon in self._believed():
            if len(moved) >= self._settings.updates_per_tick:
                break
            if self._attention.renew(beacon, time_ns):
                moved.append(beacon)
        self._tally["silences_weighed"] += len(moved)
        return moved

    def _new_mission(self, time_ns: int, mission: Mission) -> list[EstimatorOutput]:
        if not self._ground.take(mission):
            return []
        try:
            area = self._ground.area()
        except InputError as error:
            self._tally["areas_refused"] += 1
            text = f"search area of mission revision {mission.revision} cannot be used: {error}"
            return [Event(time_ns, "mission.area_refused", Severity.ERROR, text)]
        outputs: list[EstimatorOutput] = [*self._ground.events(time_ns)]
        told = self._believed()
        for beacon in [*self._beacons.values(), *self._joins.joints()]:
            if beacon.belief is not None and area is not None:
                beacon.belief.set_area(area)
                beacon.belief.set_field("prior", self._ground.prior(self._ids(beacon), self._doubt))
                beacon.snapshot = None
                if beacon in told:
                    outputs.extend(self._target(time_ns, beacon, beacon.belief))
        return outputs

    def _tick(self, time_ns: int, *, final: bool = False) -> list[EstimatorOutput]:
        outputs: list[EstimatorOutput] = []
        moved = self._renew_silences(time_ns)
        due = self._due(time_ns, final)
        for beacon in moved:
            if beacon not in due:
                outputs.extend(self._tell(time_ns, beacon))
        for beacon in due:
            beacon.updated_ns = time_ns
            waiting = len(beacon.pending)
            try:
                outputs.extend(self._update(time_ns, beacon))
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
        self._rest(time_ns)
        why = due_explanation(self._believed(), time_ns, self._explained_ns, self._settings)
        if why is not None and why.belief is not None:
            self._explained_ns = time_ns
            outputs.append(explanation(time_ns, why, why.belief))
        return outputs

    def _due(self, time_ns: int, final: bool) -> list[Beacon]:
        """Whom this tick updates: all that wait at the end, else those that may and waited longest."""
        waiting = [beacon for beacon in self._believed() if beacon.pending]
        if final:
            return waiting
        latest_ns = time_ns - int(self._settings.update_interval_s * 1e9)
        due = [b for b in waiting if b.updated_ns is None or b.updated_ns <= latest_ns]
        due.sort(key=lambda b: -1 if b.updated_ns is None else b.updated_ns)
        if len(due) > self._settings.updates_per_tick:
            self._tally["updates_put_off"] += len(due) - self._settings.updates_per_tick
        return due[: self._settings.updates_per_tick]

    def _update(self, time_ns: int, beacon: Beacon) -> list[EstimatorOutput]:
        first = beacon.belief is None
        self._fuse(beacon)
        outputs: list[EstimatorOutput] = []
        if first and beacon.belief is not None:
            vehicles = len(beacon.belief.vehicles)
            text = f"beacon {beacon.beacon_id}: first estimate, from {vehicles} vehicle(s)"
            outputs.append(
                Event(time_ns, "target.first_estimate", Severity.INFO, text, None, beacon.beacon_id)
            )
        return [*outputs, *self._tell(time_ns, beacon)]

    def _fuse(self, beacon: Beacon) -> None:
        """Take the windows that wait into the beacon's belief; they go on waiting without an area."""
        area, frame = self._ground.area(), self._ground.frame
        if area is None or frame is None or not beacon.pending:
            return
        batch, beacon.pending = beacon.pending, []
        belief = beacon.belief or self._new_belief(area, self._ids(beacon))
        result = belief.update(
            [observation(heard, place) for heard, place in zip(batch, places_enu(batch, frame), strict=True)]
        )
        for name in ("taken", "redundant", "empty", "outliers", "forgotten"):
            self._tally[f"windows_{name}"] += getattr(result, name)
        if belief.windows > 0:
            beacon.belief = belief

    def _new_belief(self, area: SearchArea, beacon_ids: Sequence[int]) -> Tracker:
        tracker = Tracker(area, self._settings.localization.model, self._settings.tracking, beacon_ids[0])
        tracker.set_field("prior", self._ground.prior(beacon_ids, self._doubt))
        return tracker

    def _ids(self, beacon: Beacon) -> Sequence[int]:
        """The ids that it stands for, the one told first; a part of a joint beacon stands for itself."""
        joint = self._joins.joint_of(beacon.beacon_id) is beacon
        return self._joins.group_of(beacon.beacon_id) if joint else (beacon.beacon_id,)

    @property
    def _doubt(self) -> float:
        return self._settings.tracking.last_known_doubt

    def _tell(self, time_ns: int, beacon: Beacon) -> list[EstimatorOutput]:
        """The newest of a beacon and of the ids joined into it."""
        told: list[EstimatorOutput] = [*self._joins.told(beacon, time_ns, self._beacons)]
        if beacon.belief is not None:
            return [*self._target(time_ns, beacon, beacon.belief), *told]
        if self._ground.frame is None or self._ground.area() is None:
            needed = (
                f"heard by {len(beacon.newest)} vehicle(s); the mission's origin is needed:"
                " a vehicle's home position, or set it by hand"
            )
        else:
            needed = (
                f"heard by {len(beacon.newest)} vehicle(s), but no window had received power"
                " or line-of-sight angles; one is needed"
            )
        waiting = TargetWaiting(beacon.beacon_id, time_ns, beacon.first_heard_ns, len(beacon.newest), needed)
        return [waiting, *told]

    def _target(self, time_ns: int, beacon: Beacon, belief: Tracker) -> list[TargetState | SearchMap]:
        frame = self._ground.frame
        # A belief exists only on an area, and an area only in a frame.
        assert frame is not None
        others = self._joins.others(beacon.beacon_id)
        reference = self._ground.height_reference(belief.mass @ belief.mesh.center_enu_m)
        lively = self._lively(time_ns)
        return target_state(
            time_ns, beacon, belief, frame, reference, self._settings, self._tally, others, lively
        )

    def _lively(self, time_ns: int) -> list[Beacon]:
        """Beacons that are told of these days."""
        oldest_ns = time_ns - _LIVELY_NS
        return [b for b in self._believed() if b.updated_ns is not None and b.updated_ns > oldest_ns]

    def _rest(self, time_ns: int) -> None:
        """Beliefs that nothing comes for, or all of too many, keep no more than they must."""
        lively = self._lively(time_ns)
        awake = {beacon.beacon_id for beacon in lively} if len(lively) <= _AWAKE else set()
        for beacon in self._believed():
            if beacon.belief is not None and beacon.beacon_id not in awake:
                beacon.belief.rest()

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
            "joins": self._joins.state(beacon_state),
            "explained_ns": self._explained_ns,
            "attention": self._attention.state(),
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
        self._joins = Joins.restored(tree["joins"], lambda entry: beacon_from(entry, area, self._settings))
        self._explained_ns = tree["explained_ns"]
        self._attention = Attention(self._settings)
        self._attention.restore(tree["attention"])
        for beacon in [*self._beacons.values(), *self._joins.joints()]:
            if beacon.belief is not None:
                beacon.belief.set_field("prior", ground.prior(self._ids(beacon), self._doubt))
