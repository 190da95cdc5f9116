"""Any window → the network's input, or the reason why not."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from groundstation.channel import ChannelCapture, ChannelSettings
from groundstation.channel.capture import UnusableCaptureError
from groundstation.channel.preprocess import (
    FINE_TAPS,
    INPUT_BINS,
    INPUT_CHANNELS,
    LEAD_TAPS,
    leading_edges,
    network_input,
    network_inputs,
)

SETTINGS = ChannelSettings()
MakeCapture = Callable[..., ChannelCapture]


def test_peak_of_a_clear_first_path_is_aligned_and_one(make_capture: MakeCapture) -> None:
    for first_path in (0, 5, 30, 200):
        for told in (True, False):
            result = network_input(make_capture(first_path=first_path, told=told), SETTINGS)
            assert result.shape == (INPUT_CHANNELS, INPUT_BINS)
            assert result.dtype == np.float32
            assert np.argmax(result[0]) == LEAD_TAPS
            assert result[0, LEAD_TAPS] == 1
            assert result[1, LEAD_TAPS] == 1


def test_scale_does_not_matter(make_capture: MakeCapture) -> None:
    capture = make_capture()
    scaled = ChannelCapture(np.asarray(capture.magnitude) * 2.0**20, 1.0)
    np.testing.assert_array_equal(network_input(capture, SETTINGS), network_input(scaled, SETTINGS))


def test_a_window_equals_the_full_response_where_it_has_data(make_capture: MakeCapture) -> None:
    capture = make_capture(taps=512, first_path=100, told=True)
    magnitude = np.asarray(capture.magnitude)
    full = network_input(capture, SETTINGS)
    window = network_input(ChannelCapture(magnitude[92:156], 1.0, 8.0), SETTINGS)
    known = window[3] == 1
    assert known.sum() == 64
    np.testing.assert_allclose(window[1][known], full[1][known], atol=1e-6)
    assert np.all(window[:2, ~known] == 0)
    np.testing.assert_array_equal(window[2], full[2])


def test_tail_is_the_root_mean_square_of_its_taps() -> None:
    magnitude = np.full(1200, 1e-3)
    magnitude[40] = 1.0
    magnitude[40 + FINE_TAPS :] = 0.1
    result = network_input(ChannelCapture(magnitude, 1.0, 40.0), SETTINGS)
    np.testing.assert_allclose(result[1, LEAD_TAPS + FINE_TAPS :], 1 - 20 / 50, atol=1e-6)
    assert np.all(result[3] == 1)


def test_spacing_is_seen_as_time(make_capture: MakeCapture) -> None:
    narrow = network_input(make_capture(tap_spacing_ns=333.0), SETTINGS)
    wide = network_input(make_capture(tap_spacing_ns=1.0), SETTINGS)
    np.testing.assert_array_equal(narrow[[0, 1, 3]], wide[[0, 1, 3]])
    assert narrow[2, LEAD_TAPS + 1] == pytest.approx(np.log10(334) / 4)


def test_leading_edge_finds_a_weak_first_path_before_the_peak() -> None:
    rng = np.random.default_rng(0)
    magnitude = 0.01 * rng.rayleigh(size=300)
    magnitude[120] = 0.3
    magnitude[150] = 1.0
    assert leading_edges(magnitude[None], np.array([np.nan])) == [120]


def test_a_first_path_outside_the_window_is_not_believed(make_capture: MakeCapture) -> None:
    capture = make_capture()
    for told in (-5.0, 1e6, float("nan"), float("inf")):
        lied = ChannelCapture(capture.magnitude, 1.0, told)
        np.testing.assert_array_equal(network_input(lied, SETTINGS), network_input(capture, SETTINGS))


@pytest.mark.parametrize(
    ("magnitude", "spacing_ns", "reason"),
    [
        (np.ones(0), 1.0, "too short"),
        (np.arange(15.0), 1.0, "too short"),
        (np.zeros(64), 1.0, "constant"),
        (np.full(64, 7.0), 1.0, "constant"),
        (np.append(np.ones(63), np.nan), 1.0, "not finite"),
        (np.append(np.ones(63), np.inf), 1.0, "not finite"),
        (-np.arange(64.0), 1.0, "negative"),
        (np.ones((8, 8)), 1.0, "dimensions"),
        (["a"] * 64, 1.0, "not numbers"),
        (np.arange(64.0), 0.0, "tap spacing"),
        (np.arange(64.0), float("nan"), "tap spacing"),
    ],
)
def test_unusable_captures_say_why(magnitude: object, spacing_ns: float, reason: str) -> None:
    with pytest.raises(UnusableCaptureError, match=reason):
        network_input(ChannelCapture(magnitude, spacing_ns), SETTINGS)


def test_saturation_is_seen_and_a_quantised_peak_is_not(make_capture: MakeCapture) -> None:
    magnitude = np.asarray(make_capture(los=False).magnitude)
    with pytest.raises(UnusableCaptureError, match="saturated"):
        network_input(ChannelCapture(np.minimum(magnitude, 0.3 * magnitude.max()), 1.0), SETTINGS)
    # A pulse of 50 taps' width whose top is flat in steps of 0.25 dB.
    x = (np.arange(256) - 128) / 50
    pulse = np.abs(np.sinc(x)) + 1e-3
    steps = 10 ** (np.rint(20 * np.log10(pulse) / 0.25) * 0.25 / 20)
    assert np.count_nonzero(steps == steps.max()) >= 4
    network_input(ChannelCapture(steps, 1.0), SETTINGS)


@pytest.mark.parametrize("taps", [16, 64, 256, 1016])
def test_noise_alone_is_called_so(taps: int) -> None:
    """At most 2 % of noise-only windows pass; the marks are set for a tenth of that each."""
    rng = np.random.default_rng(taps)

    def reason() -> str:
        try:
            network_input(ChannelCapture(rng.rayleigh(size=taps), 1.0), SETTINGS)
        except UnusableCaptureError as error:
            return str(error)
        return "passed"

    reasons = Counter(reason() for _ in range(300))
    assert set(reasons) <= {"all noise: no path stands out", "passed"}
    assert reasons["passed"] <= 6


def test_clear_responses_are_not_called_noise(make_capture: MakeCapture) -> None:
    for seed in range(100):
        for taps, first_path in ((64, 8), (1016, 745)):
            for los in (True, False):
                network_input(make_capture(seed=seed, taps=taps, first_path=first_path, los=los), SETTINGS)


def test_a_told_first_path_is_a_hint_for_the_edge() -> None:
    rng = np.random.default_rng(2)
    magnitude = 0.01 * rng.rayleigh(size=300)
    magnitude[40] = 0.9
    magnitude[120] = 1.0
    edges = leading_edges(np.tile(magnitude, (3, 1)), np.array([np.nan, 118.3, 200.0]))
    assert edges.tolist() == [40, 120, 200]


def one_by_one(magnitude: np.ndarray, spacing_ns: float, told: float) -> np.ndarray:
    """The input as the module's header says it, bin by bin, without a thought for speed."""
    peak, low, taps = magnitude.max(), magnitude.min(), len(magnitude)
    sigma = np.quantile(magnitude, 0.25) / 0.7585
    above = magnitude >= min(max(4.5 * sigma, 0.15 * peak), 0.6 * peak)
    first = int(np.argmax(above))
    if np.isfinite(told) and 0 <= told <= taps - 1:
        near = [tap for tap in np.flatnonzero(above) if abs(tap - round(told)) <= 16]
        first = near[0] if near else round(told)
    edges = np.rint(np.geomspace(80, 1024, 33)).astype(int)
    bins = [(tap, tap + 1) for tap in range(-16, 80)] + list(itertools.pairwise(edges))
    result = np.zeros((4, 128))
    for place, (start, end) in enumerate(bins):
        time_ns = 0.5 * (start + end - 1) * spacing_ns
        result[2, place] = np.sign(time_ns) * np.log10(1 + abs(time_ns)) / 4
        inside = magnitude[max(first + start, 0) : max(first + end, 0)]
        if len(inside):
            level = np.sqrt(np.mean(inside**2)) if end - start > 1 else inside[0]
            result[0, place] = min(max((level - low) / (peak - low), 0), 1)
            result[1, place] = 1 + max(20 * np.log10(max(level / peak, 1e-9)), -50) / 50
            result[3, place] = 1
    return result


@pytest.mark.parametrize("taps", [16, 64, 65, 66, 67, 1016])
def test_together_is_as_one_by_one(make_capture: MakeCapture, taps: int) -> None:
    """All windows of a length in one call: what each gives by itself, and what the definition gives."""
    rng = np.random.default_rng(taps)
    first = rng.integers(0, taps // 2, 60)
    magnitude = np.array(
        [
            make_capture(seed=row, taps=taps, first_path=int(first[row]), los=row % 2 == 0).magnitude
            for row in range(60)
        ]
    )
    magnitude[::7] = rng.rayleigh(size=magnitude[::7].shape)
    magnitude[5] = 3.0
    magnitude[6] = np.minimum(magnitude[6], 0.1 * magnitude[6].max())
    spacing_ns = 10 ** rng.uniform(-1, 3, 60)
    spacing_ns[9] = -1.0
    told = np.where(rng.random(60) < 0.5, first + rng.normal(0, 9, 60), np.nan)
    told[3], told[4] = np.inf, taps
    inputs, reasons = network_inputs(magnitude, spacing_ns, told, SETTINGS)
    assert {reason.split(" ")[0] for reason in reasons} >= {"", "constant:", "saturated:", "tap"}
    assert sum(not reason for reason in reasons) > 30
    for row, reason in enumerate(reasons):
        capture = ChannelCapture(magnitude[row], spacing_ns[row], told[row])
        if reason:
            with pytest.raises(UnusableCaptureError) as raised:
                network_input(capture, SETTINGS)
            assert str(raised.value) == reason
            assert not inputs[row].any()
            continue
        np.testing.assert_array_equal(inputs[row], network_input(capture, SETTINGS))
        expected = one_by_one(magnitude[row], spacing_ns[row], told[row])
        np.testing.assert_allclose(inputs[row], expected, atol=1e-6)


def test_the_batch_of_an_unusable_length_says_so_of_each() -> None:
    inputs, reasons = network_inputs(np.ones((3, 4)), np.ones(3), np.full(3, np.nan), SETTINGS)
    assert inputs.shape == (3, INPUT_CHANNELS, INPUT_BINS)
    assert reasons == ["too short: 4 taps, 16 needed"] * 3
    assert network_inputs(np.ones((0, 64)), np.ones(0), np.ones(0), SETTINGS)[1] == []
