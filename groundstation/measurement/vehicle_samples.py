"""One vehicle's radio samples on their way to windows: clock, pose, link.

A sample comes in with its sensor's time, is mapped to station time, waits for a pose that
covers it, is placed, and joins its link's window. Nothing leaves this path without a name:
the counters below are all the ways out besides a window.

| counter | why |
|---|---|
| ``sample_clock_unsettled_total`` | the sensor's time disagrees with its clock's map, not confirmed yet |
| ``sample_duplicate_total`` | the same packet again |
| ``sample_invalid_total`` | no level in it, or a direction that is none |
| ``sample_no_pose_total`` | waited in vain for a pose (label: the pose's outcome) |
| ``sample_no_attitude_total`` | angles in the airframe's frame, and no attitude |
| ``sample_waiting_overflow_total`` | too many waited; the oldest made room |
| ``sample_late_total`` | older than its link's window |
| ``sample_forgotten_total`` | was waiting when clocks or session began anew |
| ``link_overflow_total`` | more beacons than are followed |
"""

from __future__ import annotations

from collections import deque
from typing import Any

from groundstation.domain.radio import LinkActivity, LinkWindow
from groundstation.mavlink.messages import AoaSample, CirFragment, LinkStateReport, RssSample
from groundstation.measurement.angles import body_bearing, earth_bearing, known_std, usable_angles
from groundstation.measurement.cir_assembly import CirAssembler, CirOutcome
from groundstation.measurement.link import Link
from groundstation.measurement.link_window import Taken
from groundstation.measurement.pose_history import Pose, PoseHistory, PoseOutcome
from groundstation.measurement.sequence import BeaconSequence
from groundstation.measurement.settings import MeasurementSettings
from groundstation.measurement.tally import Tally
from groundstation.measurement.vehicle_clock import OffsetMap
from groundstation.measurement.waiting import (
    Waiting,
    WaitingAoa,
    WaitingCir,
    WaitingRss,
    sample_of,
    sample_state,
)

_RECENT_KEPT = 64


class VehicleSamples:
    """All links of one vehicle. Arrival and station times are nanoseconds."""

    def __init__(
        self,
        settings: MeasurementSettings,
        vehicle_id: int,
        poses: PoseHistory,
        pose_map: OffsetMap,
        tally: Tally,
    ) -> None:
        self.vehicle_id = vehicle_id
        self._settings = settings
        self._wait_ns = round(settings.pose_wait_s * 1e9)
        self._interval_ns = round(settings.activity_interval_s * 1e9)
        self._poses = poses
        self._pose_map = pose_map
        self._tally = tally
        self._label = f"vehicle={vehicle_id}"
        self._links: dict[int, Link] = {}
        self._waiting: deque[Waiting] = deque()
        self._assembler = CirAssembler(settings)
        self._last_query: tuple[int, Pose | PoseOutcome] | None = None
        self.unplaced = 0
        """Samples dropped for want of a pose since the caller last looked; the caller sets 0."""
        self.unturned = 0
        """Body-frame angles dropped for want of an attitude since the caller last looked."""
        self.cir_complete = 0
        """Captures completed since the caller last looked; the caller sets 0."""
        self.cir_incomplete = 0
        """Captures given up since the caller last looked; the caller sets 0."""

    @property
    def beacons(self) -> list[int]:
        """Beacons heard, in the order first heard."""
        return list(self._links)

    def rss(self, message: RssSample, station_ns: int, arrival_ns: int) -> LinkActivity | None:
        """Take a power sample; an activity report if one is due."""
        link = self._link(message.beacon_id)
        if link is None:
            return None
        recent = link.rss_recent
        key = (message.sequence, message.time_usec)
        if key in recent:
            self._tally.add("sample_duplicate_total", self._label)
            return None
        recent[key] = None
        if len(recent) > _RECENT_KEPT:
            del recent[next(iter(recent))]
        link.sequence.observe(message.sequence, arrival_ns)
        rss_dbm = message.rss_dbm
        if rss_dbm is None:
            self._tally.add("sample_invalid_total", self._label)
            return None
        link.samples += 1
        link.rss_dbm = rss_dbm
        link.noise_dbm = message.noise_dbm
        self._wait(
            WaitingRss(
                station_ns, arrival_ns, message.beacon_id, rss_dbm, message.noise_dbm, message.frequency_hz
            )
        )
        return self._activity(message.beacon_id, link, arrival_ns)

    def aoa(self, message: AoaSample, station_ns: int, arrival_ns: int) -> LinkActivity | None:
        """Take a bearing; an activity report if one is due."""
        if not usable_angles(message.azimuth_rad, message.elevation_rad):
            self._tally.add("sample_invalid_total", self._label)
            return None
        link = self._link(message.beacon_id)
        if link is None:
            return None
        recent = link.aoa_recent
        key = (message.time_usec, message.azimuth_rad, message.elevation_rad)
        if key in recent:
            self._tally.add("sample_duplicate_total", self._label)
            return None
        recent[key] = None
        if len(recent) > _RECENT_KEPT:
            del recent[next(iter(recent))]
        link.samples += 1
        self._wait(
            WaitingAoa(
                station_ns,
                arrival_ns,
                message.beacon_id,
                message.azimuth_rad,
                message.elevation_rad,
                known_std(message.azimuth_std_rad),
                known_std(message.elevation_std_rad),
                message.body_frame,
            )
        )
        return self._activity(message.beacon_id, link, arrival_ns)

    def cir(self, message: CirFragment, station_ns: int, arrival_ns: int) -> LinkActivity | None:
        """Take a fragment of an impulse response; an activity report if one is due."""
        link = self._link(message.beacon_id)
        if link is None:
            return None
        found = self._assembler.add(message, station_ns, arrival_ns)
        if self._assembler.given_up:
            self._count_given_up()
        if found is None:
            return None
        if isinstance(found, CirOutcome):
            self._tally.add(f"{found.value}_total", self._label)
            return None
        self._tally.add("cir_complete_total", self._label)
        self.cir_complete += 1
        link.captures += 1
        self._wait(WaitingCir(found.time_ns, arrival_ns, message.beacon_id, found))
        return self._activity(message.beacon_id, link, arrival_ns)

    def link_state(self, message: LinkStateReport, station_ns: int, arrival_ns: int) -> LinkActivity | None:
        """Take the sensor's own line-of-sight answer; an activity report if one is due."""
        if not 0.0 <= message.los_probability <= 1.0:
            self._tally.add("link_state_invalid_total", self._label)
            return None
        link = self._link(message.beacon_id)
        if link is None:
            return None
        if not link.windows.note_link_state(station_ns, message.los_probability):
            self._tally.add("link_state_stale_total", self._label)
        return self._activity(message.beacon_id, link, arrival_ns)

    def place_covered(self, closed: list[LinkWindow]) -> None:
        """Place the waiting samples that the poses cover by now."""
        waiting = self._waiting
        if not waiting:
            return
        covered_ns = self._poses.covered_ns()
        offset_ns = self._pose_map.offset_ns
        if covered_ns is None or offset_ns is None:
            return
        until_ns = covered_ns + offset_ns
        if waiting[0].time_ns > until_ns:
            return
        self._last_query = None
        kept: deque[Waiting] = deque()
        while waiting:
            sample = waiting.popleft()
            if sample.time_ns > until_ns:
                kept.append(sample)
                # Samples of one sensor come almost in order: the rest is younger still, but for
                # captures, which waited for their fragments and are found at the next pose.
                if len(kept) >= 8:
                    break
                continue
            self._place(sample, offset_ns, False, closed)
        waiting.extendleft(reversed(kept))

    def tick(self, now_ns: int, closed: list[LinkWindow], activities: list[LinkActivity]) -> None:
        """Let time pass: give up waiting, close windows, report links."""
        self._assembler.tick(now_ns)
        if self._assembler.given_up:
            self._count_given_up()
        self.place_covered(closed)
        waiting = self._waiting
        if waiting and now_ns - waiting[0].arrival_ns >= self._wait_ns:
            self._give_up_waiting(now_ns - self._wait_ns, closed)
        for beacon_id, link in self._links.items():
            link.windows.tick(now_ns, closed)
            if link.active and (link.reported_ns is None or now_ns - link.reported_ns >= self._interval_ns):
                activities.append(self._report(beacon_id, link, now_ns))

    def end(self, closed: list[LinkWindow]) -> None:
        """Nothing more will come: place what can be placed and close all windows."""
        self.place_covered(closed)
        self._give_up_waiting(None, closed)
        for link in self._links.values():
            link.windows.end(closed)

    def forget_stream(self) -> None:
        """Drop all that lives by the stream: samples under way, open windows, partial captures."""
        if self._waiting:
            self._tally.add("sample_forgotten_total", self._label, len(self._waiting))
            self._waiting.clear()
        forgotten = self._assembler.clear()
        if forgotten:
            self._tally.add("cir_incomplete_total", self._label, forgotten)
        self._last_query = None
        for link in self._links.values():
            if link.windows.is_open:
                self._tally.add("window_forgotten_total", self._label)
            link.windows.forget()
            link.sequence = BeaconSequence(self._settings.beacon_rate_max_hz)
            link.rss_recent = {}
            link.aoa_recent = {}

    def follow(self, poses: PoseHistory, pose_map: OffsetMap) -> None:
        """Use these poses and this clock from now on."""
        self._poses = poses
        self._pose_map = pose_map
        self._last_query = None

    def sensor_restarted(self) -> None:
        """The sensor's clock began anew: its counters did too."""
        for link in self._links.values():
            link.sequence = BeaconSequence(self._settings.beacon_rate_max_hz)

    def _link(self, beacon_id: int) -> Link | None:
        link = self._links.get(beacon_id)
        if link is None:
            if len(self._links) >= self._settings.links_per_vehicle:
                self._tally.add("link_overflow_total", self._label)
                return None
            link = self._links[beacon_id] = Link(self._settings, self.vehicle_id, beacon_id)
        return link

    def _wait(self, sample: Waiting) -> None:
        waiting = self._waiting
        if len(waiting) >= self._settings.waiting_samples:
            waiting.popleft()
            self._tally.add("sample_waiting_overflow_total", self._label)
            self.unplaced += 1
        waiting.append(sample)

    def _give_up_waiting(self, arrived_until_ns: int | None, closed: list[LinkWindow]) -> None:
        """Place at last, or drop, the samples that arrived until then (None: all)."""
        waiting = self._waiting
        offset_ns = self._pose_map.offset_ns
        self._last_query = None
        while waiting and (arrived_until_ns is None or waiting[0].arrival_ns <= arrived_until_ns):
            self._place(waiting.popleft(), offset_ns, True, closed)

    def _place(
        self,
        sample: Waiting,
        offset_ns: int | None,
        final: bool,
        closed: list[LinkWindow],
    ) -> None:
        if offset_ns is None:
            self._unplaced(PoseOutcome.MISSING)
            return
        boot_ns = sample.time_ns - offset_ns
        query = self._last_query
        if query is not None and query[0] == boot_ns:
            pose = query[1]
        else:
            pose = self._poses.at(boot_ns, final=final)
            self._last_query = (boot_ns, pose)
        if isinstance(pose, PoseOutcome):
            self._unplaced(pose)
            return
        link = self._links[sample.beacon_id]
        windows = link.windows
        if link.sequence.missed:
            windows.note_missed(link.sequence.missed)
            link.sequence.missed = 0
        if isinstance(sample, WaitingRss):
            taken = windows.add_rss(
                sample.time_ns, pose, sample.rss_dbm, sample.noise_dbm, sample.frequency_hz, closed
            )
        elif isinstance(sample, WaitingAoa):
            _, _, _, azimuth, elevation, azimuth_std, elevation_std, body_frame = sample
            if not body_frame:
                bearing = earth_bearing(azimuth, elevation, azimuth_std, elevation_std)
            elif pose.attitude is None:
                self._tally.add("sample_no_attitude_total", self._label)
                self.unturned += 1
                return
            else:
                bearing = body_bearing(azimuth, elevation, azimuth_std, elevation_std, pose.attitude)
            taken = windows.add_aoa(sample.time_ns, pose, bearing, closed)
        else:
            taken = windows.add_capture(pose, sample.capture, closed)
        if taken is Taken.LATE:
            self._tally.add("sample_late_total", self._label)
        elif taken is Taken.CROWDED:
            self._tally.add("cir_window_full_total", self._label)

    def _unplaced(self, outcome: PoseOutcome) -> None:
        self._tally.add("sample_no_pose_total", f"reason={outcome.value}")
        self.unplaced += 1

    def _count_given_up(self) -> None:
        for beacon_id in self._assembler.given_up:
            self._links[beacon_id].incomplete += 1
            self._links[beacon_id].active = True
        count = len(self._assembler.given_up)
        self._tally.add("cir_incomplete_total", self._label, count)
        self.cir_incomplete += count
        self._assembler.given_up.clear()

    def _activity(self, beacon_id: int, link: Link, arrival_ns: int) -> LinkActivity | None:
        link.heard_ns = arrival_ns
        reported_ns = link.reported_ns
        if reported_ns is not None and arrival_ns - reported_ns < self._interval_ns:
            link.active = True
            return None
        return self._report(beacon_id, link, arrival_ns)

    def _report(self, beacon_id: int, link: Link, now_ns: int) -> LinkActivity:
        link.active = False
        link.reported_ns = now_ns
        return LinkActivity(
            self.vehicle_id,
            beacon_id,
            link.heard_ns,
            link.rss_dbm,
            link.noise_dbm,
            link.samples,
            link.captures,
            link.incomplete,
        )

    def state(self) -> dict[str, Any]:
        """Everything but poses and clocks, as a tree for a snapshot."""
        return {
            "links": [[beacon_id, link.state()] for beacon_id, link in self._links.items()],
            "waiting": [sample_state(sample) for sample in self._waiting],
            "assembler": self._assembler.state(),
            **{name: getattr(self, name) for name in _PLAIN},
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state()`` gave."""
        self._links = {}
        for beacon_id, kept in tree["links"]:
            link = self._links[beacon_id] = Link(self._settings, self.vehicle_id, beacon_id)
            link.restore(kept)
        self._waiting = deque(sample_of(kept) for kept in tree["waiting"])
        self._assembler.restore(tree["assembler"])
        self._last_query = None
        for name in _PLAIN:
            setattr(self, name, tree[name])


_PLAIN = ("unplaced", "unturned", "cir_complete", "cir_incomplete")
