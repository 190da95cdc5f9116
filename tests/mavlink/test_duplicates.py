"""Duplicates: the same frame over two radios counts once, and a sender that never counts is heard."""

from __future__ import annotations

from groundstation.mavlink.duplicates import HISTORY, MAX_SOURCES, DuplicateFilter
from groundstation.mavlink.encode import Encoder, heartbeat

FIRST, SECOND = "first", "second"


def beats(count: int, system_id: int = 1) -> list[bytes]:
    """Heartbeats of one sender."""
    encoder = Encoder(system_id, 1)
    return [encoder.pack(heartbeat()) for _ in range(count)]


def test_a_second_link_makes_a_duplicate_whatever_lies_between() -> None:
    known = DuplicateFilter()
    frames = beats(HISTORY)
    assert not any(known.is_duplicate(raw, FIRST) for raw in frames)
    assert all(known.is_duplicate(raw, SECOND) for raw in frames)
    assert all(known.is_duplicate(raw, FIRST) for raw in frames)


def test_memory_ends_before_sequence_numbers_come_round() -> None:
    known = DuplicateFilter()
    frames = beats(257)
    assert frames[256] == frames[0]
    assert not any(known.is_duplicate(raw, FIRST) for raw in frames)


def test_a_sender_that_never_counts_repeats_itself() -> None:
    known = DuplicateFilter()
    (raw,) = beats(1)
    assert not any(known.is_duplicate(raw, FIRST) for _ in range(5))
    assert known.is_duplicate(raw, SECOND)
    assert not known.is_duplicate(raw, FIRST)


def test_sources_are_bounded_and_apart() -> None:
    known = DuplicateFilter()
    raws = [beats(1, system_id=system)[0] for system in range(1, 256)]
    assert not any(known.is_duplicate(raw, FIRST) for raw in raws)
    encoders = [Encoder(system, component) for system in range(1, 3) for component in range(2, 250)]
    for encoder in encoders * 2:
        known.is_duplicate(encoder.pack(heartbeat()), FIRST)
    assert len(known._sources) == MAX_SOURCES
