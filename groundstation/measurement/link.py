"""What is kept of one link beside its window: counters, recent packets, what the page shows."""

from __future__ import annotations

from typing import Any

from groundstation.measurement.link_window import LinkWindows
from groundstation.measurement.sequence import BeaconSequence
from groundstation.measurement.settings import MeasurementSettings


class Link:
    """What is kept of one link beside its window."""

    __slots__ = (
        "active",
        "aoa_recent",
        "captures",
        "heard_ns",
        "incomplete",
        "noise_dbm",
        "reported_ns",
        "rss_dbm",
        "rss_recent",
        "samples",
        "sequence",
        "windows",
    )

    def __init__(self, settings: MeasurementSettings, vehicle_id: int, beacon_id: int) -> None:
        self.windows = LinkWindows(settings, vehicle_id, beacon_id)
        self.sequence = BeaconSequence(settings.beacon_rate_max_hz)
        self.rss_recent: dict[tuple[int, int], None] = {}
        self.aoa_recent: dict[tuple[int, float, float], None] = {}
        self.rss_dbm: float | None = None
        self.noise_dbm: float | None = None
        self.heard_ns = 0
        self.samples = 0
        self.captures = 0
        self.incomplete = 0
        self.active = False
        self.reported_ns: int | None = None

    def state(self) -> dict[str, Any]:
        return {
            "windows": self.windows.state(),
            "sequence": self.sequence.state(),
            "rss_recent": [list(key) for key in self.rss_recent],
            "aoa_recent": [list(key) for key in self.aoa_recent],
            **{name: getattr(self, name) for name in _PLAIN},
        }

    def restore(self, tree: dict[str, Any]) -> None:
        self.windows.restore(tree["windows"])
        self.sequence.restore(tree["sequence"])
        self.rss_recent = {(key[0], key[1]): None for key in tree["rss_recent"]}
        self.aoa_recent = {(key[0], key[1], key[2]): None for key in tree["aoa_recent"]}
        for name in _PLAIN:
            setattr(self, name, tree[name])


_PLAIN = (
    "rss_dbm",
    "noise_dbm",
    "heard_ns",
    "samples",
    "captures",
    "incomplete",
    "active",
    "reported_ns",
)
