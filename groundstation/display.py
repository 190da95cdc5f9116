"""What a live station shows and keeps: its outputs to the page, the database and the log.

Exists so that every output takes one way out, whichever room it came from. Rule: nothing here
decides anything; what an engine or the desk said is shown as it was said.
"""

from __future__ import annotations

import logging
from typing import Literal

from groundstation import __version__
from groundstation.command.outputs import SendFrame
from groundstation.domain.events import Event
from groundstation.domain.inputs import ConnectionInput, MissionInput, Record
from groundstation.domain.mission import Mission
from groundstation.domain.radio import LinkWindow, Listening
from groundstation.domain.target import TargetJoined, TargetState, TargetWaiting
from groundstation.engine.estimator import EstimatorOutput
from groundstation.export import encode
from groundstation.logs import log_event
from groundstation.mavlink.vehicle_message import VehicleMessage
from groundstation.pipeline import Step
from groundstation.server.hub import Hub
from groundstation.server.rows import StationStatus
from groundstation.store.session import Session

logger = logging.getLogger(__name__)


class Display:
    """The newest of everything on the page, all of it in the database, events in the log too."""

    def __init__(self, hub: Hub, session: Session, source: Literal["live", "demo"], title: str) -> None:
        """``title`` names what runs; without one the session's directory does."""
        self.hub = hub
        self.targets: dict[int, TargetState] = {}
        """Beacons with an estimate, by id."""
        self.waiting: dict[int, TargetWaiting] = {}
        """Beacons that are heard and not located, by id."""
        self.taking_up = False
        """Records from before a stop are being handled again: stored once more (the database takes a row
        once), but not logged as if they happened now."""
        self._session = session
        self._source = source
        self._title = title or session.directory.name

    def step(self, record: Record, step: Step) -> None:
        """What one record brought at once."""
        for output in (*step.ingest, *step.desk):
            if isinstance(output, VehicleMessage | LinkWindow | Listening | SendFrame):
                continue
            if isinstance(output, Event):
                self.event(output)
                continue
            self.hub.apply(output, record.time_ns)
            self._session.database.store(output)
        if isinstance(record.input, MissionInput | ConnectionInput):
            self.hub.apply(record.input, record.time_ns)
        if isinstance(record.input, MissionInput):
            self.status(record.input.mission)

    def estimate(self, output: EstimatorOutput) -> None:
        """What the estimator said, some time after."""
        if isinstance(output, Event):
            self.event(output)
            return
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
        self._session.database.store(output)

    def event(self, event: Event) -> None:
        """Something worth a line."""
        if not self.taking_up:
            log_event(event)
        self.hub.apply(event)
        self._session.database.store(event)

    def status(self, mission: Mission) -> None:
        """What runs, and whether anything can be commanded."""
        fenced = mission.fence is not None
        reason = "" if fenced else "no fence is set: start with --fence FILE.geojson to command vehicles"
        self.hub.apply(StationStatus(__version__, self._title, self._source, fenced, reason))

    def leave_targets(self) -> None:
        """The last beliefs beside the journal, in a file that any map program opens."""
        path = self._session.directory / "targets.geojson"
        targets = [self.targets[beacon_id] for beacon_id in sorted(self.targets)]
        try:
            path.write_bytes(encode("geojson", targets))
        except OSError as error:
            logger.warning("cannot write %s: %s", path, error.strerror)
