"""Notices begin once, end once, and do not flicker."""

import pytest

from groundstation.domain.events import Severity
from groundstation.engine.vehicle_notices import VehicleNotices
from groundstation.measurement.pose_history import PoseHistory
from groundstation.measurement.settings import MeasurementSettings
from groundstation.measurement.tally import Tally
from groundstation.measurement.vehicle_clock import ClockStep, OffsetMap, StepKind
from groundstation.measurement.vehicle_picture import VehiclePicture
from groundstation.measurement.vehicle_samples import VehicleSamples

S = 1_000_000_000
SETTINGS = MeasurementSettings()


@pytest.fixture
def notices():
    return VehicleNotices(SETTINGS, 3, 0)


@pytest.fixture
def samples():
    return VehicleSamples(SETTINGS, 3, PoseHistory(SETTINGS), OffsetMap(SETTINGS), Tally())


def test_no_position_is_told_once_and_its_end_too(notices):
    picture = VehiclePicture(3)
    assert notices.position(picture, 9 * S) is None
    told = notices.position(picture, 10 * S)
    assert told is not None
    assert told.code == "vehicle.no_position"
    assert told.text.startswith("vehicle 3 has sent no position for 10 s: ")
    assert notices.position(picture, 20 * S) is None
    ended = notices.position_came(21 * S)
    assert ended is not None
    assert ended.code == "vehicle.position"
    assert notices.position_came(22 * S) is None
    again = notices.position(picture, 32 * S)
    assert again is not None
    assert "stopped sending positions 10 s ago" in again.text


def test_a_lost_vehicle_is_not_also_blamed_for_its_position(notices):
    picture = VehiclePicture(3)
    picture.lost = True
    assert notices.position(picture, 60 * S) is None


def test_drops_that_flicker_are_one_notice(notices, samples):
    picture = VehiclePicture(3)
    codes = []
    for tick in range(300):
        now = tick * S // 10
        notices.position_came(now)
        samples.unplaced = 2 if tick < 100 and tick % 10 == 0 else 0
        told = notices.drops(samples, picture, now)
        if told:
            codes.append((told.code, tick))
            text = told.text
    assert codes == [("vehicle.samples_dropped", 50), ("vehicle.samples_resumed", 140)]
    assert text.endswith("20 were dropped")


def test_missing_attitudes_are_news_again_after_some_came(notices, samples):
    def lack(now):
        samples.unturned = 1
        told = notices.turns(samples, now)
        return told is not None

    assert lack(S)
    assert not lack(2 * S)
    notices.attitude_came()
    assert lack(3 * S)


def test_captures_are_summed_up(notices, samples):
    samples.cir_incomplete, samples.cir_complete = 3, 7
    assert notices.captures(samples, 9 * S) is None
    told = notices.captures(samples, 10 * S)
    assert told is not None
    assert "3 of 10 impulse responses" in told.text
    assert notices.captures(samples, 20 * S) is None
    samples.cir_incomplete = 1
    assert notices.captures(samples, 21 * S, final=True) is not None


@pytest.mark.parametrize(
    ("component", "kind", "words"),
    [
        (1, StepKind.REBOOT, "autopilot's time went back"),
        (191, StepKind.FORWARD, "radio sensor's time jumped ahead"),
        (154, StepKind.STALL, "component 154's time stood still"),
    ],
)
def test_a_clock_step_in_words(notices, component, kind, words):
    told = notices.stepped(component, ClockStep(kind, -90 * S), S)
    assert words in told.text
    assert "+90.0 s" in told.text


def test_contradicting_times_are_told_once_until_the_clock_steps(notices):
    assert notices.strays(191, 49, S) is None
    told = notices.strays(191, 50, S)
    assert told is not None
    assert told.severity is Severity.ERROR
    assert notices.strays(191, 90, S) is None
    notices.stepped(191, ClockStep(StepKind.REBOOT, S), S)
    assert notices.strays(191, 60, S) is not None


def test_state_and_restore(notices, samples):
    picture = VehiclePicture(3)
    notices.position(picture, 10 * S)
    notices.strays(191, 50, S)
    other = VehicleNotices(SETTINGS, 3, 7 * S)
    other.restore(notices.state())
    assert other.state() == notices.state()
    assert other.position(picture, 30 * S) is None
    assert other.strays(191, 70, S) is None
