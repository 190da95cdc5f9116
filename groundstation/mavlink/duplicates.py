"""The same frame over two radios must count once: a bounded memory of what has come already.

No clock decides: a frame is a duplicate when the same bytes are among the last ``HISTORY``
frames of their (system, component). A sender's sequence number comes round after 256 frames, so
its next frame with the same bytes is not in that memory. Senders exist that never count: from
these the same bytes twice on one link are two messages, and only a second link makes a duplicate.
"""

from __future__ import annotations

from collections import OrderedDict

HISTORY = 64
"""Frames remembered of each (system, component); well below the 256 of a sequence number's turn."""
MAX_SOURCES = 512
"""(system, component) pairs remembered; the one heard longest ago goes."""

_MAGIC_V2 = 0xFD


class _Source:
    __slots__ = ("counts", "last_sequence", "links")

    def __init__(self) -> None:
        self.links: OrderedDict[bytes, object] = OrderedDict()
        """Frame → the link it came by first, oldest first."""
        self.last_sequence = -1
        self.counts = False
        """Whether the newest frame's sequence number differed from that of the one before."""


class DuplicateFilter:
    """Remembers recent frames over all links of the station."""

    def __init__(self) -> None:
        self._sources: OrderedDict[int, _Source] = OrderedDict()
        """By (system, component), the one heard longest ago first."""
        self._newest = -1

    def is_duplicate(self, raw: bytes, link: object) -> bool:
        """Whether ``raw`` (a verified frame that came by ``link``) has come before; remembers it if not."""
        header = 4 if raw[0] == _MAGIC_V2 else 2
        key = raw[header + 1] << 8 | raw[header + 2]
        source = self._sources.get(key)
        if source is None:
            if len(self._sources) >= MAX_SOURCES:
                self._sources.popitem(last=False)
            source = self._sources[key] = _Source()
        links = source.links
        first_link = links.get(raw)
        if first_link is not None:
            return first_link is not link or source.counts
        if key != self._newest:
            self._sources.move_to_end(key)
            self._newest = key
        sequence = raw[header]
        source.counts = source.last_sequence not in (-1, sequence)
        source.last_sequence = sequence
        links[raw] = link
        if len(links) > HISTORY:
            links.popitem(last=False)
        return False
