"""When a belief is explained, and its wording in plain values.

Exists because an explanation costs as much as several updates: it has an interval of its own,
and one for all beacons together, so that fifty of them cost no more than ten. Rule: who has
waited longest is next; whatever leaves is rounded.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from groundstation.domain.target import Contribution, TargetExplanation
from groundstation.engine.estimator_beacon import Beacon
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.tracking import Tracker
from groundstation.tracking.explanation import LinkExplanation, explain


def due_explanation(
    beacons: Iterable[Beacon], time_ns: int, last_ns: int | None, settings: EstimatorSettings
) -> Beacon | None:
    """The beacon whose belief changed since it was explained and that waited longest; None: none is due."""
    if last_ns is not None and time_ns - last_ns < int(settings.explanations_interval_s * 1e9):
        return None
    latest_ns = time_ns - int(settings.explanation_interval_s * 1e9)
    due = [
        beacon
        for beacon in beacons
        if beacon.belief is not None
        and beacon.sequence > beacon.explained_sequence
        and (beacon.explained_ns is None or beacon.explained_ns <= latest_ns)
    ]
    return min(due, key=lambda b: -1 if b.explained_ns is None else b.explained_ns, default=None)


def explanation(time_ns: int, beacon: Beacon, belief: Tracker) -> TargetExplanation:
    """Why the belief of a beacon is what it is."""
    beacon.explained_ns, beacon.explained_sequence = time_ns, beacon.sequence
    counts = belief.still.counts()
    return TargetExplanation(
        beacon_id=beacon.beacon_id,
        time_ns=time_ns,
        sequence=beacon.sequence,
        contributions=tuple(
            _contribution(link, counts.get(link.vehicle_id, (link.windows, 0, 0)))
            for link in explain(belief.still)
        ),
    )


def _contribution(link: LinkExplanation, counts: tuple[int, int, int]) -> Contribution:
    taken, redundant, outliers = counts
    azimuth = link.azimuth_residual_rad
    elevation = link.elevation_residual_rad
    return Contribution(
        vehicle_id=link.vehicle_id,
        weight=round(link.weight, 4),
        area_factor=round(min(link.area_factor, 1e6), 3),
        windows=taken,
        redundant=redundant,
        outliers=outliers,
        power_residual_db=_rounded(link.power_residual_db, 2),
        power_score=_rounded(link.power_score, 2),
        # Mathematics turns counter-clockwise, people say "to the right".
        azimuth_residual_deg=None if azimuth is None else _rounded(-math.degrees(azimuth), 2),
        azimuth_score=None if link.azimuth_score is None else _rounded(-link.azimuth_score, 2),
        elevation_residual_deg=None if elevation is None else _rounded(math.degrees(elevation), 2),
        elevation_score=_rounded(link.elevation_score, 2),
        los_probability=_rounded(link.los_probability, 3),
    )


def _rounded(value: float | None, decimals: int) -> float | None:
    return None if value is None else round(value, decimals) + 0.0
