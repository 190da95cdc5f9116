"""Composition root of a live station: wires the rooms, owns the one order of records.

Everything that may change a belief goes through ``take``: stamped, journalled, handled by
ingest and the command desk, then shown. Three things run beside it and come back as inputs
or outputs: the estimator (a process), planning (a thread) and the radios. What leaves goes
through the guard, whoever made it. The event loop never waits for a disk, a solver or a page.

Longer than a module should be: it is the one place where all rooms meet, and reads from top to bottom.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from groundstation import __version__
from groundstation.command.desk import CommandDesk
from groundstation.command.outputs import SendFrame
from groundstation.command.telemetry import TelemetryDesk
from groundstation.config import Config, LoadedConfig
from groundstation.connections.forward import Forward
from groundstation.connections.hub import Hub as Radios
from groundstation.connections.transport import Address
from groundstation.domain.errors import GroundstationError, ResourceError
from groundstation.domain.events import Counter, Event, Severity
from groundstation.domain.inputs import (
    AnyInput,
    ConnectionInput,
    Direction,
    DropInput,
    FrameInput,
    MissionInput,
    Record,
    TickInput,
)
from groundstation.domain.mission import Mission
from groundstation.domain.radio import LinkWindow, Listening
from groundstation.domain.target import TargetJoined, TargetState, TargetWaiting
from groundstation.domain.vehicle import VehicleState
from groundstation.engine.estimator import EstimatorOutput
from groundstation.engine.ingest import Ingest
from groundstation.export import encode, search_map_archive
from groundstation.guidance import propose
from groundstation.lanes import EstimatorLane, WindowKey
from groundstation.logs import log_event
from groundstation.mavlink.framing import Frame, frame_of
from groundstation.mavlink.vehicle_message import VehicleMessage
from groundstation.mavsdk_lane import MavsdkLane
from groundstation.mission_files import distance_warning
from groundstation.operator_actions import OperatorActions
from groundstation.pipeline import Pipeline, Step, dropped_windows, mission_with_origin, without_dropped
from groundstation.safety.guard import Source
from groundstation.server.actions import Sources
from groundstation.server.app import create_app
from groundstation.server.hub import Hub
from groundstation.server.picture import Picture
from groundstation.server.rest import HealthCheck, HistoryPoint
from groundstation.server.rows import ForwardStatus, StationStatus
from groundstation.server.serve import listen, serve, url_of
from groundstation.session_settings import read_settings, write_settings
from groundstation.store.queries import TargetPoint
from groundstation.store.session import ResumedSession, open_new, resume

logger = logging.getLogger(__name__)

TICK_S = 0.1
COUNTERS_S = 1.0
PLAN_INTERVAL_S = 5.0
_NUMBER = re.compile(r"\d+(\.\d+)?")


@dataclass(frozen=True, slots=True)
class StationOptions:
    """What a run is given beside its settings."""

    mission: Mission
    """Area, fence and limits as the settings have them; what they lack a resumed session keeps."""
    resume_from: Path | None = None
    """A session to go on with; None: a new one."""
    source: Literal["live", "demo"] = "live"
    title: str = ""


class Station:
    """One run of the station. ``run`` returns after ``stop`` was set and everything is closed."""

    def __init__(self, loaded: LoadedConfig, options: StationOptions) -> None:
        """Takes the port and the session directory at once, so that errors come before any work.

        Raises:
            InputError, ResourceError: one line each: an occupied port, a full disk, a session in use.
        """
        settings = self.settings = _engines_of_session(loaded.config, options.resume_from)
        self.options = options
        self.stop = asyncio.Event()
        self.ready = asyncio.Event()
        self.targets: dict[int, TargetState] = {}
        self.waiting: dict[int, TargetWaiting] = {}
        self.forwards = [
            Forward(
                url,
                commands=settings.forward_commands,
                on_frame=self._on_foreign,
                is_ours=self._is_ours,
                on_state=self._on_connection,
                settings=settings.connections,
            )
            for url in settings.forward
        ]
        # Made, not opened: a wrong URL must be told before a port or a directory is taken.
        self.radios = Radios(
            settings.links,
            self._on_frames,
            self._on_connection,
            settings=settings.connections,
            forwards=self.forwards,
            clock_ns=self._now_ns,
        )
        self._resumed: ResumedSession | None = None
        self._events_at_start: list[Event] = []
        self._listener = listen(settings.server)
        try:
            self._open_session(loaded)
        except BaseException:
            self._listener.close()
            raise
        self.desk = CommandDesk(
            settings.command.command, settings.safety, forward_commands=settings.forward_commands
        )
        self.pipeline = Pipeline(Ingest(settings.measurement), self.desk)
        self.telemetry = TelemetryDesk(settings.command.telemetry, settings.command.command)
        self.lane = EstimatorLane(settings.estimator, self._from_lane, self._lane_failed)
        epoch = f"{self.session.meta.session_id}-{len(self.session.meta.runs)}"
        self.hub = Hub(Picture(epoch, settings.server), self._now_ns)
        self.mavsdk: MavsdkLane | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._lane_counters: list[Counter] = []
        self._last_seq = -1
        self._notes: frozenset[str] = frozenset()
        self._taking_up = False
        """Records from before a stop are being handled again: stored once more (the database takes a row
        once), but not logged as if they happened now."""

    def _open_session(self, loaded: LoadedConfig) -> None:
        plain, store, resume_from = loaded.plain(), self.settings.store, self.options.resume_from
        if resume_from is None:
            self.session, self._began = open_new(self.settings.data_dir, __version__, store, plain)
            write_settings(self.session.directory, loaded)
            return
        self._resumed = resume(resume_from, __version__, store, plain)
        self.session = self._resumed.session
        if self.settings != loaded.config:
            text = "the session goes on with its own settings for measuring, estimating and commanding"
            self._events_at_start.append(Event(self._now_ns(), "settings.kept", Severity.WARNING, text))

    def _now_ns(self) -> int:
        """Station time."""
        return self.session.clock.time_ns()

    @property
    def url(self) -> str:
        """Of the page, for a browser on this machine."""
        return url_of(self._listener)

    # -- the one order of records --------------------------------------------------------

    def take(self, entry: AnyInput) -> Step:
        """Stamp, journal and handle one input; returns what came of it at once."""
        return self._follow(self.session.record(entry))

    def _follow(self, record: Record) -> Step:
        step = self.pipeline.handle(record)
        self._last_seq = record.seq
        # What leaves goes first: a hold must not wait for a page.
        for send in (*step.frames, *self.telemetry.handle(record, step.ingest, self.targets.values())):
            self._send(frame_of(send.frame), Source.STATION, send.vehicle_id)
        self._submit(step)
        self._show(record, step)
        for output in step.ingest:
            if isinstance(output, VehicleState):
                mission = mission_with_origin(self.pipeline.mission, output)
                if mission is not None:
                    who = f"first valid place of vehicle {output.vehicle_id}"
                    self.take(MissionInput(mission, who))
                    self._check_areas(mission)
        return step

    def _check_areas(self, mission: Mission) -> None:
        """Areas far from the vehicles (longitude and latitude swapped, another day's file) are told."""
        for area in (mission.search_area, mission.fence):
            if area is not None and mission.origin is not None:
                text = distance_warning(area, mission.origin)
                if text is not None:
                    self._event(Event(self._now_ns(), "mission.far", Severity.WARNING, text))

    def _submit(self, step: Step) -> None:
        dropped = self.lane.submit(step.work)
        if dropped:
            self._drop("estimator", dropped, "solving is slower than the windows come")

    def _drop(self, queue: str, keys: tuple[WindowKey, ...], why: str) -> None:
        self.take(DropInput(queue, keys))
        now = self._now_ns()
        text = f"{len(keys)} link windows were dropped: {why}"
        self._event(Event(now, "estimator.dropped", Severity.WARNING, text))

    def _show(self, record: Record, step: Step) -> None:
        for output in (*step.ingest, *step.desk):
            if isinstance(output, VehicleMessage | LinkWindow | Listening | SendFrame):
                continue
            if isinstance(output, Event):
                self._event(output)
                continue
            self.hub.apply(output, record.time_ns)
            self.session.database.store(output)
        if isinstance(record.input, MissionInput | ConnectionInput):
            self.hub.apply(record.input, record.time_ns)
        if isinstance(record.input, MissionInput):
            self._show_status()

    def _event(self, event: Event) -> None:
        if not self._taking_up:
            log_event(event)
        self.hub.apply(event)
        self.session.database.store(event)

    def _show_status(self) -> None:
        fenced = self.pipeline.mission.fence is not None
        reason = "" if fenced else "no fence is set: start with --fence FILE.geojson to command vehicles"
        self.hub.apply(
            StationStatus(
                version=__version__,
                title=self.options.title or self.session.directory.name,
                source=self.options.source,
                commands_enabled=fenced,
                commands_reason=reason,
            )
        )

    # -- radios ---------------------------------------------------------------------------

    def _on_frames(self, connection: str, frames: Sequence[Frame], _address: Address) -> None:
        for frame in frames:
            if self.mavsdk is not None:
                self.mavsdk.feed(frame.raw)
            self.take(FrameInput(connection, Direction.IN, frame.raw))

    def _on_connection(self, connection: str, state: str, detail: str) -> None:
        self.take(ConnectionInput(connection, state, detail))
        expected = state == "open" or self.stop.is_set()
        severity = Severity.INFO if expected else Severity.WARNING
        text = f"{connection}: {state}" + (f" ({detail})" if detail else "")
        self._event(Event(self._now_ns(), f"connection.{state}", severity, text))

    def _is_ours(self, system_id: int) -> bool:
        return system_id == self.settings.command.command.system_id or self.radios.hears(system_id)

    def _on_foreign(self, _name: str, frame: Frame) -> None:
        """A frame of another ground station that was allowed to command: the guard judges it too."""
        self._send(frame, Source.FORWARD, None)

    def _from_mavsdk(self, frame: Frame) -> None:
        self._send(frame, Source.MAVSDK, None)

    def _send(self, frame: Frame, source: Source, vehicle_id: int | None) -> None:
        now_ns = self._now_ns()
        verdict = self.desk.guard.admit(frame, source, now_ns)
        if not verdict.admitted:
            return
        if verdict.reason == "grant" and source is Source.STATION and self.mavsdk is not None:
            self.mavsdk.fly(self.desk.grants.live(verdict.vehicle_id or 0, now_ns))
            return
        # Another station's frames leave as they came: a new sequence number would break their signature.
        stamp = _as_it_came if source is Source.FORWARD else self.desk.guard.stamp
        for connection, sent in self.radios.send_stamped(frame, stamp, verdict.vehicle_id or vehicle_id):
            record = self.session.record(FrameInput(connection, Direction.OUT, sent))
            self.pipeline.handle(record)
            self._last_seq = record.seq

    # -- the estimator's lane -----------------------------------------------------------

    def _from_lane(self, outputs: list[EstimatorOutput], counters: list[Counter]) -> None:
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop ended before the lane did
                self._loop.call_soon_threadsafe(self._on_estimates, outputs, counters)

    def _on_estimates(self, outputs: Iterable[EstimatorOutput], counters: list[Counter]) -> None:
        self._lane_counters = counters
        for output in outputs:
            if isinstance(output, Event):
                self._event(output)
                continue
            if isinstance(output, TargetState):
                self.targets[output.beacon_id] = output
                self.waiting.pop(output.beacon_id, None)
            elif isinstance(output, TargetWaiting | TargetJoined):
                # Nobody is sent to, or told of, an id that has no estimate of its own (any more).
                self.targets.pop(output.beacon_id, None)
                self.waiting.pop(output.beacon_id, None)
                if isinstance(output, TargetWaiting):
                    self.waiting[output.beacon_id] = output
            self.hub.apply(output)
            self.session.database.store(output)

    def _lane_failed(self, text: str, dropped: tuple[WindowKey, ...]) -> None:
        def tell() -> None:
            self._event(Event(self._now_ns(), "estimator.restarted", Severity.ERROR, text))
            if dropped:
                self._drop("estimator", dropped, text)

        if self._loop is not None:
            self._loop.call_soon_threadsafe(tell)

    # -- running -----------------------------------------------------------------------

    async def run(self) -> None:
        """Until ``stop`` is set. Raises what the rooms raise; a failing radio is an event, not an error."""
        self._loop = asyncio.get_running_loop()
        try:
            await self._begin()
            app = create_app(self.hub, OperatorActions(self), self._sources())
            async with contextlib.AsyncExitStack() as stack, asyncio.TaskGroup() as group:
                if self.settings.command.command.use_mavsdk:
                    lane = MavsdkLane(
                        self._from_mavsdk,
                        self._event,
                        self.settings.command.command,
                        self._now_ns,
                    )
                    self.mavsdk = await stack.enter_async_context(lane)
                group.create_task(serve(app, self._listener, self.stop, self.ready), name="server")
                group.create_task(self._until_stop(self.radios.run(), "radios"))
                group.create_task(self._until_stop(self._ticks(), "ticks"))
                group.create_task(self._until_stop(self._plans(), "plans"))
                group.create_task(self._until_stop(self._housekeeping(), "housekeeping"))
        finally:
            self._listener.close()
            await self._end()

    async def _until_stop(self, body: Any, name: str) -> None:
        task = asyncio.create_task(body, name=name)
        stopping = asyncio.create_task(self.stop.wait())
        try:
            await asyncio.wait((task, stopping), return_when=asyncio.FIRST_COMPLETED)
        finally:
            stopping.cancel()
            task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task

    async def _begin(self) -> None:
        if self._resumed is None:
            await asyncio.to_thread(self.lane.start)
            self._follow(self._began)
        else:
            await self._take_up(self._resumed)
        known, given = self.pipeline.mission, self.options.mission
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
            merged = replace(
                merged, ground_amsl_m=given.ground_amsl_m, height_reference=given.height_reference
            )
        if merged != known or known.revision == 0:
            self.take(MissionInput(replace(merged, revision=known.revision + 1), "settings"))
        self._show_status()

    async def _take_up(self, resumed: ResumedSession) -> None:
        """Restore the snapshot, handle what was journalled behind it, then say ``resumed``."""
        snapshot = resumed.snapshot
        state = snapshot.state if snapshot is not None else None
        await asyncio.to_thread(self.lane.start, state["estimator"] if state is not None else None)
        if state is not None:
            self.pipeline.restore(state["pipeline"], self.pipeline.mission)
            self.pipeline.mission = self.desk.mission
            self.hub.apply(self.desk.mission)
        self._taking_up = True
        tail = await asyncio.to_thread(list, resumed.tail)
        dropped = dropped_windows(tail)
        for number, record in enumerate(tail):
            if record.seq >= resumed.resumed.seq:
                break
            step = self.pipeline.handle(record)
            self.lane.submit(tuple(without_dropped(step.work, dropped)))
            self._show(record, step)
            if number % 2000 == 1999:
                await asyncio.to_thread(self.lane.drain, 60.0)
        await asyncio.to_thread(self.lane.drain, 60.0)
        await asyncio.sleep(0)  # what the lane handed over runs now
        self._taking_up = False
        for event in (*resumed.events, *self._events_at_start):
            self._event(event)
        self._follow(resumed.resumed)
        await asyncio.to_thread(self.lane.drain, 60.0)

    async def _ticks(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            self.take(TickInput())
            due = max(due + TICK_S, loop.time())
            await asyncio.sleep(max(0.0, due - loop.time()))

    async def _plans(self) -> None:
        """Planning is a lane of its own: its result comes back as an input, with what it was based on."""
        while True:
            await asyncio.sleep(PLAN_INTERVAL_S)
            if not self.targets or self.pipeline.mission.fence is None:
                continue
            request = self.desk.plan_request(self._now_ns(), list(self.targets.values()))
            try:
                plan = await asyncio.to_thread(propose, request, self.settings.guidance, self.settings.safety)
            except GroundstationError as error:
                logger.warning("planning: %s", error)
                continue
            # "not heard for 34 s" and "… for 39 s" are the same news.
            news = {_NUMBER.sub("#", note): note for note in plan.notes}
            if plan.proposals or news.keys() != self._notes:
                self.take(plan)
                for gist, note in news.items():
                    if gist not in self._notes:
                        self._event(Event(request.time_ns, "plan.note", Severity.INFO, note))
                self._notes = frozenset(news)

    async def _housekeeping(self) -> None:
        loop = asyncio.get_running_loop()
        next_snapshot = loop.time() + self.settings.store.snapshot_interval_s
        while True:
            await asyncio.sleep(COUNTERS_S)
            for event in self.session.events():
                self._event(event)
            for counter in self.counters():
                self.hub.apply(counter)
            for forward in self.forwards:
                self.hub.apply(ForwardStatus(forward.name, forward.commands, forward.is_open))
            if loop.time() >= next_snapshot:
                next_snapshot = loop.time() + self.settings.store.snapshot_interval_s
                self._request_snapshot()

    def _request_snapshot(self) -> None:
        seq, time_ns, own = self._last_seq, self._now_ns(), self.pipeline.state()

        def save(estimator: dict[str, Any]) -> None:
            # On the lane's thread: the disk may take its time there.
            if self.stop.is_set():
                return  # the journal is being closed; what is not in a snapshot is in there
            try:
                self.session.save_snapshot(seq, time_ns, {"pipeline": own, "estimator": estimator})
            except ResourceError as error:
                logger.warning("snapshot: %s", error)

        self.lane.request_state(save)

    def _leave_targets(self) -> None:
        """The last beliefs beside the journal, in a file that any map program opens."""
        path = self.session.directory / "targets.geojson"
        targets = [self.targets[beacon_id] for beacon_id in sorted(self.targets)]
        try:
            path.write_bytes(encode("geojson", targets))
        except OSError as error:
            logger.warning("cannot write %s: %s", path, error.strerror)

    def counters(self) -> list[Counter]:
        """Of all rooms."""
        return [
            *self.pipeline.ingest.counters(),
            *self.desk.counters(),
            *self._lane_counters,
            *self.session.counters(),
            *self.radios.counters(),
            *(self.mavsdk.counters() if self.mavsdk is not None else []),
            Counter("estimator_backlog_windows", (), self.lane.backlog_windows),
        ]

    def _sources(self) -> Sources:
        def health() -> list[HealthCheck]:
            return [
                HealthCheck(name=name, ok=False, detail=why) for name, why in self.session.health().items()
            ]

        async def older_events(before_ns: int, limit: int) -> Sequence[Event]:
            return await asyncio.to_thread(self.session.database.reader.events_before, before_ns, limit)

        async def history(beacon_id: int, since_ns: int, limit: int) -> Sequence[HistoryPoint]:
            curve = self.session.database.reader.target_curve
            return [point_row(point) for point in await asyncio.to_thread(curve, beacon_id, since_ns, limit)]

        return Sources(
            older_events=older_events,
            history=history,
            search_map_file=search_map_archive,
            health=health,
            version=__version__,
        )

    async def _end(self) -> None:
        """Close in order: radios, journal (``ended``), the estimator's last work, the child."""
        try:
            try:
                record = self.session.close(__version__)
            except ResourceError as error:
                logger.warning("%s", error)
                record = None
            if record is not None:
                step = self.pipeline.handle(record)
                self.lane.submit(step.work)
                await asyncio.to_thread(self.lane.drain, 30.0)
                await asyncio.sleep(0)  # what the lane handed over runs now
                self._leave_targets()
        finally:
            await asyncio.to_thread(self.lane.close)


def _engines_of_session(config: Config, resume_from: Path | None) -> Config:
    """``config``, but what the engines are run with as the session began: or its replay would differ."""
    if resume_from is None:
        return config
    kept = read_settings(resume_from)
    return replace(
        config,
        measurement=kept.measurement,
        channel=kept.channel,
        estimator=kept.estimator,
        safety=kept.safety,
        command=kept.command,
    )


def point_row(point: TargetPoint) -> HistoryPoint:
    """A belief of the database for the page."""
    return HistoryPoint(
        time_ns=str(point.time_ns),
        latitude_deg=point.latitude_deg,
        longitude_deg=point.longitude_deg,
        altitude_amsl_m=point.altitude_amsl_m,
        radius_90_m=point.radius_90_m,
        windows=point.windows,
        links=point.links,
    )


def _as_it_came(frame: Frame, _peer: str) -> bytes:
    return frame.raw
