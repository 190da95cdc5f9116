import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.measurement.sequence import BeaconSequence, FrameLoss

MS = 1_000_000


def count(numbers, step_ms=100):
    tracker = BeaconSequence(100.0)
    for i, number in enumerate(numbers):
        tracker.observe(number % 65536, i * step_ms * MS)
    return tracker.missed, tracker.restarts


@given(start=st.integers(0, 65535), lost=st.sets(st.integers(1, 398)))
def test_gaps_are_counted_across_the_wrap(start, lost):
    numbers = [start + i for i in range(400) if i not in lost]
    assert count(numbers) == (len(lost), 0)


@pytest.mark.parametrize(
    ("numbers", "missed", "restarts"),
    [
        ([10, 11, 13, 12, 14], 0, 0),
        ([65534, 65535, 0, 1], 0, 0),
        ([5000, 5001, 0, 1, 2], 0, 1),
        ([60000, 60001, 3, 4], 0, 1),
        ([30, 31, 32, 0, 1, 2], 0, 1),
        ([10, 40010, 40011], 0, 1),
        ([7, 7, 8], 0, 0),
    ],
    ids=["overtaken", "wrap", "restart", "restart high", "restart early", "absurd jump", "no counter"],
)
def test_what_is_no_loss(numbers, missed, restarts):
    assert count(numbers) == (missed, restarts)


def test_a_long_silence_explains_a_long_gap():
    tracker = BeaconSequence(100.0)
    tracker.observe(0, 0)
    tracker.observe(3000, 60_000 * MS)
    assert (tracker.missed, tracker.restarts) == (2999, 0)


def test_beacon_state_and_restore():
    one, two = BeaconSequence(100.0), BeaconSequence(100.0)
    for i, n in enumerate((1, 2, 5)):
        one.observe(n, i * MS)
    two.restore(one.state())
    for tracker in (one, two):
        tracker.observe(4, 4 * MS)
        tracker.observe(9, 5 * MS)
    assert one.missed == two.missed == 1 + 3
    assert one.state() == two.state()


def test_frame_loss_of_one_in_five_is_twenty_percent():
    loss = FrameLoss()
    assert loss.percent() is None
    for i in range(500):
        if i % 5:
            loss.observe(1, i % 256, i * 20 * MS)
    assert loss.percent() == pytest.approx(20.0, abs=0.3)


def test_components_count_apart_and_old_losses_are_forgotten():
    loss = FrameLoss()
    loss.observe(1, 0, 0)
    loss.observe(191, 200, 0)
    loss.observe(1, 1, MS)
    loss.observe(191, 211, 2 * MS)
    assert loss.percent() == pytest.approx(100 * 10 / 14)
    for i in range(100):
        loss.observe(1, (2 + i) % 256, 70_000 * MS + i * MS)
    assert loss.percent() == 0.0


def test_frame_loss_state_and_restore():
    one, two = FrameLoss(), FrameLoss()
    one.observe(1, 0, 0)
    one.observe(1, 4, MS)
    two.restore(one.state())
    assert two.percent() == one.percent() == pytest.approx(60.0)
