"""Where a beacon is, from one snapshot of radio links: Algorithm 1 and its solvers."""

from groundstation.localization.bounds import crlb, fisher_information
from groundstation.localization.environment import SOUND_CHOICE, Choice, environment_of
from groundstation.localization.locate import METHODS, locate, locate_batch
from groundstation.localization.problem import Estimate, Links, SearchArea, SignalModel
from groundstation.localization.settings import SERVICE_MODEL, LocalizationSettings

__all__ = [
    "METHODS",
    "SERVICE_MODEL",
    "SOUND_CHOICE",
    "Choice",
    "Estimate",
    "Links",
    "LocalizationSettings",
    "SearchArea",
    "SignalModel",
    "crlb",
    "environment_of",
    "fisher_information",
    "locate",
    "locate_batch",
]
