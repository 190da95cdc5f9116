"""What all encoders share: rounding, times, order.

Rule: decimals say what a number is worth: 7 of a degree are a centimetre, 2 of a metre too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from datetime import UTC, datetime

from groundstation.domain.target import TargetState

DEGREE_DECIMALS = 7
METRE_DECIMALS = 2
PROBABILITY_DECIMALS = 3
MAY_WALK = 0.2
"""From this P(walking) on people are told, here as on the page."""


def degrees(value_deg: float) -> float:
    """Rounded to a centimetre on the ground; never a negative zero."""
    return round(value_deg, DEGREE_DECIMALS) + 0.0


def number(value: float | None, decimals: int = METRE_DECIMALS) -> float | None:
    """Rounded; None for what is not finite."""
    if value is None or not math.isfinite(value):
        return None
    return round(float(value), decimals) + 0.0


def iso_time(time_ns: int) -> str:
    """UTC with milliseconds: ``2026-11-22T01:45:00.250Z``; empty when no calendar has it."""
    seconds, rest_ns = divmod(time_ns, 1_000_000_000)
    try:
        moment = datetime.fromtimestamp(seconds, UTC)
    except (OverflowError, ValueError, OSError):
        return ""
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{rest_ns // 1_000_000:03d}Z"


def newest(targets: Iterable[TargetState]) -> list[TargetState]:
    """The newest belief of each beacon, by beacon id. Those without a place on WGS84 are left out."""
    found: dict[int, TargetState] = {}
    for target in targets:
        known = found.get(target.beacon_id)
        if known is None or (target.time_ns, target.sequence) >= (known.time_ns, known.sequence):
            found[target.beacon_id] = target
    return [found[beacon_id] for beacon_id in sorted(found) if found[beacon_id].position.is_valid()]


def joined_ids(target: TargetState) -> list[str]:
    """Other ids of the same transmitter, as the operator said: decimal text, by number."""
    return [str(beacon_id) for beacon_id in sorted(target.joined_beacon_ids)]


def describe(target: TargetState) -> str:
    """One line for people."""
    radius = number(target.radius_90_m, 1)
    within = "uncertain" if radius is None else f"within {radius:g} m (90 %)"
    ground = "" if target.height_reference == "terrain" else f", height from {target.height_reference}"
    walks = target.walking_probability
    walking = f", may be walking ({100.0 * walks:.0f} %)" if walks is not None and walks >= MAY_WALK else ""
    joined = f" with {', '.join(joined_ids(target))}" if target.joined_beacon_ids else ""
    return (
        f"Beacon {target.beacon_id}{joined}: {within}{walking}, {target.environment.name}, "
        f"{target.los_links} of {target.links} links in line of sight{ground}"
    )
