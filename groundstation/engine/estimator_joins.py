"""Ids that the operator joined: beacons that are one transmitter, and their joint beliefs.

Exists because a phone with a random address changes its id, and what was learned under the
old one is still true. Rules: only an operator joins (nothing is guessed); a join can be taken
back at any time: each id keeps its own belief and its own windows beside the joint belief;
windows of all ids count in the order of time; a joint belief is told under the id that the
others were joined into.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from groundstation.domain.errors import InputError
from groundstation.domain.target import TargetJoined
from groundstation.engine.estimator_beacon import Beacon

Merge = Callable[[list[Beacon]], Any]
"""A belief made of the windows of several beacons; None when none has one."""


class Joins:
    """Who is joined into whom, and the joint beacons by the id they are told under."""

    def __init__(self) -> None:
        self._into: dict[int, int] = {}
        self._joint: dict[int, Beacon] = {}
        self._told_ns: dict[int, int] = {}

    def joint_of(self, beacon_id: int) -> Beacon | None:
        """The joint beacon in which windows of this id count; None: it stands for itself."""
        return self._joint.get(self._into.get(beacon_id, beacon_id))

    def joints(self) -> list[Beacon]:
        """All joint beacons."""
        return list(self._joint.values())

    def others(self, root_id: int) -> tuple[int, ...]:
        """Ids joined into this one, rising."""
        return tuple(sorted(other for other, root in self._into.items() if root == root_id))

    def group_of(self, beacon_id: int) -> tuple[int, ...]:
        """Ids that are one transmitter with this one, itself among them; the one told comes first."""
        root_id = self._into.get(beacon_id, beacon_id)
        return (root_id, *self.others(root_id))

    def join(self, beacon_id: int, into_id: int, beacons: Mapping[int, Beacon], merge: Merge) -> int:
        """Join one id, with all that are joined into it, into another; the id that all are told under.

        Raises:
            InputError: an id that was never heard, or both are one already.
        """
        root_id = self._into.get(into_id, into_id)
        for needed in (beacon_id, into_id):
            if needed not in beacons:
                raise InputError(f"beacon {needed} was never heard")
        if beacon_id in self._into:
            raise InputError(
                f"beacon {beacon_id} is joined into {self._into[beacon_id]} already; separate it first"
            )
        if beacon_id == root_id:
            raise InputError(f"beacon {beacon_id} and beacon {into_id} are one already")
        followers = self.others(beacon_id)
        self._close(beacon_id, beacons)
        for other in (beacon_id, *followers):
            self._into[other] = root_id
        self._renew(root_id, beacons, merge)
        return root_id

    def separate(self, beacon_id: int, beacons: Mapping[int, Beacon], merge: Merge) -> int:
        """Take a join back; the id that it was joined into.

        Raises:
            InputError: the id is not joined into another.
        """
        root_id = self._into.get(beacon_id)
        if root_id is None:
            raise InputError(f"beacon {beacon_id} is not joined into another")
        del self._into[beacon_id]
        self._told_ns.pop(beacon_id, None)
        if self.others(root_id):
            self._renew(root_id, beacons, merge)
        else:
            self._close(root_id, beacons)
        return root_id

    def told(self, joint: Beacon, time_ns: int, beacons: Mapping[int, Beacon]) -> list[TargetJoined]:
        """What is new of the ids joined into this one."""
        news = []
        for other in self.others(joint.beacon_id):
            beacon = beacons[other]
            if self._told_ns.get(other) != beacon.last_heard_ns:
                self._told_ns[other] = beacon.last_heard_ns
                news.append(
                    TargetJoined(other, time_ns, beacon.first_heard_ns, beacon.last_heard_ns, joint.beacon_id)
                )
        return news

    def tell_again(self) -> None:
        """Everything is news: for a page that starts again."""
        self._told_ns.clear()

    def _renew(self, root_id: int, beacons: Mapping[int, Beacon], merge: Merge) -> None:
        """Make the joint beacon of an id anew, from what its ids hold."""
        before = self._joint.get(root_id)
        parts = [beacons[part] for part in (root_id, *self.others(root_id))]
        joint = Beacon(
            root_id, min(part.first_heard_ns for part in parts), max(part.last_heard_ns for part in parts)
        )
        joint.belief = merge(parts)
        if joint.belief is None:
            joint.pending = sorted(
                (heard for part in parts for heard in part.pending), key=lambda heard: heard.end_ns
            )
        for heard in (heard for part in parts for heard in part.newest.values()):
            held = joint.newest.get(heard.vehicle_id)
            if held is None or held.end_ns < heard.end_ns:
                joint.newest[heard.vehicle_id] = heard
        joint.windows = sum(part.windows for part in parts)
        # Numbers of updates rise whatever is joined and separated.
        joint.sequence = max(beacons[root_id].sequence, 0 if before is None else before.sequence)
        self._joint[root_id] = joint
        for other in self.others(root_id):
            self._told_ns.pop(other, None)

    def _close(self, root_id: int, beacons: Mapping[int, Beacon]) -> None:
        joint = self._joint.pop(root_id, None)
        if joint is not None:
            beacons[root_id].sequence = max(beacons[root_id].sequence, joint.sequence)

    def state(self, beacon_state: Callable[[Beacon], dict[str, Any]]) -> dict[str, Any]:
        """Plain values."""
        return {
            "into": [[other, root] for other, root in self._into.items()],
            "joint": [beacon_state(joint) for joint in self._joint.values()],
            "told_ns": [[other, told] for other, told in self._told_ns.items()],
        }

    @classmethod
    def restored(cls, tree: dict[str, Any], beacon_from: Callable[[dict[str, Any]], Beacon]) -> Joins:
        """The reverse."""
        joins = cls()
        joins._into = {int(other): int(root) for other, root in tree["into"]}
        joins._told_ns = {int(other): int(told) for other, told in tree["told_ns"]}
        for entry in tree["joint"]:
            joint = beacon_from(entry)
            joins._joint[joint.beacon_id] = joint
        return joins
