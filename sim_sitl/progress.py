"""Progress of long work: one line that is drawn anew on a terminal, plain lines elsewhere.

Rule: it only tells. Nothing that is computed depends on the clock read here.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TextIO

_TERMINAL_EVERY_S = 0.2
_LINES_EVERY_S = 5.0
_ESTIMATE_AFTER_S = 5.0


class Progress:
    """Call it with how much is done and how much there is."""

    def __init__(
        self, unit: str, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._unit = unit
        self._stream = sys.stderr if stream is None else stream
        self._terminal = self._stream.isatty()
        self._clock = clock
        self._began = self._next = clock()
        self._open = False

    def __call__(self, done: int, total: int) -> None:
        """Tell that ``done`` of ``total`` units are done."""
        now = self._clock()
        if now < self._next and done < total:
            return
        self._next = now + (_TERMINAL_EVERY_S if self._terminal else _LINES_EVERY_S)
        self._open = self._terminal and done < total
        self._stream.write(
            f"{chr(13) + chr(27) + '[K' if self._terminal else ''}{done} of {total} {self._unit}"
            f"{self._left(now, done, total)}{'' if self._open else chr(10)}"
        )
        self._stream.flush()

    def _left(self, now: float, done: int, total: int) -> str:
        if now - self._began < _ESTIMATE_AFTER_S or not 0 < done < total:
            return ""
        seconds = (now - self._began) * (total - done) / done
        return f", about {seconds:.0f} s left" if seconds < 90.0 else f", about {seconds / 60.0:.0f} min left"

    def end(self) -> None:
        """Leave the terminal's line, so that what is written next has its own."""
        if self._open:
            self._open = False
            self._stream.write("\n")
            self._stream.flush()
