"""Where each beacon could be, given every window heard so far."""

from groundstation.localization.containment import Containment, containment, region_rings
from groundstation.tracking.belief import Belief, TrackObservation, Update
from groundstation.tracking.settings import TrackingSettings

__all__ = [
    "Belief",
    "Containment",
    "TrackObservation",
    "TrackingSettings",
    "Update",
    "containment",
    "region_rings",
]
