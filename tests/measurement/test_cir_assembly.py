"""Captures against bytes worked out by hand, and against every way a radio mistreats them."""

import dataclasses
import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.domain.radio import CirCapture
from groundstation.mavlink.messages import CirFragment
from groundstation.measurement.cir_assembly import CirAssembler, CirOutcome, decode_taps
from groundstation.measurement.settings import MeasurementSettings

S = 1_000_000_000


def fragments(
    data=bytes(range(250)) * 2, *, size=212, beacon=7, capture_id=3, time_usec=5_000_000, **changes
):
    """A capture of one byte a tap cut as a sensor cuts it."""
    count = -(-len(data) // size)
    made = []
    for index in range(count):
        fields = {
            "time_usec": time_usec,
            "beacon_id": beacon,
            "tap_spacing_ns": 1.0,
            "scale": 0.5,
            "first_path_index": 12.5,
            "capture_id": capture_id,
            "first_tap": 700,
            "tap_count": len(data),
            "offset": index * size,
            "fragment": index,
            "fragment_count": count,
            "encoding": 0,
            "data": data[index * size : (index + 1) * size],
        } | changes
        made.append(CirFragment(**fields))
    return made


def feed(assembler, parts, now=S):
    return [assembler.add(part, 111, now) for part in parts]


def test_log_magnitude_by_hand():
    """Scale 0.5 dB: 0 → 1, 12 → 6 dB down, 40 → 20 dB down, 255 → 127.5 dB down."""
    taps = decode_taps(bytes([0, 12, 40, 255]), 0, 0.5, 4)
    np.testing.assert_allclose(taps, [1.0, 10 ** (-6 / 20), 0.1, 10 ** (-127.5 / 20)], rtol=1e-6)
    assert taps.dtype == np.float32


def test_u16_little_endian_by_hand():
    taps = decode_taps(bytes([0x01, 0x00, 0x00, 0x01, 0xFF, 0xFF]), 1, 0.25, 3)
    np.testing.assert_allclose(taps, [0.25, 64.0, 65535 * 0.25])


def test_iq_by_hand():
    taps = decode_taps(struct.pack("<6b", 3, 4, -128, 0, 5, -12), 2, 2.0, 3)
    np.testing.assert_allclose(taps, [10.0, 256.0, 26.0])


@pytest.mark.parametrize(
    ("data", "encoding", "taps"), [(b"\0" * 5, 0, 4), (b"\0" * 5, 1, 3), (b"\0" * 4, 9, 4)]
)
def test_bytes_that_are_not_those_taps(data, encoding, taps):
    with pytest.raises(ValueError, match=r"taps|Encoding"):
        decode_taps(data, encoding, 1.0, taps)


@given(order=st.permutations(range(5)), again=st.lists(st.integers(0, 4), max_size=5))
def test_any_order_and_repetition_gives_the_same_capture(order, again):
    data = bytes((i * 7) % 256 for i in range(1016))
    parts = fragments(data)
    assembler = CirAssembler(MeasurementSettings())
    arriving = [*order[:-1], *[a for a in again if a != order[-1]], order[-1], *again]
    answers = [assembler.add(parts[index], 111, S) for index in arriving]
    captures = [a for a in answers if isinstance(a, CirCapture)]
    assert len(captures) == 1
    np.testing.assert_array_equal(captures[0].magnitude, decode_taps(data, 0, 0.5, 1016))
    assert captures[0].time_ns == 111
    assert captures[0].first_path_index == 12.5
    assert captures[0].first_tap == 700
    assert all(a in {None, CirOutcome.DUPLICATE} or isinstance(a, CirCapture) for a in answers)
    assert assembler.state()["partials"] == []


@pytest.mark.parametrize(
    "changes",
    [
        {"encoding": 3},
        {"scale": math.nan},
        {"scale": 0.0},
        {"tap_spacing_ns": math.inf},
        {"tap_spacing_ns": -1.0},
        {"tap_count": 0},
        {"fragment_count": 0},
        {"fragment": 9},
        {"data": b""},
        {"offset": 400},
    ],
)
def test_metadata_that_cannot_be_is_refused(settings, changes):
    part = dataclasses.replace(fragments(b"\1" * 64)[0], **changes)
    assert CirAssembler(settings).add(part, 0, S) is CirOutcome.BAD_METADATA


def test_an_unknown_or_impossible_first_path_is_unknown(settings):
    for value in (None, math.nan, -3.0, 64.0):
        found = CirAssembler(settings).add(fragments(b"\1" * 64, first_path_index=value)[0], 0, S)
        assert isinstance(found, CirCapture)
        assert found.first_path_index is None


def test_a_contradicting_fragment_is_refused_and_the_capture_survives(settings):
    assembler = CirAssembler(settings)
    first, second, third = fragments()
    assert assembler.add(first, 0, S) is None
    liar = fragments(bytes(500))[0]
    assert assembler.add(liar, 0, S) is CirOutcome.MISMATCH
    assert assembler.add(fragments(scale=0.25)[1], 0, S) is CirOutcome.MISMATCH
    assert assembler.add(second, 0, S) is None
    assert isinstance(assembler.add(third, 0, S), CirCapture)


def test_a_reused_capture_id_lets_the_newer_capture_win(settings):
    assembler = CirAssembler(settings)
    feed(assembler, fragments()[:2])
    answers = feed(assembler, fragments(time_usec=9_000_000))
    assert isinstance(answers[-1], CirCapture)
    assert assembler.given_up == [7]


def test_fragments_that_overlap_or_leave_a_hole_are_no_capture(settings):
    parts = fragments(b"\1" * 300, size=150)
    overlap = dataclasses.replace(parts[1], offset=100)
    assert feed(CirAssembler(settings), [parts[0], overlap])[-1] is CirOutcome.BAD_LAYOUT
    short = dataclasses.replace(parts[1], data=b"\1" * 90)
    assert feed(CirAssembler(settings), [parts[0], short])[-1] is CirOutcome.BAD_LAYOUT


def test_silence_is_no_response(settings):
    part = fragments(bytes(128), encoding=1, tap_count=64)[0]
    assert CirAssembler(settings).add(part, 0, S) is CirOutcome.EMPTY


def test_an_incomplete_capture_times_out_once_and_its_late_rest_is_known(settings):
    assembler = CirAssembler(settings)
    parts = fragments()
    feed(assembler, parts[:2], now=10 * S)
    assembler.tick(10 * S + int(settings.cir_timeout_s * S) - 1)
    assert assembler.given_up == []
    assembler.tick(10 * S + int(settings.cir_timeout_s * S))
    assert assembler.given_up == [7]
    assert assembler.add(parts[2], 0, 14 * S) is CirOutcome.DUPLICATE


def test_captures_in_flight_are_bounded_and_the_oldest_goes():
    assembler = CirAssembler(MeasurementSettings(cir_in_flight=4))
    for beacon in range(10):
        assembler.add(fragments(beacon=beacon)[0], 0, S)
    assert assembler.given_up == [0, 1, 2, 3, 4, 5]
    assert len(assembler.state()["partials"]) == 4


def test_interleaved_captures_of_two_beacons(settings):
    assembler = CirAssembler(settings)
    mixed = [p for pair in zip(fragments(beacon=1), fragments(beacon=2), strict=True) for p in pair]
    answers = feed(assembler, mixed)
    assert [type(a) for a in answers[-2:]] == [CirCapture, CirCapture]


def test_state_and_restore_finish_the_capture(settings):
    first, *rest = fragments()
    one, two = CirAssembler(settings), CirAssembler(settings)
    one.add(first, 5, S)
    two.restore(one.state())
    a, b = feed(one, rest)[-1], feed(two, rest)[-1]
    assert isinstance(a, CirCapture)
    assert isinstance(b, CirCapture)
    np.testing.assert_array_equal(a.magnitude, b.magnitude)
    assert a.time_ns == b.time_ns == 5


def test_clear_says_how_many_were_lost(settings):
    assembler = CirAssembler(settings)
    assembler.add(fragments()[0], 0, S)
    assert assembler.clear() == 1
    assert assembler.clear() == 0
