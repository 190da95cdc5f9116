"""What a planner is given, in one frozen value: the seam for other ways of choosing places.

A planner is a pure function of one frozen request. Its answer goes back to the command desk
as an input, tagged with the mission revision it was based on, so a replay needs no planner.
``spread.propose`` is the first planner; one that maximises expected information takes its
place without any change elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

from groundstation.domain.command import Proposal
from groundstation.domain.geometry import Geodetic
from groundstation.domain.mission import Mission
from groundstation.domain.target import TargetState
from groundstation.domain.vehicle import VehicleState


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """Everything a planner may look at. Picklable: planning runs in its own lane."""

    time_ns: int
    """Station time of the poses and beliefs."""
    mission: Mission
    vehicles: tuple[VehicleState, ...]
    targets: tuple[TargetState, ...]
    going_to: tuple[tuple[int, Geodetic], ...] = ()
    """(vehicle, place) of commands that vehicles may still be flying."""
    outstanding: tuple[Proposal, ...] = ()
    """Proposals that can still be confirmed."""
