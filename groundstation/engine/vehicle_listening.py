"""What one vehicle heard, and where, in the interval that runs: its part of who listened where.

Exists apart from ``vehicle_intake`` because silence is told of vehicles, heard or not, while all
else there begins with a message. Rule: a vehicle listened if its sensor lived and its place was
known; all else is "not known", never "heard nothing".
"""

from __future__ import annotations

from collections.abc import Iterable

from groundstation.domain.geometry import Geodetic
from groundstation.domain.radio import Listener
from groundstation.mavlink import messages as m
from groundstation.measurement.pose_history import Pose, PoseHistory
from groundstation.measurement.settings import MeasurementSettings


class VehicleListening:
    """Packets of each beacon in this interval; as many beacons as a vehicle may have links."""

    def __init__(self, settings: MeasurementSettings, vehicle_id: int) -> None:
        self.vehicle_id = vehicle_id
        self._limit = settings.links_per_vehicle
        self._alive_ns = round(settings.listening_alive_s * 1e9)
        self._packets: dict[int, int] = {}

    def heard(self, beacon_id: int, message: object) -> None:
        """A sensor's message about a beacon.

        Packets count by their arrival: a second on the radio makes no difference to who heard what.
        """
        if beacon_id in self._packets or len(self._packets) < self._limit:
            # One level a packet; what else tells of it says only that it was heard.
            self._packets[beacon_id] = self._packets.get(beacon_id, 0) + isinstance(message, m.RssSample)

    def take(
        self,
        start_ns: int,
        end_ns: int,
        sensor_heard_ns: int | None,
        boot_offset_ns: int | None,
        poses: PoseHistory,
    ) -> Listener | None:
        """What was heard, and where, in an interval that ends now; None: not known to have listened.

        Station time, nanoseconds; ``boot_offset_ns`` is station time less the autopilot's, in which
        ``poses`` are. What comes after belongs to the next interval.
        """
        packets, self._packets = self._packets, {}
        if sensor_heard_ns is None or end_ns - sensor_heard_ns > self._alive_ns or boot_offset_ns is None:
            return None
        pose = poses.at((start_ns + end_ns) // 2 - boot_offset_ns, final=True)
        if not isinstance(pose, Pose):
            return None
        place = Geodetic(pose.latitude_deg, pose.longitude_deg, pose.altitude_amsl_m)
        return Listener(self.vehicle_id, place, tuple(sorted(packets.items())))

    def forget_stream(self) -> None:
        """The station was away: what was heard before belongs to no interval."""
        self._packets = {}

    def state(self) -> list[list[int]]:
        """Packets so far, as [beacon, packets]."""
        return [list(item) for item in self._packets.items()]

    def restore(self, pairs: Iterable[tuple[int, int]]) -> None:
        """Take back what ``state()`` gave."""
        self._packets = dict(pairs)
