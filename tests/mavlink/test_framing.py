"""Framing: the same frames however the stream is cut, none lost to what surrounds them."""

from __future__ import annotations

import itertools
import struct

import pytest
from fastcrc import crc16
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.domain.errors import PeerError
from groundstation.mavlink.catalogue import CATALOGUE
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.duplicates import DuplicateFilter
from groundstation.mavlink.encode import Encoder, command_long, heartbeat
from groundstation.mavlink.framing import Framer, frame_of

UNKNOWN_ID = 19_999


def v1_frame(message_id: int, payload: bytes, sequence: int, system_id: int = 1) -> bytes:
    """A MAVLink 1 frame, put together by hand."""
    body = bytes((0xFE, len(payload), sequence, system_id, 1, message_id)) + payload
    crc = crc16.mcrf4xx(body[1:] + bytes((CATALOGUE[message_id].crc_extra,)))
    return body + struct.pack("<H", crc)


def unknown_frame(sequence: int, payload: bytes = b"\x01\x02\x03", system_id: int = 1) -> bytes:
    """A MAVLink 2 frame of an id that no dialect of ours has."""
    body = struct.pack("<BBBBBBBHB", 0xFD, len(payload), 0, 0, sequence, system_id, 1, UNKNOWN_ID, 0)
    return body + payload + b"\x12\x34"


def signed(raw: bytes) -> bytes:
    """``raw`` as a signed frame (of a signature that nobody can verify)."""
    body = bytearray(raw[:-2])
    body[2] |= 1
    extra = CATALOGUE[body[7] | body[8] << 8 | body[9] << 16].crc_extra
    return (
        bytes(body) + struct.pack("<H", crc16.mcrf4xx(bytes(body[1:]) + bytes((extra,)))) + bytes(range(13))
    )


def mixed_frames() -> list[bytes]:
    """Frames of all sorts, each different."""
    first, second = Encoder(1, 1), Encoder(2, 191)
    data = [0xFD, 0xFE] * 40 + [7] * 132
    return [
        first.pack(heartbeat()),
        v1_frame(0, struct.pack("<IBBBBB", 4, 2, 3, 81, 4, 3), 9, system_id=3),
        second.pack(dialect.MAVLink_sar_cir_message(1, 2, 1.0, 0.5, 3.0, 1, 0, 212, 0, 0, 1, 0, 212, data)),
        signed(first.pack(command_long(1, 1, 400, (1.0,)))),
        first.pack(dialect.MAVLink_ekf_status_report_message(0x33F, 0.1, 0.1, 0.1, 0.1, 0.0, 0.0)),
        v1_frame(30, struct.pack("<Iffffff", 5, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0), 10, system_id=3),
        second.pack(dialect.MAVLink_sar_rss_message(1, 2**64 - 1, 868_000_000, -9000, -12_000, 77)),
    ]


def feed_in_cuts(framer: Framer, stream: bytes, cuts: list[int]) -> list[bytes]:
    """Frames of ``stream`` cut at ``cuts``."""
    edges = [0, *sorted(cut % (len(stream) + 1) for cut in cuts), len(stream)]
    return [frame.raw for begin, end in itertools.pairwise(edges) for frame in framer.feed(stream[begin:end])]


def outcome(framer: Framer) -> tuple[object, ...]:
    """All counters."""
    return tuple((counter.name, counter.labels, counter.value) for counter in framer.statistics.counters("x"))


def test_whole_frames_carry_their_headers() -> None:
    frames = Framer().feed(b"".join(mixed_frames()))
    assert [frame.raw for frame in frames] == mixed_frames()
    assert [(f.system_id, f.component_id, f.message_id, f.sequence, f.signed) for f in frames] == [
        (1, 1, 0, 0, False),
        (3, 1, 0, 9, False),
        (2, 191, 20802, 0, False),
        (1, 1, 76, 1, True),
        (1, 1, 193, 2, False),
        (3, 1, 30, 10, False),
        (2, 191, 20800, 1, False),
    ]
    assert all(frame_of(frame.raw) == frame for frame in frames)


@settings(max_examples=100)
@given(cuts=st.lists(st.integers(0, 10_000), max_size=40))
def test_any_chunking_gives_the_same_frames(cuts: list[int]) -> None:
    stream = (
        b"\xfd\x00garbage\xfe\x09" + b"".join(mixed_frames()) + unknown_frame(5) + b"".join(mixed_frames())
    )
    whole, cut = Framer(), Framer()
    expected = [frame.raw for frame in whole.feed(stream)]
    assert expected == mixed_frames() * 2
    assert feed_in_cuts(cut, stream, cuts) == expected
    assert cut.take_unverified() == whole.take_unverified() == [unknown_frame(5)]
    assert outcome(cut) == outcome(whole)


@settings(max_examples=200)
@given(
    pieces=st.lists(
        st.one_of(
            st.integers(0, 6),
            st.binary(max_size=40),
            st.lists(st.sampled_from([0xFD, 0xFE, 0, 1, 255]), max_size=60).map(bytes),
        ),
        max_size=12,
    ),
    cuts=st.lists(st.integers(0, 10_000), max_size=20),
)
def test_good_frames_survive_garbage_between_them(pieces: list[int | bytes], cuts: list[int]) -> None:
    frames = mixed_frames()
    expected = [frames[piece] for piece in pieces if isinstance(piece, int)]
    stream = b"".join(frames[piece] if isinstance(piece, int) else piece for piece in pieces)
    # A false beginning may hold back what follows until it has been disproved.
    stream += b"\0" * 2 * 280  # twice the longest frame
    framer, whole = Framer(), Framer()
    assert feed_in_cuts(framer, stream, cuts) == expected
    whole.feed(stream)
    assert outcome(framer) == outcome(whole)
    passed_on = sum(len(raw) for raw in expected) + sum(len(raw) for raw in framer.take_unverified())
    assert framer.statistics.garbage_bytes + framer.pending_bytes + passed_on == len(stream)


def test_one_byte_at_a_time() -> None:
    framer = Framer()
    stream = b"".join(mixed_frames())
    found = [frame.raw for at in range(len(stream)) for frame in framer.feed(stream[at : at + 1])]
    assert found == mixed_frames()
    assert framer.pending_bytes == 0
    assert framer.statistics.garbage_bytes == 0


@pytest.mark.parametrize("at", range(21))
def test_a_flipped_byte_costs_one_frame_and_no_other(at: int) -> None:
    encoder = Encoder(1, 1)
    frames = [encoder.pack(heartbeat()) for _ in range(20)]
    damaged = bytearray(frames[3])
    damaged[at] ^= 0x55
    framer = Framer()
    found = framer.feed(b"".join([*frames[:3], bytes(damaged), *frames[4:]]))
    assert [frame.raw for frame in found] == frames[:3] + frames[4:]
    source = framer.statistics.sources[(1, 1)]
    # A damaged message id makes it one of an unknown id, which cannot be told from a real one.
    assert source.received == 19
    assert source.lost + source.unknown == 1
    kept = sum(len(raw) for raw in framer.take_unverified())
    assert framer.statistics.garbage_bytes + kept == len(damaged)
    assert source.unknown == (1 if at in (8, 9) else 0)


def test_a_crc_failure_is_counted_where_the_header_says() -> None:
    encoder = Encoder(1, 1)
    good, bad = encoder.pack(heartbeat()), bytearray(encoder.pack(heartbeat()))
    bad[12] ^= 1
    framer = Framer()
    framer.feed(bytes(bad))
    assert framer.statistics.crc_failures_unattributed == 1
    framer.feed(good + bytes(bad))
    assert framer.statistics.sources[(1, 1)].crc_failures == 1
    assert list(framer.statistics.sources) == [(1, 1)]


def test_a_good_frame_inside_a_broken_one_is_found() -> None:
    inner = Encoder(7, 1).pack(heartbeat())
    cir = bytearray(mixed_frames()[2])
    cir[60 : 60 + len(inner)] = inner
    assert [frame.raw for frame in Framer().feed(bytes(cir) + bytes(300))] == [inner]


def test_unknown_ids_are_kept_apart_and_learn_nothing() -> None:
    encoder = Encoder(1, 1)
    known = [encoder.pack(heartbeat()) for _ in range(3)]
    framer = Framer()
    found = framer.feed(known[0] + unknown_frame(1) + unknown_frame(7, system_id=99) + known[2])
    assert [frame.raw for frame in found] == [known[0], known[2]]
    assert framer.take_unverified() == [unknown_frame(1), unknown_frame(7, system_id=99)]
    assert framer.take_unverified() == []
    source = framer.statistics.sources[(1, 1)]
    # Its sequence number is taken into account: nothing is missing between 0 and 2.
    assert (source.unknown, source.lost) == (1, 0)
    assert framer.statistics.unknown_unattributed == 1
    assert (99, 1) not in framer.statistics.sources
    assert framer.statistics.garbage_bytes == 0


def test_unfetched_unknown_frames_are_bounded() -> None:
    framer = Framer()
    framer.feed(b"".join(unknown_frame(n % 256) for n in range(101)) + b"\xfd")
    assert len(framer.take_unverified()) == 64
    assert framer.statistics.unverified_dropped == 37


def test_undefined_incompatibility_flags_are_no_frame() -> None:
    raw = bytearray(mixed_frames()[0])
    raw[2] = 0x02
    framer = Framer()
    assert framer.feed(bytes(raw) + bytes(300)) == []
    assert framer.statistics.garbage_bytes > 0


def test_sequence_gaps_lateness_and_repeats() -> None:
    encoder = Encoder(1, 1)
    frames = [encoder.pack(heartbeat()) for _ in range(300)]
    framer = Framer()
    framer.feed(b"".join(frames[:10] + frames[13:256] + frames[256:257]))
    source = framer.statistics.sources[(1, 1)]
    assert (source.received, source.lost, source.out_of_order) == (254, 3, 0)
    framer.feed(frames[258] + frames[257] + frames[259])
    assert (source.lost, source.out_of_order) == (3, 1)
    # A sender that does not count is not 255 losses a frame.
    framer.feed(frames[259] * 3)
    assert source.lost == 3


def test_duplicates_are_dropped_on_the_second_link_and_counted() -> None:
    shared = DuplicateFilter()
    one, two = Framer(shared), Framer(shared)
    stream = b"".join(mixed_frames())
    assert len(one.feed(stream)) == 7
    assert two.feed(stream) == []
    assert two.statistics.total("duplicates") == 7
    assert two.statistics.verified_frames == 7
    assert one.statistics.total("duplicates") == 0


def test_recording_has_no_bad_byte(recorded_frames: list[bytes]) -> None:
    framer = Framer(DuplicateFilter())
    stream = b"".join(recorded_frames)
    found = [f.raw for at in range(0, len(stream), 4096) for f in framer.feed(stream[at : at + 4096])]
    assert found == recorded_frames
    assert framer.statistics.garbage_bytes == 0
    assert framer.statistics.total("lost") == framer.statistics.total("duplicates") == 0
    assert list(framer.statistics.sources) == [(1, 1), (2, 1), (3, 1), (4, 1), (255, 190)]


@pytest.mark.parametrize("raw", [b"", b"\xfd", b"hello, I am no frame", mixed_frames()[0][:-1]])
def test_frame_of_refuses_what_is_none(raw: bytes) -> None:
    with pytest.raises(PeerError, match="not one whole MAVLink frame"):
        frame_of(raw)
