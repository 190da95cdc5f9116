"""The lower envelope against networks that delay, clocks that drift, senders that restart."""

import random

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from groundstation.measurement.settings import MeasurementSettings
from groundstation.measurement.vehicle_clock import UNIX_FROM_USEC, WRAP_MS, OffsetMap, SenderClock, StepKind

S = 1_000_000_000
MS = 1_000_000
START = 1_795_308_514 * S


def feed(
    clock: OffsetMap, seconds: float, *, start_s: float = 0.0, offset_ns: int = START, rate_hz: int = 10
):
    """Regular messages over a network of 5 ms; returns nothing but leaves the map settled."""
    for i in range(int(seconds * rate_hz)):
        sent = int((start_s + i / rate_hz) * S)
        clock.observe(sent, sent + offset_ns + 5 * MS)


@given(
    offset_h=st.integers(-20_000, 20_000),
    skew=st.floats(-1e-4, 1e-4),
    jitter_ms=st.floats(0.0, 400.0),
    seed=st.integers(0, 2**32 - 1),
)
@hypothesis_settings(max_examples=40, deadline=None)
def test_two_clocks_hours_apart_and_drifting_stay_within_milliseconds(offset_h, skew, jitter_ms, seed):
    """The mapped time is late by the fastest message's delay, and by what the drift does in the window."""
    rng = random.Random(seed)
    settings = MeasurementSettings()
    clock = OffsetMap(settings)
    floor_ns = 20 * MS
    drift_ns = abs(skew) * settings.clock_window_s * S
    for i in range(800):
        true_ns = START + i * 100 * MS
        sender_ns = int((true_ns - START) * (1.0 + skew)) + offset_h * 3600 * S
        # At least every tenth message is a fast one, as on a radio that is not choked.
        delay_ns = floor_ns + (0 if i % 10 == 0 else int(rng.random() * jitter_ms * MS))
        mapped_ns = clock.observe(sender_ns, true_ns + delay_ns)
        if i >= 10:
            assert mapped_ns is not None
            error_ns = mapped_ns - true_ns
            # Lagging at most by the window's drift (and its last bucket's).
            assert -drift_ns - MS <= error_ns - floor_ns <= drift_ns + MS
    assert clock.strays == 0


@given(delays=st.lists(st.integers(0, 900), min_size=1, max_size=200))
def test_a_mapped_time_is_never_later_than_its_arrival(delays):
    clock = OffsetMap(MeasurementSettings())
    for i, delay_ms in enumerate(delays):
        sent = i * 100 * MS
        mapped = clock.observe(sent, START + sent + delay_ms * MS)
        assert mapped is not None
        assert mapped <= START + sent + delay_ms * MS


def test_a_reboot_is_confirmed_by_agreeing_messages_and_named(settings):
    clock = OffsetMap(settings)
    feed(clock, 60.0)
    reboot_at = START + 70 * S
    answers = []
    for i in range(5):
        sent = S + i * 100 * MS
        answers.append(clock.observe(sent, reboot_at + i * 100 * MS))
        if clock.step is not None:
            break
    assert answers[:2] == [None, None]
    assert clock.step is not None
    assert clock.step.kind is StepKind.REBOOT
    assert clock.step.change_ns == reboot_at - S - (START + 5 * MS)
    assert clock.observe(2 * S, reboot_at + S) == reboot_at + S
    assert clock.step is None


def test_one_corrupt_time_neither_moves_the_map_nor_resets_it(settings):
    clock = OffsetMap(settings)
    feed(clock, 10.0)
    before = clock.offset_ns
    assert clock.observe(10_000 * S, START + 10 * S) is None
    assert clock.observe(10 * S, START + 10 * S + 5 * MS) == START + 10 * S + 5 * MS
    assert clock.offset_ns == before
    assert clock.strays == 1


def test_a_burst_of_old_messages_is_no_reboot(settings):
    """A sensor that empties its buffer after an outage sends old times all at once."""
    clock = OffsetMap(settings)
    feed(clock, 60.0)
    for i in range(100):
        clock.observe((20 + i // 10) * S, START + 61 * S + i * MS)
        assert clock.step is None
    assert clock.observe(62 * S, START + 62 * S + 5 * MS) == START + 62 * S + 5 * MS


def test_a_clock_set_forward_is_followed(settings):
    clock = OffsetMap(settings)
    feed(clock, 10.0)
    feed(clock, 1.0, start_s=7210.0, offset_ns=START - 7200 * S)
    assert clock.offset_ns == START - 7200 * S + 5 * MS


def test_a_pause_of_the_sender_is_a_stall_not_a_reboot(settings):
    clock = OffsetMap(settings)
    feed(clock, 30.0)
    kinds = []
    for i in range(10):
        sent = 30 * S + i * 100 * MS
        clock.observe(sent, START + sent + 20 * S)
        if clock.step:
            kinds.append(clock.step.kind)
    assert kinds == [StepKind.STALL]


def test_two_senders_with_one_id_never_confirm_but_are_noticed(settings):
    clock = OffsetMap(settings)
    for i in range(200):
        now = START + i * 50 * MS
        clock.observe(i * 50 * MS, now)
        clock.observe(i * 50 * MS + 900 * S, now + MS)
        assert clock.step is None
    assert clock.strays >= 190


def test_boot_milliseconds_wrap_after_49_days(settings):
    clock = SenderClock(settings)
    for i in range(80):
        boot_ms = (WRAP_MS - 5_000 + i * 100) % WRAP_MS
        mapped = clock.observe_boot_ms(boot_ms, START + i * 100 * MS)
        assert mapped == START + i * 100 * MS
        assert clock.boot.step is None
    # One from before the wrap, overtaken on its way, still finds its place.
    late = clock.observe_boot_ms(WRAP_MS - 10, START + 80 * 100 * MS)
    assert late == START + 4_990 * MS


def test_a_reboot_is_not_taken_for_a_wrap(settings):
    clock = SenderClock(settings)
    for i in range(50):
        clock.observe_boot_ms(3_600_000 + i * 100, START + i * 100 * MS)
    kinds = []
    for i in range(10):
        clock.observe_boot_ms(500 + i * 100, START + 20 * S + i * 100 * MS)
        if clock.boot.step:
            kinds.append(clock.boot.step.kind)
    assert kinds == [StepKind.REBOOT]
    assert clock.boot_ns(2000) == 2000 * MS


def test_unix_and_boot_times_of_one_sender_are_mapped_apart(settings):
    clock = SenderClock(settings)
    wrong_us = UNIX_FROM_USEC + 7_000_000_000_000
    for i in range(20):
        now = START + i * 100 * MS
        assert clock.observe_usec(100_000_000 + i * 100_000, now) == now
        assert clock.observe_usec(wrong_us + i * 100_000, now) == now
    boot, unix = clock.map_of_usec(100_000_000), clock.map_of_usec(wrong_us)
    assert (boot.offset_ns, unix.offset_ns) == (START - 100 * S, START - wrong_us * 1000)


def test_no_map_before_the_first_message(settings):
    assert SenderClock(settings).map_of_usec(123).offset_ns is None


def test_timesync_bounds_the_uncertainty_but_does_not_move_the_map(settings):
    clock = OffsetMap(settings)
    feed(clock, 10.0)
    offset = clock.offset_ns
    assert clock.uncertainty_ns() >= settings.clock_min_delay_s * 1e9
    # Asked at station time START + 9.98 s, read by the vehicle at 10 s, back after 25 ms.
    assert clock.timesync(10 * S, START + 10 * S - 20 * MS, START + 10 * S + 5 * MS)
    assert clock.offset_ns == offset
    assert clock.uncertainty_ns() == 25 * MS


def test_a_timesync_answer_bounds_no_longer_than_the_window(settings):
    """A sender that answers no more drifts on: its old bound would claim that nothing is uncertain."""
    clock = OffsetMap(settings)
    feed(clock, 10.0)
    assert clock.timesync(10 * S, START + 10 * S - 20 * MS, START + 10 * S + 5 * MS)
    feed(clock, settings.clock_window_s - 5.0, start_s=10.0)
    assert clock.uncertainty_ns() == 25 * MS
    # Its clock has gained 25 ms since, down to where the old bound was.
    feed(clock, 60.0, start_s=5.0 + settings.clock_window_s, offset_ns=START - 25 * MS)
    assert clock.uncertainty_ns() >= settings.clock_min_delay_s * S


@pytest.mark.parametrize(
    ("sent_ns", "why"),
    [(123, "another station's clock"), (START + 11 * S, "sent after it came back")],
)
def test_foreign_timesync_answers_are_refused(settings, sent_ns, why):
    clock = OffsetMap(settings)
    feed(clock, 10.0)
    assert not clock.timesync(10 * S, sent_ns, START + 10 * S), why


def test_the_map_forgets_a_fast_message_after_its_window(settings):
    clock = OffsetMap(settings)
    clock.observe(0, START)
    for i in range(1, 500):
        clock.observe(i * 100 * MS, START + i * 100 * MS + 40 * MS)
    assert clock.offset_ns == START + 40 * MS


def test_state_and_restore_continue_exactly(settings):
    rng = random.Random(5)
    times = [(i * 100 * MS, START + i * 100 * MS + rng.randrange(50 * MS)) for i in range(600)]
    whole, half = SenderClock(settings), SenderClock(settings)
    expected = [whole.observe_usec(sent // 1000, arrived) for sent, arrived in times]
    for sent, arrived in times[:333]:
        half.observe_usec(sent // 1000, arrived)
    resumed = SenderClock(settings)
    resumed.restore(half.state())
    assert [resumed.observe_usec(sent // 1000, arrived) for sent, arrived in times[333:]] == expected[333:]
    assert resumed.state() == whole.state()
