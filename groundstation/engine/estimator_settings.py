"""Settings of the estimator engine: localisation, tracking, and how often it speaks."""

from __future__ import annotations

from dataclasses import dataclass, field

from groundstation.localization import LocalizationSettings
from groundstation.tracking import TrackingSettings


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """What the estimator is run with."""

    localization: LocalizationSettings = field(default_factory=LocalizationSettings)
    """The snapshot and what is assumed of the radio; the tracker assumes the same."""
    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    """The belief."""
    prior_los_probability: float = 0.3
    """P(line of sight) that is told of a link that nobody could judge; given to the classifier,
    so that there is one prior. The belief learns the share of such links from their bearings."""
    update_interval_s: float = 0.5
    """A beacon's belief is updated at most this often, with all windows since, seconds."""
    updates_per_tick: int = 5
    """Beacons updated on one tick, those that waited longest first: bounds the load of many beacons."""
    snapshot_interval_s: float = 2.0
    """Algorithm 1 runs at most this often a beacon, seconds."""
    snapshots_interval_s: float = 0.25
    """Of many beacons each has its turn for one, so far apart in all: bounds their load, seconds."""
    regions_interval_s: float = 2.0
    """Containment regions and search map are drawn at most this often a beacon, seconds."""
    all_regions_interval_s: float = 0.1
    """Of many beacons each is drawn in its turn, so far apart in all, seconds: of 50 each every five."""
    explanation_interval_s: float = 5.0
    """What each vehicle contributed is worked out at most this often a beacon, seconds."""
    explanations_interval_s: float = 0.5
    """Shortest time between two explanations, of whichever beacons: bounds the load of many, seconds."""
    default_radius_m: float = 500.0
    """Without a search area: a disc of this radius round the first valid vehicle position, metres."""
    maximum_pending: int = 512
    """Windows of a beacon that may wait for an update; the oldest go first."""
    maximum_beacons: int = 512
    """Beacons kept; more are refused and counted."""
    silence_interval_s: float = 10.0
    """What nobody heard is weighed anew at most this often a beacon, seconds."""
