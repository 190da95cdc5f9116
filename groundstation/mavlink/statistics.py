"""What happened to the frames of one link, per (system, component): each loss has a counter.

Sequence numbers are eight bits, so at most 255 frames in a row can be missed and noticed. A
frame that comes up to ``LATE_WINDOW`` behind the newest is late, not a gap of 250.
"""

from __future__ import annotations

from groundstation.domain.events import Counter

LATE_WINDOW = 8
"""Sequence numbers behind the newest that count as arrived out of order."""
MAX_SOURCES = 1024
"""(system, component) pairs counted one by one on a link; further ones share one entry."""


class SourceStatistics:
    """Running totals of one (system, component) on one link."""

    __slots__ = ("crc_failures", "duplicates", "last_sequence", "lost", "out_of_order", "received", "unknown")

    def __init__(self) -> None:
        self.received = 0
        """Verified frames handed on."""
        self.lost = 0
        """Frames missing by the gaps between sequence numbers, less those that came late."""
        self.out_of_order = 0
        self.crc_failures = 0
        """Whole frames whose CRC was wrong, by what their header says."""
        self.duplicates = 0
        """Verified frames dropped because the same bytes had come already."""
        self.unknown = 0
        """Frames of ids that the dialect lacks: passed on raw, never decoded."""
        self.last_sequence: int | None = None

    def take_sequence(self, sequence: int) -> None:
        """Counts what is missing before a frame with ``sequence``."""
        last = self.last_sequence
        if last is not None:
            missing = (sequence - last - 1) & 0xFF
            if missing >= 256 - LATE_WINDOW and missing != 0xFF:
                self.out_of_order += 1
                self.lost = max(0, self.lost - 1)
                return
            # The same number twice is a sender that does not count, not 255 lost frames.
            if missing != 0xFF:
                self.lost += missing
        self.last_sequence = sequence


class LinkStatistics:
    """Running totals of one link."""

    def __init__(self) -> None:
        self.received_bytes = 0
        self.verified_frames = 0
        """Frames with a good CRC, duplicates among them."""
        self.garbage_bytes = 0
        """Bytes that belong to no verified or unverified frame."""
        self.crc_failures_unattributed = 0
        """CRC failures whose header names nobody heard before."""
        self.unknown_unattributed = 0
        """Frames of unknown ids whose header names nobody heard before."""
        self.unverified_dropped = 0
        """Unverified frames thrown away because nobody fetched them."""
        self._sources: dict[int, SourceStatistics] = {}
        self._others = SourceStatistics()

    @property
    def sources(self) -> dict[tuple[int, int], SourceStatistics]:
        """By (system, component), in order of ids."""
        return {(key >> 8, key & 0xFF): self._sources[key] for key in sorted(self._sources)}

    def known(self, system_id: int, component_id: int) -> SourceStatistics | None:
        """Totals of a source that has sent a verified frame; None for a stranger."""
        return self._sources.get(system_id << 8 | component_id)

    def source(self, system_id: int, component_id: int) -> SourceStatistics:
        """Totals of a source, begun if need be. Only for ids from verified frames."""
        key = system_id << 8 | component_id
        source = self._sources.get(key)
        if source is None:
            if len(self._sources) >= MAX_SOURCES:
                return self._others
            source = self._sources[key] = SourceStatistics()
        return source

    def total(self, name: str) -> int:
        """Sum of one counter (an attribute of SourceStatistics) over all sources."""
        return sum(int(getattr(source, name)) for source in [*self._sources.values(), self._others])

    def counters(self, connection: str) -> list[Counter]:
        """All totals, labelled with ``connection`` and the source."""
        link = (("connection", connection),)
        counters = [
            Counter("mavlink_received_bytes_total", link, self.received_bytes),
            Counter("mavlink_verified_frames_total", link, self.verified_frames),
            Counter("mavlink_garbage_bytes_total", link, self.garbage_bytes),
            Counter("mavlink_unverified_dropped_total", link, self.unverified_dropped),
            Counter("mavlink_crc_failures_unattributed_total", link, self.crc_failures_unattributed),
            Counter("mavlink_unknown_unattributed_total", link, self.unknown_unattributed),
        ]
        labelled = [
            ((str(system), str(component)), source) for (system, component), source in self.sources.items()
        ]
        if len(self._sources) >= MAX_SOURCES:
            labelled.append((("other", "other"), self._others))
        for (system, component), source in labelled:
            labels = (*link, ("system", system), ("component", component))
            counters += [
                Counter("mavlink_frames_received_total", labels, source.received),
                Counter("mavlink_frames_lost_total", labels, source.lost),
                Counter("mavlink_frames_out_of_order_total", labels, source.out_of_order),
                Counter("mavlink_crc_failures_total", labels, source.crc_failures),
                Counter("mavlink_duplicates_total", labels, source.duplicates),
                Counter("mavlink_unknown_total", labels, source.unknown),
            ]
        return counters

    def merge(self, other: LinkStatistics) -> None:
        """Adds another link's totals: the peers of one UDP socket make one connection."""
        self.received_bytes += other.received_bytes
        self.verified_frames += other.verified_frames
        self.garbage_bytes += other.garbage_bytes
        self.crc_failures_unattributed += other.crc_failures_unattributed
        self.unknown_unattributed += other.unknown_unattributed
        self.unverified_dropped += other.unverified_dropped
        for key, theirs in [*other._sources.items(), (None, other._others)]:
            ours = self._others if key is None else self.source(key >> 8, key & 0xFF)
            for name in ("received", "lost", "out_of_order", "crc_failures", "duplicates", "unknown"):
                setattr(ours, name, getattr(ours, name) + getattr(theirs, name))
