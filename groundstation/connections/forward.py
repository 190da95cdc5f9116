"""Another ground station on ``--forward``: it sees our vehicles, and by default only that.

Every verified frame from a vehicle is passed on as it came, and frames of ids that our dialect
lacks too. What the other station sends (its heartbeats as well) is dropped and counted; only
with ``commands`` does it go to the guard, which decides and journals. A frame that names one of
our own vehicles as its sender never comes in that way: it is an echo or a lie.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from groundstation.connections.link import Link
from groundstation.connections.settings import ConnectionSettings
from groundstation.connections.supervisor import LinkState
from groundstation.connections.transport import Address
from groundstation.connections.urls import LinkUrl, parse_url
from groundstation.domain.events import Counter
from groundstation.mavlink.framing import Frame


class Forward:
    """One other ground station.

    ``on_frame(name, frame)`` gets what the other station sends, only where ``commands`` is true;
    ``is_ours(system_id)`` says whether a system id is that of a vehicle of ours or our own;
    ``on_state(name, state, detail)`` hears of each change of the connection.
    """

    def __init__(
        self,
        url: LinkUrl | str,
        *,
        commands: bool = False,
        on_frame: Callable[[str, Frame], None] | None = None,
        is_ours: Callable[[int], bool] = lambda _system_id: False,
        on_state: Callable[[str, str, str], None] = lambda _name, _state, _detail: None,
        settings: ConnectionSettings | None = None,
    ) -> None:
        self._settings = settings if settings is not None else ConnectionSettings()
        url = parse_url(url) if isinstance(url, str) else url
        self.name = f"forward:{url.name}"
        """Names it in journal, counters and messages; never that of a radio."""
        self._link = Link(url, self, self._settings, name=self.name)
        self.commands = commands
        self._on_frame = on_frame
        self._is_ours = is_ours
        self._on_state = on_state
        self.passed_on = 0
        """Frames offered to the other station."""
        self.dropped = 0
        """Frames of the other station that were not let in: it may only listen."""
        self.echoes = 0
        """Frames of the other station in the name of one of our systems."""
        self.admitted = 0
        """Frames of the other station handed to the guard."""

    @property
    def is_open(self) -> bool:
        """Whether the connection is open now."""
        return self._link.is_open

    @property
    def local_address(self) -> Address:
        """Where it listens, while open."""
        return self._link.local_address

    async def run(self) -> None:
        """Keeps the connection open until cancelled."""
        await self._link.run()

    async def tried(self) -> None:
        """Returns when the first try to open has ended, well or not."""
        await self._link.tried()

    def pass_on(self, raws: list[bytes]) -> None:
        """Sends whole frames to the other station, several in one datagram."""
        self.passed_on += len(raws)
        batch: list[bytes] = []
        size = 0
        for raw in raws:
            if batch and size + len(raw) > self._settings.max_datagram_bytes:
                self._link.send_all(b"".join(batch), len(batch))
                batch, size = [], 0
            batch.append(raw)
            size += len(raw)
        if batch:
            self._link.send_all(b"".join(batch), len(batch))

    def send(self, raw: bytes) -> bool:
        """Sends one frame to the other station: an answer that is targeted at it."""
        return self._link.send_all(raw) > 0

    def counters(self) -> list[Counter]:
        """All totals, the connection's own included."""
        label = (("connection", self.name),)
        own = {
            "forward_passed_on_total": self.passed_on,
            "forward_dropped_total": self.dropped,
            "forward_echoes_total": self.echoes,
            "forward_admitted_total": self.admitted,
        }
        return [*(Counter(name, label, value) for name, value in own.items()), *self._link.counters()]

    def frames(self, _link: Link, frames: list[Frame], _address: Address) -> None:
        """What the other station sent (called by the link)."""
        if not self.commands or self._on_frame is None:
            self.dropped += len(frames)
            return
        for frame in frames:
            if self._is_ours(frame.system_id):
                self.echoes += 1
                continue
            self.admitted += 1
            try:
                self._on_frame(self.name, frame)
            except Exception as error:
                asyncio.get_running_loop().call_exception_handler(
                    {"message": f"a frame from {self.name} could not be handled", "exception": error}
                )

    def unverified(self, _link: Link, raws: list[bytes]) -> None:
        """Frames of unknown ids from the other station: nobody could judge them."""
        self.dropped += len(raws)

    def state(self, _link: Link, state: LinkState, detail: str) -> None:
        """The connection changed (called by the link)."""
        self._on_state(self.name, state.value, detail)
