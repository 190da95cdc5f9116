"""From which level on each vehicle's receiver hears, learned from what it reports.

Exists because nobody tells the station a sensitivity. Rule: it is taken for no better than
proven: by the weakest levels that came from it (of any beacon), or by its noise.
"""

from __future__ import annotations

import math
from typing import Any

from groundstation.tracking.settings import TrackingSettings

_WEAKEST_KEPT = 3


class Receivers:
    """What is known of each vehicle's receiver, from every beacon's windows."""

    def __init__(self, settings: TrackingSettings) -> None:
        self._settings = settings
        self._weakest: dict[int, list[float]] = {}
        self._noise: dict[int, float] = {}

    def heard(self, vehicle_id: int, rss_dbm: float | None, noise_dbm: float | None) -> None:
        """A window of whatever beacon."""
        weakest = self._weakest.setdefault(vehicle_id, [])
        if rss_dbm is not None and math.isfinite(rss_dbm):
            weakest.append(rss_dbm)
            weakest.sort()
            # One reading that is too low must not make the receiver look better than it is.
            del weakest[_WEAKEST_KEPT:]
        if noise_dbm is not None and math.isfinite(noise_dbm):
            self._noise[vehicle_id] = noise_dbm

    def proven(self, vehicle_id: int) -> bool:
        """Whether it ever reported a beacon."""
        return vehicle_id in self._weakest

    def sensitivity_dbm(self, vehicle_id: int) -> float | None:
        """Level from which on it hears; of the worst other one where it never heard; None: nobody did."""
        if self._settings.sensitivity_dbm is not None:
            return self._settings.sensitivity_dbm
        own = self._own_dbm(vehicle_id)
        if own is not None:
            return own
        others = [level for level in map(self._own_dbm, self._weakest) if level is not None]
        return max(others) if others else None

    def _own_dbm(self, vehicle_id: int) -> float | None:
        weakest = self._weakest.get(vehicle_id)
        levels = [weakest[-1]] if weakest else []
        if vehicle_id in self._noise:
            levels.append(self._noise[vehicle_id] + self._settings.detection_snr_db)
        return min(levels) if levels else None

    def state(self) -> dict[str, Any]:
        """Everything, as plain values."""
        return {
            "weakest": [[vehicle, list(levels)] for vehicle, levels in self._weakest.items()],
            "noise": [[vehicle, level] for vehicle, level in self._noise.items()],
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state`` gave."""
        self._weakest = {int(v): [float(level) for level in levels] for v, levels in tree["weakest"]}
        self._noise = {int(vehicle): float(level) for vehicle, level in tree["noise"]}
