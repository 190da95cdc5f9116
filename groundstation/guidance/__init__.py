"""Where to fly next, and why. Pure functions; runs in the planning lane."""

from groundstation.guidance.plan import PlanRequest
from groundstation.guidance.settings import GuidanceSettings
from groundstation.guidance.spread import propose

__all__ = ["GuidanceSettings", "PlanRequest", "propose"]
