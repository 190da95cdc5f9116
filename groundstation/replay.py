"""Two replays, both promised: a recording (``.tlog``) and a whole session from its journal.

The same engines as live, run inline, in the order of the records, as fast as they go. A
replay sends nothing, ever: its guard refuses every frame, and there is no radio to send by.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from groundstation import __version__
from groundstation.channel import load_classifier
from groundstation.command.desk import CommandDesk
from groundstation.config import Config
from groundstation.domain.errors import InputError
from groundstation.domain.events import Counter, Event
from groundstation.domain.geometry import Geodetic
from groundstation.domain.inputs import (
    AnyInput,
    Direction,
    FrameInput,
    MissionInput,
    Record,
    SessionInput,
    TickInput,
)
from groundstation.domain.mission import Area, Mission
from groundstation.domain.target import (
    LinkVerdict,
    SearchMap,
    TargetExplanation,
    TargetJoined,
    TargetState,
    TargetWaiting,
)
from groundstation.domain.vehicle import VehicleState
from groundstation.engine.estimator import Estimator, EstimatorOutput
from groundstation.engine.ingest import Ingest
from groundstation.mavlink.framing import Framer
from groundstation.mavlink.tlog import TlogReader
from groundstation.mission_files import disc_area
from groundstation.pipeline import Pipeline, Step, dropped_windows, mission_with_origin, without_dropped
from groundstation.session_settings import read_settings
from groundstation.store.session import open_to_read

TICK_NS = 100_000_000
DEFAULT_AREA_RADIUS_M = 500.0
CONNECTION = "recording"

Show = Callable[[Record, Step, list[EstimatorOutput]], None]
"""Told after each record; for the page and for progress."""


@dataclass(slots=True)
class ReplayResult:
    """What a recording gave."""

    targets: dict[int, TargetState] = field(default_factory=dict)
    waiting: dict[int, TargetWaiting] = field(default_factory=dict)
    joined: dict[int, TargetJoined] = field(default_factory=dict)
    search_maps: dict[int, SearchMap] = field(default_factory=dict)
    explanations: dict[int, TargetExplanation] = field(default_factory=dict)
    verdicts: dict[tuple[int, int], LinkVerdict] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    counters: list[Counter] = field(default_factory=list)
    vehicles: dict[int, VehicleState] = field(default_factory=dict)
    records: int = 0
    first_ns: int = 0
    last_ns: int = 0
    notes: list[str] = field(default_factory=list)
    """What the user should know of the file: a truncated end, bytes passed over."""

    def sorted_targets(self) -> list[TargetState]:
        """By beacon id."""
        return [self.targets[beacon_id] for beacon_id in sorted(self.targets)]


class Replayer:
    """The engines, inline, over records that come from a file."""

    def __init__(self, settings: Config, show: Show | None = None) -> None:
        self.settings = settings
        self.pipeline = Pipeline(
            Ingest(settings.measurement),
            CommandDesk(settings.command.command, settings.safety, replay=True),
        )
        self.estimator = Estimator(settings.estimator, load_classifier())
        self.result = ReplayResult()
        self._show = show

    def handle(self, record: Record, dropped: frozenset[tuple[int, int, int]] = frozenset()) -> Step:
        """One record through both engines."""
        step = self.pipeline.handle(record)
        outputs: list[EstimatorOutput] = []
        for work in without_dropped(step.work, dropped):
            outputs.extend(self.estimator.handle(work.time_ns, work.item))
        self._keep(record, step, outputs)
        if self._show is not None:
            self._show(record, step, outputs)
        return step

    def finish(self) -> ReplayResult:
        """The result, with the counters of all rooms."""
        self.result.counters = [
            *self.pipeline.ingest.counters(),
            *self.pipeline.desk.counters(),
            *self.estimator.counters(),
        ]
        return self.result

    def _keep(self, record: Record, step: Step, outputs: Iterable[EstimatorOutput]) -> None:
        result = self.result
        result.records += 1
        result.first_ns = result.first_ns or record.time_ns
        result.last_ns = record.time_ns
        for output in (*step.ingest, *step.desk, *outputs):
            match output:
                case TargetState():
                    result.targets[output.beacon_id] = output
                    result.waiting.pop(output.beacon_id, None)
                    result.joined.pop(output.beacon_id, None)
                case TargetWaiting():
                    _forget(result, output.beacon_id)
                    result.waiting[output.beacon_id] = output
                case TargetJoined():
                    _forget(result, output.beacon_id)
                    result.joined[output.beacon_id] = output
                case SearchMap():
                    result.search_maps[output.beacon_id] = output
                case TargetExplanation():
                    result.explanations[output.beacon_id] = output
                case LinkVerdict():
                    result.verdicts[output.vehicle_id, output.beacon_id] = output
                case VehicleState():
                    result.vehicles[output.vehicle_id] = output
                case Event():
                    result.events.append(output)


def _forget(result: ReplayResult, beacon_id: int) -> None:
    """A beacon without an estimate (any more)."""
    for table in (
        result.targets, result.waiting, result.joined, result.search_maps, result.explanations
    ):  # fmt: skip
        table.pop(beacon_id, None)


def tlog_inputs(
    path: Path, notes: list[str], on_bytes: Callable[[int], None] | None = None
) -> Iterator[tuple[int, int, AnyInput]]:
    """(station time ns, wall µs, input) of a recording: its frames with ticks between them.

    Station time is the recording's own, made monotonic. Frames are verified again: a
    recording may hold what a radio garbled. Ticks stand at whole tenths of a second.
    """
    framer = Framer()
    reader = TlogReader(path)
    time_ns = 0
    next_tick_ns = 0
    done = 0
    for unix_us, raw in reader:
        at_ns = max(unix_us * 1000, time_ns)
        if next_tick_ns == 0:
            next_tick_ns = at_ns + TICK_NS
        while next_tick_ns <= at_ns:
            yield next_tick_ns, next_tick_ns // 1000, TickInput()
            next_tick_ns += TICK_NS
        time_ns = at_ns
        for frame in framer.feed(raw):
            yield at_ns, unix_us, FrameInput(CONNECTION, Direction.IN, frame.raw)
        done += len(raw) + 8
        if on_bytes is not None:
            on_bytes(done)
    yield time_ns, time_ns // 1000, TickInput()
    if reader.truncated_bytes:
        notes.append(f"the recording stops within a frame ({reader.truncated_bytes} bytes of it are there)")


def replay_tlog(
    path: Path,
    settings: Config,
    *,
    mission: Mission | None = None,
    show: Show | None = None,
    on_bytes: Callable[[int], None] | None = None,
) -> ReplayResult:
    """A recording through the engines.

    ``mission``: area and limits given by the user. Without an area, a disc of 500 m round
    the first valid vehicle position.

    Raises:
        InputError: not a recording, or nothing in it.
    """
    replayer = Replayer(settings, show)
    notes: list[str] = []
    seq = 0

    def take(time_ns: int, unix_us: int, entry: AnyInput) -> Step:
        nonlocal seq
        step = replayer.handle(Record(seq, time_ns, unix_us, entry))
        seq += 1
        return step

    def default_area(place: Geodetic) -> Area:
        return disc_area(place, DEFAULT_AREA_RADIUS_M, "500 m round the first vehicle")

    time_ns = unix_us = 0
    for time_ns, unix_us, entry in tlog_inputs(path, notes, on_bytes):
        if seq == 0:
            take(time_ns, unix_us, SessionInput("began", __version__))
            if mission is not None:
                take(time_ns, unix_us, MissionInput(mission, "command line"))
        for output in take(time_ns, unix_us, entry).ingest:
            if isinstance(output, VehicleState):
                following = mission_with_origin(replayer.pipeline.mission, output, default_area)
                if following is not None:
                    take(time_ns, unix_us, MissionInput(following, "first valid vehicle position"))
    if seq == 0:
        raise InputError(f"{path}: no MAVLink frame in it; needed is a .tlog (8-byte time, then a frame, …)")
    take(time_ns, unix_us, SessionInput("ended", __version__))
    result = replayer.finish()
    result.notes = notes
    return result


def replay_session(
    directory: Path,
    settings: Config | None = None,
    *,
    show: Show | None = None,
    on_record: Callable[[int], None] | None = None,
) -> ReplayResult:
    """A whole session from its journal, operator's actions included: gives what the live run gave.

    ``settings``: the session's own (``settings.toml``) unless given.

    Raises:
        InputError: not a session.
    """
    _meta, reader = open_to_read(directory)
    replayer = Replayer(settings or read_settings(directory), show)
    # Drops are journalled after the windows they concern: they must be known before.
    dropped = dropped_windows(open_to_read(directory)[1])
    for record in reader:
        replayer.handle(record, dropped)
        if on_record is not None:
            on_record(record.seq)
    result = replayer.finish()
    damage = reader.damage()
    if damage:
        result.notes.append(damage)
    return result
