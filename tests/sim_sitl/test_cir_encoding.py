"""SAR_CIR bytes, decoded here by hand from the interface's words."""

from __future__ import annotations

import numpy as np
import pytest

from sim_sitl.cir_encoding import CirEncoding, SarCirFields, encode_capture, window_round_first_path


def joined(fragments: list[SarCirFields]) -> bytes:
    data = bytearray(max(f["offset"] + f["length"] for f in fragments))
    for fragment in fragments:
        assert len(fragment["data"]) == 212
        data[fragment["offset"] : fragment["offset"] + fragment["length"]] = fragment["data"][
            : fragment["length"]
        ]
    return bytes(data)


def response(taps: int) -> np.ndarray:
    rng = np.random.default_rng(taps)
    return 3e-4 * (rng.standard_normal(taps) + 1j * rng.standard_normal(taps))


def test_full_response_is_five_frames_and_a_window_one() -> None:
    full = encode_capture(
        response(1016), encoding=CirEncoding.U8_LOG_MAGNITUDE, tap_spacing_ns=1.0, capture_id=70000
    )
    assert [f["length"] for f in full] == [212, 212, 212, 212, 168]
    assert [f["fragment"] for f in full] == [0, 1, 2, 3, 4]
    assert {(f["fragment_count"], f["tap_count"], f["capture_id"]) for f in full} == {
        (5, 1016, 70000 - 65536)
    }
    window = encode_capture(
        response(64), encoding=CirEncoding.U8_LOG_MAGNITUDE, tap_spacing_ns=1.0, capture_id=1
    )
    assert [f["length"] for f in window] == [64]


def test_fragments_fit_a_tunnel() -> None:
    fragments = encode_capture(
        response(1016), encoding=CirEncoding.I8_IQ, tap_spacing_ns=1.0, capture_id=1, max_data_bytes=86
    )
    assert max(f["length"] for f in fragments) == 86
    assert len(joined(fragments)) == 2 * 1016


def test_log_magnitude_is_within_half_a_step() -> None:
    given = response(300)
    fragments = encode_capture(given, encoding=CirEncoding.U8_LOG_MAGNITUDE, tap_spacing_ns=1.0, capture_id=1)
    counts = np.frombuffer(joined(fragments), np.uint8)
    below_peak_db = -20 * np.log10(np.abs(given) / np.abs(given).max())
    assert counts.min() == 0
    assert np.abs(counts * fragments[0]["scale"] - below_peak_db).max() <= 0.125 + 1e-9


def test_what_is_too_weak_is_255() -> None:
    given = np.array([1.0, 1e-6, 0.0])
    fragments = encode_capture(given, encoding=CirEncoding.U8_LOG_MAGNITUDE, tap_spacing_ns=1.0, capture_id=1)
    assert list(joined(fragments)) == [0, 255, 255]


def test_u16_and_iq_are_within_half_a_count() -> None:
    given = response(200)
    u16 = encode_capture(given, encoding=CirEncoding.U16_MAGNITUDE, tap_spacing_ns=1.0, capture_id=1)
    decoded = np.frombuffer(joined(u16), "<u2") * u16[0]["scale"]
    assert np.abs(decoded - np.abs(given)).max() <= 0.5001 * u16[0]["scale"]
    iq = encode_capture(given, encoding=CirEncoding.I8_IQ, tap_spacing_ns=1.0, capture_id=1)
    pairs = np.frombuffer(joined(iq), np.int8).reshape(-1, 2) * iq[0]["scale"]
    assert np.abs(pairs[:, 0] - given.real).max() <= 0.5001 * iq[0]["scale"]
    assert np.abs(pairs[:, 1] - given.imag).max() <= 0.5001 * iq[0]["scale"]


def test_unknown_first_path_is_nan_and_iq_needs_complex() -> None:
    fragments = encode_capture(
        response(64), encoding=CirEncoding.U16_MAGNITUDE, tap_spacing_ns=1.0, capture_id=1
    )
    assert np.isnan(fragments[0]["first_path_index"])
    with pytest.raises(ValueError, match="complex"):
        encode_capture(np.ones(64), encoding=CirEncoding.I8_IQ, tap_spacing_ns=1.0, capture_id=1)


def test_all_zero_capture_encodes() -> None:
    for encoding in CirEncoding:
        fragments = encode_capture(np.zeros(64, complex), encoding=encoding, tap_spacing_ns=1.0, capture_id=1)
        assert fragments[0]["scale"] > 0


@pytest.mark.parametrize(("first_path", "expected"), [(100.4, 92), (3.0, 0), (1010.0, 952)])
def test_window_stays_within_the_response(first_path: float, expected: int) -> None:
    assert window_round_first_path(1016, first_path) == (expected, 64)
