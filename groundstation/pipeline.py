"""What happens to one record: the same steps in a live run and in a replay.

Pure composition: ingest, then the command desk; what the estimator must see comes back as
work, in order. The estimator itself runs elsewhere (another process live, inline in a
replay); nothing here waits for it. Rule kept: a record's effects depend on the records
before it and on nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

from groundstation.command.desk import CommandDesk
from groundstation.command.outputs import DeskOutput, SendFrame
from groundstation.domain.geometry import Geodetic
from groundstation.domain.inputs import DropInput, JoinInput, MissionInput, Record, SessionInput, TickInput
from groundstation.domain.mission import Area, Mission
from groundstation.domain.radio import LinkWindow, Listening
from groundstation.domain.vehicle import VehicleState
from groundstation.engine.estimator import EstimatorInput
from groundstation.engine.ingest import Ingest, IngestOutput

StateTree = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Work:
    """One input of the estimator: ``seq`` of the record that caused it, station time, item."""

    seq: int
    time_ns: int
    item: EstimatorInput


@dataclass(frozen=True, slots=True)
class Step:
    """What one record brought."""

    ingest: tuple[IngestOutput, ...]
    desk: tuple[DeskOutput, ...]
    work: tuple[Work, ...]
    frames: tuple[SendFrame, ...]
    """To be sent by a live station; a replay lets them fall."""


class Pipeline:
    """Ingest and command desk, fed one record at a time."""

    def __init__(self, ingest: Ingest, desk: CommandDesk) -> None:
        self.ingest = ingest
        self.desk = desk
        self.mission = Mission()

    def handle(self, record: Record) -> Step:
        """Take one record. Errors of bad frames are outcomes of ingest, never exceptions."""
        ingested = self.ingest.handle(record)
        desked = self.desk.handle(record, ingested)
        work: list[Work] = []
        if isinstance(record.input, MissionInput):
            self.mission = record.input.mission
        if isinstance(record.input, MissionInput | SessionInput | JoinInput):
            work.append(Work(record.seq, record.time_ns, record.input))
        work.extend(
            Work(record.seq, record.time_ns, o) for o in ingested if isinstance(o, LinkWindow | Listening)
        )
        if isinstance(record.input, TickInput):
            work.append(Work(record.seq, record.time_ns, record.input))
        return Step(
            ingest=tuple(ingested),
            desk=tuple(o for o in desked if not isinstance(o, SendFrame)),
            work=tuple(work),
            frames=tuple(o for o in desked if isinstance(o, SendFrame)),
        )

    def state(self) -> StateTree:
        """Complete state, for a snapshot."""
        return {"ingest": self.ingest.state(), "desk": self.desk.state()}

    def restore(self, tree: StateTree, mission: Mission) -> None:
        """The state that ``state`` gave; the mission comes from the journal."""
        self.ingest.restore(tree["ingest"])
        self.desk.restore(tree["desk"])
        self.mission = mission


def without_dropped(work: Iterable[Work], dropped: frozenset[tuple[int, int, int]]) -> list[Work]:
    """Work less the windows that a full queue kept from the live estimator."""
    return [w for w in work if not (isinstance(w.item, LinkWindow) and w.item.key in dropped)]


def dropped_windows(records: Iterable[Record]) -> frozenset[tuple[int, int, int]]:
    """Keys of all windows that never reached the estimator in a journalled run."""
    return frozenset(key for r in records if isinstance(r.input, DropInput) for key in r.input.window_keys)


def mission_with_origin(
    mission: Mission, vehicle: VehicleState, default_area: Callable[[Geodetic], Area] | None = None
) -> Mission | None:
    """The mission's next revision once a vehicle tells a place to start from, else None.

    The origin is the first valid home position; without one the first valid position of a
    vehicle, at its altitude less its height above home. The ground is taken at home's
    altitude and marked so. ``default_area`` makes a search area round that place when the
    mission has none.
    """
    needs_area = mission.search_area is None and default_area is not None
    if mission.origin is not None and not needs_area:
        return None
    if vehicle.home is not None and vehicle.home.is_valid():
        place = vehicle.home
    elif (
        vehicle.position is not None
        and vehicle.position.is_valid()
        and vehicle.height_above_home_m is not None
    ):
        place = replace(
            vehicle.position,
            altitude_amsl_m=vehicle.position.altitude_amsl_m - vehicle.height_above_home_m,
        )
    else:
        return None
    ground_known = mission.ground_amsl_m is not None
    return replace(
        mission,
        revision=mission.revision + 1,
        origin=mission.origin or place,
        search_area=default_area(place) if needs_area and default_area is not None else mission.search_area,
        ground_amsl_m=mission.ground_amsl_m if ground_known else place.altitude_amsl_m,
        height_reference=mission.height_reference if ground_known else "home",
    )


def mission_with_settings(known: Mission, given: Mission) -> Mission | None:
    """The session's mission with what a run was given; None when that changes nothing.

    Limits and target heights are the run's; areas, places and terrain that it was not given are kept.
    """
    merged = replace(
        known,
        search_area=given.search_area or known.search_area,
        fence=given.fence or known.fence,
        last_known=given.last_known or known.last_known,
        terrain=given.terrain or known.terrain,
        target_height_min_m=given.target_height_min_m,
        target_height_max_m=given.target_height_max_m,
        limits=given.limits,
    )
    if given.ground_amsl_m is not None:
        merged = replace(merged, ground_amsl_m=given.ground_amsl_m, height_reference=given.height_reference)
    if merged == known and known.revision != 0:
        return None
    return replace(merged, revision=known.revision + 1)
