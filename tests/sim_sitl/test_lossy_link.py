"""A bad radio, repeatably bad."""

from __future__ import annotations

import pytest

from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.framing import Framer
from sim_sitl.lossy_link import MAX_QUEUED, LinkQuality, LossyLink

FRAME = bytes(range(40))


def test_a_perfect_link_passes_everything_at_once() -> None:
    link = LossyLink(LinkQuality(), 1)
    link.offer(1.0, FRAME)
    assert link.due(1.0) == [FRAME]
    assert link.due(9.0) == []


def test_loss_duplication_and_corruption_come_at_their_rates() -> None:
    link = LossyLink(LinkQuality(loss=0.2, duplication=0.1, corruption=0.3), 4)
    for _ in range(5000):
        link.offer(0.0, FRAME)
    arrived = link.due(0.0)
    assert link.lost == pytest.approx(1000, abs=100)
    assert len(arrived) == 5000 - link.lost + link.duplicated
    assert link.duplicated == pytest.approx(400, abs=70)
    assert link.corrupted == pytest.approx(1200, abs=110)
    assert all(sum(a != b for a, b in zip(frame, FRAME, strict=True)) <= 1 for frame in arrived)


def test_delay_and_jitter_keep_the_order() -> None:
    link = LossyLink(LinkQuality(delay_s=0.2, jitter_s=0.5), 2)
    for i in range(50):
        link.offer(i * 0.01, bytes([i]))
    assert link.due(0.19) == []
    arrived = []
    for step in range(200):
        arrived += link.due(step * 0.01)
    assert arrived == [bytes([i]) for i in range(50)]


def test_the_same_seed_loses_the_same_frames() -> None:
    def run(seed: int) -> list[bytes]:
        link = LossyLink(LinkQuality(loss=0.5), seed, 3, 0)
        for i in range(100):
            link.offer(0.0, bytes([i]))
        return link.due(0.0)

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_a_full_queue_drops_and_counts() -> None:
    link = LossyLink(LinkQuality(delay_s=1.0), 1)
    for _ in range(MAX_QUEUED + 5):
        link.offer(0.0, FRAME)
    assert link.overflowed == 5


def test_damaged_frames_fail_their_crc() -> None:
    encoder, framer = Encoder(1, 1), Framer()
    link = LossyLink(LinkQuality(corruption=1.0), 1)
    for i in range(50):
        link.offer(0.0, encoder.pack(dialect.MAVLink_timesync_message(7, i + 1)))
    assert framer.feed(b"".join(link.due(0.0))) == []
