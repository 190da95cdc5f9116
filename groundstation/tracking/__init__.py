"""Where each beacon could be, given every window heard so far."""

from groundstation.localization.containment import Containment, containment, region_rings
from groundstation.tracking.belief import Belief, Field, TrackObservation, Update
from groundstation.tracking.settings import TrackingSettings
from groundstation.tracking.tracker import Tracker

__all__ = [
    "Belief",
    "Containment",
    "Field",
    "TrackObservation",
    "Tracker",
    "TrackingSettings",
    "Update",
    "containment",
    "region_rings",
]
