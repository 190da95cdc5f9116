"""``groundstation serve``: settings and files into a running station, signals into its end."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from groundstation.config import Config, LoadedConfig
from groundstation.domain.errors import InputError
from groundstation.domain.mission import Mission
from groundstation.mission_files import read_area, read_search
from groundstation.station import Station, StationOptions
from groundstation.store.session import find_resumable
from groundstation.terrain import read_terrain

logger = logging.getLogger(__name__)


def mission_of(config: Config) -> Mission:
    """The mission that the settings and their GeoJSON files describe. Raises InputError."""
    ground = config.target.ground_amsl_m
    area, last_known = read_search(config.area) if config.area is not None else (None, ())
    return Mission(
        revision=1,
        search_area=area,
        fence=read_area(config.fence) if config.fence is not None else None,
        target_height_min_m=config.target.height_min_m,
        target_height_max_m=config.target.height_max_m,
        ground_amsl_m=ground,
        height_reference="settings" if ground is not None else "unknown",
        limits=config.limits,
        last_known=last_known,
        terrain=read_terrain(config.terrain, area) if config.terrain is not None else None,
    )


def choose_session(config: Config, resume: Path | None, new_session: bool) -> Path | None:
    """The session to go on with, or None for a new one. Raises InputError."""
    if resume is not None and new_session:
        raise InputError("--resume and --new-session exclude each other; give one of them")
    if resume is not None or new_session:
        return resume
    found = find_resumable(config.data_dir, config.store.resume_max_age_h, time.time_ns() // 1000)
    if found is not None:
        print(f"going on with {found}, which was cut short (--new-session begins anew)", file=sys.stderr)
    return found


@contextlib.contextmanager
def stopping_on_signals(stop: asyncio.Event) -> Iterator[None]:
    """SIGINT and SIGTERM end the run in order; a second one ends it at once."""
    loop = asyncio.get_running_loop()
    signals = (signal.SIGINT, signal.SIGTERM)

    def ask() -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    for number in signals:
        loop.add_signal_handler(number, ask)
    try:
        yield
    finally:
        for number in signals:
            loop.remove_signal_handler(number)


async def run_service(loaded: LoadedConfig, *, resume: Path | None, new_session: bool) -> None:
    """Run the station until a signal. Raises the project's errors, one line each."""
    config = loaded.config
    options = StationOptions(
        mission=mission_of(config),
        resume_from=choose_session(config, resume, new_session),
    )
    station = Station(loaded, options)
    with stopping_on_signals(station.stop):
        print(f"map page: {station.url}", file=sys.stderr)
        print(f"session:  {station.session.directory}", file=sys.stderr)
        if config.fence is None and station.pipeline.mission.fence is None:
            print("no --fence is given: vehicles are shown, never commanded", file=sys.stderr)
        await station.run()
