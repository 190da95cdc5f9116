"""Counters: bounded, merged without loss, named for Prometheus."""

from __future__ import annotations

from groundstation.mavlink.encode import Encoder, heartbeat
from groundstation.mavlink.framing import Framer
from groundstation.mavlink.statistics import MAX_SOURCES, LinkStatistics


def fed(system_id: int, missing: int) -> LinkStatistics:
    """Statistics of a stream with a gap."""
    encoder = Encoder(system_id, 1)
    frames = [encoder.pack(heartbeat()) for _ in range(10)]
    framer = Framer()
    framer.feed(b"\1\2\3" + b"".join(frames[:4] + frames[4 + missing :]))
    return framer.statistics


def test_merging_adds_up() -> None:
    total = LinkStatistics()
    for statistics in (fed(1, 2), fed(1, 1), fed(2, 0)):
        total.merge(statistics)
    assert {key: (s.received, s.lost) for key, s in total.sources.items()} == {
        (1, 1): (17, 3),
        (2, 1): (10, 0),
    }
    assert (total.total("received"), total.total("lost"), total.garbage_bytes) == (27, 3, 9)
    assert total.verified_frames == 27


def test_counters_are_named_and_labelled() -> None:
    counters = fed(7, 2).counters("udpin:0.0.0.0:1")
    assert all(
        counter.name.startswith("mavlink_") and counter.name.endswith("_total") for counter in counters
    )
    assert len({(counter.name, counter.labels) for counter in counters}) == len(counters)
    lost = next(counter for counter in counters if counter.name == "mavlink_frames_lost_total")
    assert lost.labels == (("connection", "udpin:0.0.0.0:1"), ("system", "7"), ("component", "1"))
    assert lost.value == 2


def test_sources_are_bounded() -> None:
    statistics = LinkStatistics()
    for key in range(MAX_SOURCES + 50):
        statistics.source(key >> 8, key & 0xFF).received += 1
    assert len(statistics.sources) == MAX_SOURCES
    assert statistics.total("received") == MAX_SOURCES + 50
    other = [counter for counter in statistics.counters("x") if ("system", "other") in counter.labels]
    assert sum(counter.value for counter in other) == 50


def test_a_restarted_counter_is_not_late_for_ever() -> None:
    statistics = LinkStatistics()
    source = statistics.source(1, 1)
    for sequence in [*range(100, 104), *range(6)]:
        source.take_sequence(sequence)
    assert source.last_sequence == 5
    assert source.out_of_order == 0
