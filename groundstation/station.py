"""Composition root of a live station: wires the rooms, owns the one order of records.

Everything that may change a belief goes through ``take``: stamped, journalled, handled by
ingest and the command desk, then shown. Three things run beside it and come back as inputs
or outputs: the estimator (a process), planning (a thread) and the radios. What leaves goes
through the guard, whoever made it. The event loop never waits for a disk, a solver or a page.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from groundstation import __version__
from groundstation.command.desk import CommandDesk
from groundstation.command.telemetry import TelemetryDesk
from groundstation.config import LoadedConfig
from groundstation.connections.forward import Forward
from groundstation.connections.hub import Hub as Radios
from groundstation.connections.transport import Address
from groundstation.display import Display
from groundstation.domain.errors import ResourceError
from groundstation.domain.events import Counter, Event, Severity
from groundstation.domain.inputs import (
    AnyInput,
    ConnectionInput,
    Direction,
    DropInput,
    FrameInput,
    MissionInput,
    PlanInput,
    Record,
    TickInput,
)
from groundstation.domain.mission import Mission
from groundstation.domain.vehicle import VehicleState
from groundstation.engine.estimator import EstimatorOutput
from groundstation.engine.ingest import Ingest
from groundstation.guidance import propose
from groundstation.guidance.plan import PlanRequest
from groundstation.lanes import EstimatorLane, WindowKey
from groundstation.mavlink.framing import Frame, frame_of
from groundstation.mavsdk_lane import MavsdkLane
from groundstation.mission_files import distance_warning
from groundstation.operator_actions import OperatorActions
from groundstation.page_sources import session_sources
from groundstation.pipeline import Pipeline, Step, mission_with_origin, mission_with_settings
from groundstation.planning_lane import PlanningLane
from groundstation.safety.guard import Source
from groundstation.server.app import create_app
from groundstation.server.hub import Hub
from groundstation.server.picture import Picture
from groundstation.server.rows import ForwardStatus
from groundstation.server.serve import listen, serve, url_of
from groundstation.session_settings import with_engines_of, write_settings
from groundstation.store.session import ResumedSession, open_new, resume
from groundstation.taking_up import take_up

logger = logging.getLogger(__name__)

TICK_S = 0.1
COUNTERS_S = 1.0


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
        config, resume_from = loaded.config, options.resume_from
        settings = self.settings = config if resume_from is None else with_engines_of(config, resume_from)
        self.options = options
        self.stop = asyncio.Event()
        self.ready = asyncio.Event()
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
        self.display = Display(self.hub, self.session, options.source, options.title)
        self.planning = PlanningLane(self._plan_request, self._propose, self.take, self.display.event)
        self.mavsdk: MavsdkLane | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._lane_counters: list[Counter] = []
        self._last_seq = -1

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
        telling = self.telemetry.handle(record, step.ingest, self.display.targets.values())
        for send in (*step.frames, *telling):
            self._send(frame_of(send.frame), Source.STATION, send.vehicle_id)
        self._submit(step)
        self.display.step(record, step)
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
                    self.display.event(Event(self._now_ns(), "mission.far", Severity.WARNING, text))

    def _submit(self, step: Step) -> None:
        dropped = self.lane.submit(step.work)
        if dropped:
            self._drop("estimator", dropped, "solving is slower than the windows come")

    def _drop(self, queue: str, keys: tuple[WindowKey, ...], why: str) -> None:
        self.take(DropInput(queue, keys))
        now = self._now_ns()
        text = f"{len(keys)} link windows were dropped: {why}"
        self.display.event(Event(now, "estimator.dropped", Severity.WARNING, text))

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
        self.display.event(Event(self._now_ns(), f"connection.{state}", severity, text))

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
            self.display.estimate(output)

    def _lane_failed(self, text: str, dropped: tuple[WindowKey, ...]) -> None:
        def tell() -> None:
            self.display.event(Event(self._now_ns(), "estimator.restarted", Severity.ERROR, text))
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
            app = create_app(self.hub, OperatorActions(self), session_sources(self.session))
            async with contextlib.AsyncExitStack() as stack, asyncio.TaskGroup() as group:
                if self.settings.command.command.use_mavsdk:
                    lane = MavsdkLane(
                        self._from_mavsdk,
                        self.display.event,
                        self.settings.command.command,
                        self._now_ns,
                    )
                    self.mavsdk = await stack.enter_async_context(lane)
                group.create_task(serve(app, self._listener, self.stop, self.ready), name="server")
                group.create_task(self._until_stop(self.radios.run(), "radios"))
                group.create_task(self._until_stop(self._ticks(), "ticks"))
                group.create_task(self._until_stop(self.planning.run(), "plans"))
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
            await take_up(self._resumed, self.pipeline, self.lane, self.display)
            for event in (*self._resumed.events, *self._events_at_start):
                self.display.event(event)
            self._follow(self._resumed.resumed)
            await asyncio.to_thread(self.lane.drain, 60.0)
        mission = mission_with_settings(self.pipeline.mission, self.options.mission)
        if mission is not None:
            self.take(MissionInput(mission, "settings"))
        self.display.status(self.pipeline.mission)

    async def _ticks(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            self.take(TickInput())
            due = max(due + TICK_S, loop.time())
            await asyncio.sleep(max(0.0, due - loop.time()))

    def _plan_request(self) -> PlanRequest | None:
        targets = self.display.targets
        if not targets or self.pipeline.mission.fence is None:
            return None
        return self.desk.plan_request(self._now_ns(), list(targets.values()))

    def _propose(self, request: PlanRequest) -> PlanInput:
        return propose(request, self.settings.guidance, self.settings.safety)

    async def _housekeeping(self) -> None:
        loop = asyncio.get_running_loop()
        next_snapshot = loop.time() + self.settings.store.snapshot_interval_s
        while True:
            await asyncio.sleep(COUNTERS_S)
            for event in self.session.events():
                self.display.event(event)
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
                self.display.leave_targets()
        finally:
            await asyncio.to_thread(self.lane.close)


def _as_it_came(frame: Frame, _peer: str) -> bytes:
    return frame.raw
