"""Who listened where, kept for every beacon: what the estimator reads silences from.

Exists to keep listening, which is told of vehicles, apart from beacons, which have beliefs.
Rule: a beacon's silences are its own (``tracking.silence``); shared are only what is known of the
receivers and where vehicles listened before a beacon was first heard. The newest intervals wait
in a short queue, because a beacon's first window comes some seconds after its first packet.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from groundstation.domain.geometry import Enu, LocalFrame
from groundstation.domain.radio import LinkWindow, Listening
from groundstation.engine.estimator_beacon import Beacon
from groundstation.engine.estimator_output import Heard
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.tracking.places import EAST, SUMS, VEHICLE, Places
from groundstation.tracking.receivers import Receivers
from groundstation.tracking.silence import Ear, Silence

_QUEUE = 16
"""Intervals that wait: half a minute; a window is told within seven seconds of its first packet."""
_STRONG_DB = 10.0
"""So far above its limit a vehicle hears a beacon well: it would not lose it over a few metres."""
_FRESH_NS = 15_000_000_000
_PLACES = 4
"""So many times a beacon's places are kept of listening before anything was heard."""


@dataclass(frozen=True, slots=True)
class _Interval:
    """A ``Listening`` in the frame."""

    start_ns: int
    end_ns: int
    listeners: tuple[tuple[int, Enu, tuple[tuple[int, int], ...]], ...]

    def ears(self, ids: Collection[int]) -> list[Ear]:
        """As a beacon with these ids sees it. A packet without a level still counts as one."""
        return [
            Ear(vehicle, place, sum(max(count, 1) for beacon, count in packets if beacon in ids))
            for vehicle, place, packets in self.listeners
        ]


class Attention:
    """See the module."""

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        tracking = settings.tracking
        self.receivers = Receivers(tracking)
        self._queue: deque[_Interval] = deque()
        self._before = Places(1, tracking.silence_spacing_m, _PLACES * tracking.maximum_silent_places)

    def listening(
        self, item: Listening, frame: LocalFrame, beacons: list[tuple[Beacon, tuple[int, ...]]]
    ) -> None:
        """One interval, for each beacon and the ids under which it speaks."""
        interval = _Interval(
            item.start_ns,
            item.end_ns,
            tuple((ear.vehicle_id, frame.to_enu(ear.position), ear.packets) for ear in item.listeners),
        )
        for beacon, ids in beacons:
            self._listen(beacon, ids, interval)
        self._queue.append(interval)
        if len(self._queue) > _QUEUE:
            past = self._queue.popleft()
            seconds = 1e-9 * (past.end_ns - past.start_ns)
            for vehicle, place, _ in past.listeners:
                self._before.add(vehicle, place, (seconds,))

    def _silence(self, beacon: Beacon) -> Silence:
        if beacon.silence is None:
            beacon.silence = Silence(self._settings.tracking)
        return beacon.silence

    def begin(self, beacon: Beacon) -> None:
        """A beacon that was not known: where it was listened for before."""
        ids = (beacon.beacon_id,)
        for row in self._before.rows:
            self._silence(beacon).before(int(row[VEHICLE]), row[EAST:SUMS].tolist(), float(row[SUMS]))
        heard = False
        for interval in self._queue:
            ears = interval.ears(ids)
            heard = heard or any(ear.packets for ear in ears)
            if heard:
                self._listen(beacon, ids, interval)
                continue
            for ear in ears:
                seconds = 1e-9 * (interval.end_ns - interval.start_ns)
                self._silence(beacon).before(ear.vehicle_id, ear.position_enu_m, seconds)

    def window(self, beacon: Beacon, window: LinkWindow, heard: Heard, frame: LocalFrame) -> None:
        """A window of the beacon."""
        self.receivers.heard(window.vehicle_id, window.rss_dbm, window.noise_dbm)
        # A link that nobody judged counts as NLOS, as its power does in the belief.
        los_probability = heard.los_probability if heard.classified else 0.0
        self._silence(beacon).heard(
            window.vehicle_id, frame.to_enu(window.position), window.rss_dbm, los_probability,
            (window.rss_count, window.missed_count),
        )  # fmt: skip

    def _listen(self, beacon: Beacon, ids: tuple[int, ...], interval: _Interval) -> None:
        strong = []
        for vehicle, heard in beacon.newest.items():
            limit = self.receivers.sensitivity_dbm(vehicle)
            if heard.rss_dbm is None or limit is None or interval.end_ns - heard.end_ns > _FRESH_NS:
                continue
            if heard.rss_dbm >= limit + _STRONG_DB:
                strong.append(vehicle)
        start_s, end_s = 1e-9 * interval.start_ns, 1e-9 * interval.end_ns
        self._silence(beacon).listen(start_s, end_s, interval.ears(ids), strong)

    def renew(self, beacon: Beacon, time_ns: int) -> bool:
        """Bring the belief's silence up to date where that is due; whether it changed."""
        silence, belief = beacon.silence, beacon.belief
        due_ns = int(self._settings.silence_interval_s * 1e9)
        if belief is None or silence is None or not silence.changed:
            return False
        if beacon.silence_ns is not None and time_ns - beacon.silence_ns < due_ns:
            return False
        beacon.silence_ns, silence.changed = time_ns, False
        field = silence.field(self.receivers, self._settings.localization.model)
        before = beacon.silence_field
        if (field is None and before is None) or (
            field is not None and before is not None and field.resembles(before)
        ):
            return False
        beacon.silence_field = field
        belief.set_field("silence", field)
        return True

    def state(self) -> dict[str, Any]:
        """Everything, as arrays and plain values."""
        return {
            "receivers": self.receivers.state(),
            "before": self._before.state(),
            "queue": [
                [
                    past.start_ns,
                    past.end_ns,
                    [
                        [vehicle, list(place), [list(p) for p in packets]]
                        for vehicle, place, packets in past.listeners
                    ],
                ]
                for past in self._queue
            ],
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state`` gave."""
        self.receivers.restore(tree["receivers"])
        self._before.restore(tree["before"])
        self._queue = deque(
            _Interval(
                int(start_ns),
                int(end_ns),
                tuple(
                    (int(v), (place[0], place[1], place[2]), tuple((int(b), int(n)) for b, n in packets))
                    for v, place, packets in listeners
                ),
            )
            for start_ns, end_ns, listeners in tree["queue"]
        )
