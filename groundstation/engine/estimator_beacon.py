"""What the estimator keeps of one beacon.

Exists so that nothing is shared between beacons by accident: all that an update of one
touches is one value.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from groundstation.domain.target import SnapshotEstimate
from groundstation.engine.estimator_output import Heard
from groundstation.localization import LocalizationSettings
from groundstation.tracking import Tracker
from groundstation.tracking.detection import SilenceField
from groundstation.tracking.silence import Silence


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
    belief: Tracker | None = None
    sequence: int = 0
    windows: int = 0
    updated_ns: int | None = None
    snapshot_ns: int | None = None
    regions_ns: int | None = None
    snapshot: SnapshotEstimate | None = None
    failed: bool = False
    """The last update failed: the next failure is no news."""
    explained_ns: int | None = None
    explained_sequence: int = 0
    """Update that was explained last."""
    silence: Silence | None = None
    """Where it was listened for, and not heard."""
    silence_field: SilenceField | None = None
    """What of that the belief was told last."""
    silence_ns: int | None = None

    def take(self, heard: Heard, start_ns: int, maximum_pending: int) -> bool:
        """A window that began at ``start_ns``; False when the oldest that waits had to make room."""
        self.first_heard_ns = min(self.first_heard_ns, start_ns)
        self.last_heard_ns = max(self.last_heard_ns, heard.end_ns)
        self.windows += 1
        held = self.newest.get(heard.vehicle_id)
        if held is None or held.end_ns <= heard.end_ns:
            self.newest[heard.vehicle_id] = heard
        self.pending.append(heard)
        if len(self.pending) <= maximum_pending:
            return True
        del self.pending[0]
        return False

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
