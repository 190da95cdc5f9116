"""What the estimator keeps of one beacon.

Exists so that nothing is shared between beacons by accident: all that an update of one
touches is one value.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from groundstation.domain.target import SnapshotEstimate
from groundstation.engine.estimator_output import Heard
from groundstation.localization import LocalizationSettings
from groundstation.tracking import Belief


@dataclass(slots=True, eq=False)
class Beacon:
    """One beacon heard. Times are station time, nanoseconds."""

    beacon_id: int
    first_heard_ns: int
    last_heard_ns: int
    pending: list[Heard] = field(default_factory=list)
    """Windows that the next update fuses."""
    newest: dict[int, Heard] = field(default_factory=dict)
    """Of each vehicle, for the snapshot."""
    belief: Belief | None = None
    sequence: int = 0
    windows: int = 0
    updated_ns: int | None = None
    snapshot_ns: int | None = None
    regions_ns: int | None = None
    snapshot: SnapshotEstimate | None = None
    failed: bool = False
    """The last update failed: the next failure is no news."""

    def fresh(self, time_ns: int, limits: LocalizationSettings) -> list[Heard]:
        """The newest window of each vehicle, by vehicle, within age and distance limits."""
        oldest = time_ns - int(limits.window_age_s * 1e9)
        chosen = []
        for vehicle in sorted(self.newest):
            heard = self.newest[vehicle]
            if heard.end_ns < oldest:
                continue
            if heard.path_length_m > limits.window_path_m or heard.rss_dbm is None:
                continue
            chosen.append(heard)
        return chosen
