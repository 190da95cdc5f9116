"""STATUSTEXT in whole sentences: chunks joined, repetitions held back.

Why: autopilots say what is wrong in words, cut to 50 bytes, and say it again every few
seconds. The operator should read each sentence once, and only those of severity warning or
worse: a healthy ArduPilot says some twenty informational ones while it boots.
"""

from __future__ import annotations

from typing import Any

from groundstation.domain.events import Severity
from groundstation.mavlink.messages import StatusText

_CHUNK_LENGTH = 50
_JOIN_NS = 2_000_000_000
_REPEAT_NS = 60_000_000_000
_REMEMBERED = 32
_PARTIALS = 8
_WORST_ERROR = 3
_WORST_WARNING = 4


class StatusTexts:
    """Texts of one vehicle, of all its components."""

    __slots__ = ("_partials", "_told", "informational", "repeated")

    def __init__(self) -> None:
        self._partials: dict[tuple[int, int], list[Any]] = {}
        self._told: dict[str, int] = {}
        self.repeated = 0
        """Sentences held back because they were told less than a minute ago."""
        self.informational = 0
        """Sentences not told because they are notices, information or debugging."""

    def add(self, component_id: int, message: StatusText, time_ns: int) -> tuple[Severity, str] | None:
        """The sentence that ``message`` completes, unless it was told lately."""
        if message.chunk_id == 0:
            return self._tell(message.severity, message.text, time_ns)
        key = (component_id, message.chunk_id)
        partial = self._partials.get(key)
        if partial is None:
            if len(self._partials) >= _PARTIALS:
                del self._partials[next(iter(self._partials))]
            partial = self._partials[key] = [message.severity, time_ns, {}]
        partial[2][message.chunk_seq] = message.text
        if len(message.text.encode()) >= _CHUNK_LENGTH:
            return None
        return self._finish(key, time_ns)

    def tick(self, now_ns: int) -> list[tuple[Severity, str]]:
        """Sentences whose last chunk never came."""
        due = [key for key, partial in self._partials.items() if now_ns - partial[1] >= _JOIN_NS]
        return [found for key in due if (found := self._finish(key, now_ns)) is not None]

    def _finish(self, key: tuple[int, int], time_ns: int) -> tuple[Severity, str] | None:
        severity, _, chunks = self._partials.pop(key)
        text = ""
        for place, index in enumerate(sorted(chunks)):
            text += chunks[index] if index == place else f" … {chunks[index]}"
        return self._tell(severity, text, time_ns)

    def _tell(self, severity: int, text: str, time_ns: int) -> tuple[Severity, str] | None:
        text = " ".join("".join(c if c.isprintable() else " " for c in text).split())
        if not text:
            return None
        if severity > _WORST_WARNING:
            self.informational += 1
            return None
        told_ns = self._told.pop(text, None)
        if told_ns is not None and time_ns - told_ns < _REPEAT_NS:
            self._told[text] = told_ns
            self.repeated += 1
            return None
        self._told[text] = time_ns
        if len(self._told) > _REMEMBERED:
            del self._told[next(iter(self._told))]
        return (Severity.ERROR if severity <= _WORST_ERROR else Severity.WARNING), text

    def state(self) -> dict[str, Any]:
        """Everything, as a tree for a snapshot."""
        return {
            "partials": [
                [component, chunk, p[0], p[1], [list(item) for item in p[2].items()]]
                for (component, chunk), p in self._partials.items()
            ],
            "told": [list(item) for item in self._told.items()],
            "repeated": self.repeated,
            "informational": self.informational,
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state()`` gave."""
        self._partials = {
            (component, chunk): [severity, begun_ns, dict(chunks)]
            for component, chunk, severity, begun_ns, chunks in tree["partials"]
        }
        self._told = dict(tree["told"])
        self.repeated = tree["repeated"]
        self.informational = tree["informational"]
