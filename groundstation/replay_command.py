"""``groundstation replay``: a recording or a session through the engines, into a file or the page."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import typer

from groundstation import __version__
from groundstation.command.outputs import SendFrame
from groundstation.config import Config, LoadedConfig
from groundstation.domain.errors import InputError, ResourceError
from groundstation.domain.events import Event
from groundstation.domain.inputs import ConnectionInput, MissionInput, Record
from groundstation.domain.radio import LinkWindow, Listening
from groundstation.engine.estimator import EstimatorOutput
from groundstation.export import encode, search_map_archive, search_map_files
from groundstation.logs import log_event
from groundstation.mavlink.vehicle_message import VehicleMessage
from groundstation.pipeline import Step
from groundstation.replay import ReplayResult, Show, replay_session, replay_tlog
from groundstation.server.actions import ActionResult, Sources
from groundstation.server.app import create_app
from groundstation.server.hub import Hub
from groundstation.server.picture import Picture
from groundstation.server.rows import StationStatus
from groundstation.server.serve import listen, serve, url_of
from groundstation.service import mission_of, stopping_on_signals

REFUSAL = "this is a replay: it sends nothing"


class ReplayActions:
    """Implements the server's ``Actions``: everything is refused."""

    async def confirm(self, proposal_id: str, vehicle_id: int, who: str) -> ActionResult:
        """Refused."""
        return ActionResult(False, REFUSAL)

    async def dismiss(self, proposal_id: str, who: str) -> ActionResult:
        """Refused."""
        return ActionResult(False, REFUSAL)

    async def hold(self, vehicle_id: int, who: str) -> ActionResult:
        """Refused."""
        return ActionResult(False, REFUSAL)

    async def hold_all(self, who: str) -> ActionResult:
        """Refused."""
        return ActionResult(False, REFUSAL)

    async def join(self, beacon_id: int, into_beacon_id: int, who: str) -> ActionResult:
        """Refused."""
        return ActionResult(False, REFUSAL)

    async def separate(self, beacon_id: int, who: str) -> ActionResult:
        """Refused."""
        return ActionResult(False, REFUSAL)


def run_replay(
    source: Path,
    loaded: LoadedConfig,
    *,
    settings_given: bool,
    output_format: str,
    out: Path | None,
    speed: float | None,
    search_maps: Path | None = None,
) -> None:
    """The whole command. Raises InputError and ResourceError, one line each."""
    if not source.exists():
        raise InputError(f"{source}: no such file or directory; needed is a .tlog or a session's directory")
    if speed is not None:
        asyncio.run(_on_page(source, loaded, settings_given, speed))
        return
    total = 0 if source.is_dir() else source.stat().st_size
    if sys.stderr.isatty() and total:
        with typer.progressbar(length=total, label=f"replaying {source.name}", file=sys.stderr) as bar:
            seen = 0

            def on_bytes(position: int) -> None:
                nonlocal seen
                if position - seen > total // 200:
                    bar.update(position - seen)
                    seen = position

            result = _run(source, loaded.config, settings_given, None, on_bytes)
    else:
        result = _run(source, loaded.config, settings_given, None, None)
    for event in result.events:
        log_event(event)
    for note in result.notes:
        print(f"{source.name}: {note}", file=sys.stderr)
    for waiting in result.waiting.values():
        print(f"beacon {waiting.beacon_id}: no estimate: {waiting.needed}", file=sys.stderr)
    if search_maps is not None:
        _write_search_maps(search_maps, result)
    data = encode(output_format, result.sorted_targets())
    if out is None:
        sys.stdout.buffer.write(data)
        sys.stdout.flush()
        return
    try:
        out.write_bytes(data)
    except OSError as error:
        raise ResourceError(f"cannot write {out}: {error.strerror}") from error
    print(f"{out}: {len(result.targets)} beacons from {result.records} records", file=sys.stderr)


def _write_search_maps(directory: Path, result: ReplayResult) -> None:
    """Of each beacon two grids and their projection."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for beacon_id in sorted(result.search_maps):
            for name, content in search_map_files(result.search_maps[beacon_id]).items():
                (directory / name).write_bytes(content)
    except OSError as error:
        raise ResourceError(f"cannot write {directory}: {error.strerror}") from error
    print(f"{directory}: search maps of {len(result.search_maps)} beacons", file=sys.stderr)


def _run(
    source: Path,
    config: Config,
    settings_given: bool,
    show: Show | None,
    on_bytes: Callable[[int], None] | None,
) -> ReplayResult:
    if source.is_dir():
        return replay_session(source, config if settings_given else None, show=show)
    mission = mission_of(replace(config, fence=None))
    return replay_tlog(source, config, mission=mission, show=show, on_bytes=on_bytes)


class _ReplayEndedError(Exception):
    """The page's replay was ended by the user."""


async def _on_page(source: Path, loaded: LoadedConfig, settings_given: bool, speed: float) -> None:
    """In the recording's own time: the engines on a worker thread, the page in the event loop."""
    config = loaded.config
    listener = listen(config.server)
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    time_ns = 0
    hub = Hub(Picture("replay", config.server), lambda: time_ns)
    hub.apply(StationStatus(__version__, f"replay: {source.name}", "replay", False, REFUSAL))
    began_wall_s, began_ns = loop.time(), 0

    def deliver(record: Record, step: Step, outputs: list[EstimatorOutput]) -> None:
        nonlocal time_ns
        time_ns = record.time_ns
        if isinstance(record.input, MissionInput | ConnectionInput):
            hub.apply(record.input, record.time_ns)
        for output in (*step.ingest, *step.desk, *outputs):
            if isinstance(output, Event):
                log_event(output)
            if not isinstance(output, VehicleMessage | LinkWindow | Listening | SendFrame):
                hub.apply(output, record.time_ns)

    def show(record: Record, step: Step, outputs: list[EstimatorOutput]) -> None:
        nonlocal began_ns
        if stop.is_set():
            raise _ReplayEndedError
        began_ns = began_ns or record.time_ns
        due_s = began_wall_s + (record.time_ns - began_ns) / 1e9 / speed
        ahead_s = due_s - loop.time()
        if ahead_s > 0.01:
            asyncio.run_coroutine_threadsafe(asyncio.sleep(ahead_s), loop).result()
        loop.call_soon_threadsafe(deliver, record, step, outputs)

    async def play() -> None:
        try:
            await asyncio.to_thread(_run, source, config, settings_given, show, None)
        except _ReplayEndedError:
            return
        hub.apply(StationStatus(__version__, f"replay: {source.name} (ended)", "replay", False, REFUSAL))
        print("the recording has ended; the page stays (Ctrl-C ends it)", file=sys.stderr)

    with stopping_on_signals(stop):
        print(f"map page: {url_of(listener)}", file=sys.stderr)
        async with asyncio.TaskGroup() as group:
            app = create_app(
                hub, ReplayActions(), Sources(search_map_file=search_map_archive, version=__version__)
            )
            group.create_task(serve(app, listener, stop))
            group.create_task(play())
