"""Averages the samples of one link into windows: one vehicle, one beacon, one place.

Why: a single RSS sample fades by many decibels; the estimator wants M of them averaged where
the vehicle has hardly moved. A window closes when it has M samples of each kind it heard, when
the next sample would make it too old or too long, or on a tick once its time is over. Frames
and ticks alone decide, so a replay closes the same windows.
How the samples are averaged is averages.py's business.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import Any

from groundstation.domain.geometry import Quaternion
from groundstation.domain.radio import CirCapture, CloseReason, LinkWindow
from groundstation.measurement.angles import Bearing
from groundstation.measurement.averages import mean_bearing, mean_position, mean_power, middle_attitude
from groundstation.measurement.pose_history import Pose, flown_m
from groundstation.measurement.settings import MeasurementSettings


class Taken(Enum):
    """What became of a sample given to a window."""

    KEPT = auto()
    LATE = auto()
    """Older than the open window (or the last closed one) by more than the tolerance."""
    CROWDED = auto()
    """Kept, but the window was full of captures and its oldest made room."""


class LinkWindows:
    """The windows of one link, one open at a time. Times are station time, nanoseconds."""

    __slots__ = (
        "_age_ns",
        "_angles",
        "_captures",
        "_close_before_ns",
        "_end_ns",
        "_frequency_hz",
        "_last_pose",
        "_link_state",
        "_link_state_age_ns",
        "_link_state_ns",
        "_missed",
        "_noise_dbm",
        "_path_m",
        "_placed",
        "_rss_dbm",
        "_settings",
        "_settle_ns",
        "_start_ns",
        "_tolerance_ns",
        "beacon_id",
        "vehicle_id",
    )

    def __init__(self, settings: MeasurementSettings, vehicle_id: int, beacon_id: int) -> None:
        self.vehicle_id = vehicle_id
        self.beacon_id = beacon_id
        self._settings = settings
        self._age_ns = round(settings.window_age_s * 1e9)
        self._settle_ns = round(settings.window_settle_s * 1e9)
        self._tolerance_ns = round(settings.late_tolerance_s * 1e9)
        self._link_state_age_ns = round(settings.link_state_max_age_s * 1e9)
        self._link_state: float | None = None
        self._link_state_ns = 0
        self._close_before_ns: int | None = None
        self._missed = 0
        self._reset()

    def _reset(self) -> None:
        self._start_ns: int | None = None
        self._end_ns = 0
        self._rss_dbm: list[float] = []
        self._noise_dbm: list[float] = []
        self._frequency_hz: int | None = None
        self._angles: list[tuple[float, float, float | None, float | None]] = []
        self._captures: list[CirCapture] = []
        self._placed: list[tuple[int, Pose]] = []
        self._last_pose: Pose | None = None
        self._path_m = 0.0

    @property
    def is_open(self) -> bool:
        """Whether a window is under way."""
        return self._start_ns is not None

    def add_rss(
        self,
        time_ns: int,
        pose: Pose,
        rss_dbm: float,
        noise_dbm: float | None,
        frequency_hz: int,
        closed: list[LinkWindow],
    ) -> Taken:
        """Take a power sample; windows that it closes are appended to ``closed``."""
        taken = self._place(time_ns, pose, len(self._rss_dbm) >= self._settings.window_samples, closed)
        if taken is Taken.LATE:
            return taken
        self._rss_dbm.append(rss_dbm)
        if noise_dbm is not None:
            self._noise_dbm.append(noise_dbm)
        self._frequency_hz = frequency_hz
        self._close_if_full(closed)
        return taken

    def add_aoa(self, time_ns: int, pose: Pose, bearing: Bearing, closed: list[LinkWindow]) -> Taken:
        """Take a bearing; windows that it closes are appended to ``closed``."""
        taken = self._place(time_ns, pose, len(self._angles) >= self._settings.window_samples, closed)
        if taken is Taken.LATE:
            return taken
        self._angles.append(
            (bearing.azimuth_rad, bearing.elevation_rad, bearing.azimuth_std_rad, bearing.elevation_std_rad)
        )
        self._close_if_full(closed)
        return taken

    def add_capture(self, pose: Pose, capture: CirCapture, closed: list[LinkWindow]) -> Taken:
        """Take an impulse response; windows that it closes are appended to ``closed``."""
        taken = self._place(capture.time_ns, pose, False, closed)
        if taken is Taken.LATE:
            return taken
        self._captures.append(capture)
        self._captures.sort(key=lambda kept: kept.time_ns)
        if len(self._captures) > self._settings.window_captures:
            del self._captures[0]
            return Taken.CROWDED
        return taken

    def note_link_state(self, time_ns: int, los_probability: float) -> bool:
        """Keep the sensor's own answer if it is the newest; False if it is not."""
        if self._link_state is not None and time_ns < self._link_state_ns:
            return False
        self._link_state = los_probability
        self._link_state_ns = time_ns
        return True

    def note_missed(self, count: int) -> None:
        """Packets lost (or, negative, found again) since the last call."""
        self._missed += count

    def tick(self, now_ns: int, closed: list[LinkWindow]) -> None:
        """Close the window whose time is over."""
        if self._start_ns is not None and now_ns - self._start_ns >= self._age_ns + self._settle_ns:
            closed.append(self._close(CloseReason.AGE))

    def end(self, closed: list[LinkWindow]) -> None:
        """Close the open window: nothing more will come."""
        if self._start_ns is not None:
            closed.append(self._close(CloseReason.END))

    def forget(self) -> None:
        """Drop the open window and all that lives by the stream."""
        self._reset()
        self._link_state = None
        self._close_before_ns = None
        self._missed = 0

    def _place(self, time_ns: int, pose: Pose, kind_full: bool, closed: list[LinkWindow]) -> Taken:
        """Make room for a sample: close what it must not join, or find it late."""
        start_ns = self._start_ns
        last_pose = self._last_pose
        if start_ns is not None and last_pose is not None:
            if time_ns < start_ns - self._tolerance_ns:
                return Taken.LATE
            leg_m = flown_m(last_pose, pose) if time_ns > self._end_ns else 0.0
            reason = None
            if kind_full:
                reason = CloseReason.FULL
            elif time_ns - start_ns >= self._age_ns:
                reason = CloseReason.AGE
            elif self._path_m + leg_m > self._settings.window_distance_m:
                reason = CloseReason.DISTANCE
            if reason is None:
                self._path_m += leg_m
                if time_ns < start_ns:
                    self._start_ns = time_ns
                if time_ns > self._end_ns:
                    self._end_ns = time_ns
                    self._last_pose = pose
                self._placed.append((time_ns, pose))
                return Taken.KEPT
            closed.append(self._close(reason))
        elif self._close_before_ns is not None and time_ns < self._close_before_ns - self._tolerance_ns:
            return Taken.LATE
        self._start_ns = self._end_ns = time_ns
        self._last_pose = pose
        self._placed.append((time_ns, pose))
        return Taken.KEPT

    def _close_if_full(self, closed: list[LinkWindow]) -> None:
        """At once where both kinds are full. One kind alone waits: its twin may be on its way."""
        m = self._settings.window_samples
        if len(self._rss_dbm) == m and len(self._angles) == m:
            closed.append(self._close(CloseReason.FULL))

    def _close(self, reason: CloseReason) -> LinkWindow:
        assert self._start_ns is not None
        rss_dbm, rss_error_db = mean_power(self._rss_dbm)
        azimuth, azimuth_error, elevation, elevation_error = mean_bearing(
            self._angles, self._settings.angle_std_default_rad
        )
        noise_dbm, _ = mean_power(self._noise_dbm)
        link_state = self._link_state
        if link_state is not None and self._end_ns - self._link_state_ns > self._link_state_age_ns:
            link_state = None
        window = LinkWindow(
            vehicle_id=self.vehicle_id,
            beacon_id=self.beacon_id,
            start_ns=self._start_ns,
            end_ns=self._end_ns,
            position=mean_position([pose for _, pose in self._placed]),
            attitude=middle_attitude(self._placed, (self._start_ns + self._end_ns) // 2),
            path_length_m=self._path_m,
            rss_dbm=rss_dbm,
            rss_std_error_db=rss_error_db,
            rss_count=len(self._rss_dbm),
            noise_dbm=noise_dbm,
            frequency_hz=self._frequency_hz,
            missed_count=max(0, self._missed),
            azimuth_rad=azimuth,
            azimuth_std_error_rad=azimuth_error,
            elevation_rad=elevation,
            elevation_std_error_rad=elevation_error,
            aoa_count=len(self._angles),
            captures=tuple(self._captures),
            sensor_los_probability=link_state,
            close_reason=reason,
        )
        self._close_before_ns = self._end_ns
        self._missed = 0
        self._reset()
        return window

    def state(self) -> dict[str, Any]:
        """Everything, as a tree for a snapshot."""
        return {
            "start_ns": self._start_ns,
            "end_ns": self._end_ns,
            "rss_dbm": list(self._rss_dbm),
            "noise_dbm": list(self._noise_dbm),
            "frequency_hz": self._frequency_hz,
            "angles": [list(row) for row in self._angles],
            "captures": [capture_state(capture) for capture in self._captures],
            "placed": [[time_ns, pose_state(pose)] for time_ns, pose in self._placed],
            "last_pose": None if self._last_pose is None else pose_state(self._last_pose),
            "path_m": self._path_m,
            "link_state": self._link_state,
            "link_state_ns": self._link_state_ns,
            "close_before_ns": self._close_before_ns,
            "missed": self._missed,
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state()`` gave."""
        self._start_ns = tree["start_ns"]
        self._end_ns = tree["end_ns"]
        self._rss_dbm = list(tree["rss_dbm"])
        self._noise_dbm = list(tree["noise_dbm"])
        self._frequency_hz = tree["frequency_hz"]
        self._angles = [(row[0], row[1], row[2], row[3]) for row in tree["angles"]]
        self._captures = [capture_of(kept) for kept in tree["captures"]]
        self._placed = [(time_ns, pose_of(kept)) for time_ns, kept in tree["placed"]]
        self._last_pose = None if tree["last_pose"] is None else pose_of(tree["last_pose"])
        self._path_m = tree["path_m"]
        self._link_state = tree["link_state"]
        self._link_state_ns = tree["link_state_ns"]
        self._close_before_ns = tree["close_before_ns"]
        self._missed = tree["missed"]


def capture_state(capture: CirCapture) -> dict[str, Any]:
    """A capture as a tree for a snapshot."""
    return {name: getattr(capture, name) for name in CirCapture.__slots__}


def capture_of(tree: dict[str, Any]) -> CirCapture:
    """The capture of a snapshot's tree."""
    return CirCapture(**tree)


def pose_state(pose: Pose) -> list[Any]:
    """A pose as a list for a snapshot."""
    return [*pose[:3], None if pose.attitude is None else list(pose.attitude)]


def pose_of(kept: list[Any]) -> Pose:
    """The pose of a snapshot's list."""
    return Pose(kept[0], kept[1], kept[2], quaternion_of(kept[3]))


def quaternion_of(kept: list[float] | None) -> Quaternion | None:
    """The attitude of a snapshot's list."""
    return None if kept is None else (kept[0], kept[1], kept[2], kept[3])
