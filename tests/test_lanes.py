"""The estimator's lane with a real child process: order, overload, death, restart."""

from __future__ import annotations

import os
import signal
import threading
from dataclasses import replace

import numpy as np
import pytest

from groundstation.channel import load_classifier
from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.inputs import MissionInput, TickInput
from groundstation.domain.mission import Mission
from groundstation.domain.radio import CloseReason, LinkWindow
from groundstation.domain.target import TargetState
from groundstation.engine.estimator import Estimator
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.lanes import EstimatorLane
from groundstation.pipeline import Work

pytestmark = pytest.mark.timeout(90)

SECOND = 1_000_000_000
ORIGIN = Geodetic(-35.3625, 149.1654, 584.0)
FRAME = LocalFrame(ORIGIN)


def window(vehicle_id: int, second: int) -> LinkWindow:
    turn = vehicle_id * 1.5 + 0.05 * second
    place = np.array([80 * np.cos(turn), 80 * np.sin(turn), 50.0])
    distance = float(np.linalg.norm(place))
    return LinkWindow(
        vehicle_id=vehicle_id,
        beacon_id=7,
        start_ns=(second - 1) * SECOND,
        end_ns=second * SECOND + vehicle_id,
        position=FRAME.to_geodetic((float(place[0]), float(place[1]), 50.0)),
        attitude=(1.0, 0.0, 0.0, 0.0),
        path_length_m=4.0,
        rss_dbm=15.0 - 25.0 * float(np.log10(distance)),
        rss_std_error_db=1.0,
        rss_count=16,
        noise_dbm=-110.0,
        frequency_hz=867_500_000,
        missed_count=0,
        azimuth_rad=float(np.arctan2(-place[1], -place[0])),
        azimuth_std_error_rad=0.01,
        elevation_rad=float(np.arcsin(-50.0 / distance)),
        elevation_std_error_rad=0.01,
        aoa_count=16,
        captures=(),
        sensor_los_probability=0.95,
        close_reason=CloseReason.FULL,
    )


def work(seconds: range) -> list[Work]:
    items = [Work(0, 0, MissionInput(Mission(1, ORIGIN, ground_amsl_m=584.0), "test"))]
    for second in seconds:
        items += [Work(second, second * SECOND, window(vehicle, second)) for vehicle in (1, 2, 3)]
        items.append(Work(second, second * SECOND + 100, TickInput()))
    return items


def inline(items: list[Work]) -> TargetState:
    estimator = Estimator(EstimatorSettings(), load_classifier())
    outputs = [o for item in items for o in estimator.handle(item.time_ns, item.item)]
    return [o for o in outputs if isinstance(o, TargetState)][-1]


class Listener:
    def __init__(self) -> None:
        self.targets: list[TargetState] = []
        self.failures: list[tuple[str, tuple]] = []

    def outputs(self, outputs, counters) -> None:
        self.targets += [o for o in outputs if isinstance(o, TargetState)]

    def failed(self, text, dropped) -> None:
        self.failures.append((text, dropped))


@pytest.fixture
def listener() -> Listener:
    return Listener()


@pytest.fixture
def lane(listener: Listener):
    lane = EstimatorLane(EstimatorSettings(), listener.outputs, listener.failed)
    yield lane
    lane.close()


def test_the_lane_gives_what_the_engine_gives_inline(lane: EstimatorLane, listener: Listener) -> None:
    lane.start()
    items = work(range(1, 8))
    for item in items:
        assert lane.submit((item,)) == ()
    assert lane.drain(60)
    assert listener.targets[-1] == inline(items)
    assert listener.failures == []


def test_a_restored_child_goes_on_to_the_bit(lane: EstimatorLane, listener: Listener) -> None:
    items = work(range(1, 10))
    half = len(items) // 2
    lane.start()
    lane.submit(tuple(items[:half]))
    states: list[dict] = []
    arrived = threading.Event()
    lane.request_state(lambda state: (states.append(state), arrived.set()))
    assert arrived.wait(60)
    lane.close()
    second = EstimatorLane(EstimatorSettings(), listener.outputs, listener.failed)
    try:
        second.start(states[0])
        second.submit(tuple(items[half:]))
        assert second.drain(60)
    finally:
        second.close()
    assert listener.targets[-1] == inline(items)


def test_a_killed_child_comes_back_with_its_beliefs_and_tells(
    lane: EstimatorLane, listener: Listener
) -> None:
    items = work(range(1, 8))
    lane.start()
    lane.submit(tuple(items[:-4]))
    assert lane.drain(60)
    os.kill(lane._process.pid, signal.SIGKILL)
    lane._process.join(10)
    lost = [item.item.key for item in items[-4:] if isinstance(item.item, LinkWindow)]
    lane.submit(tuple(items[-4:]))
    assert lane.drain(60)
    ((text, dropped),) = listener.failures
    assert "started again" in text
    assert list(dropped) == lost
    # What it had told before it died it does not tell again.
    told = [target.sequence for target in listener.targets]
    assert told == sorted(set(told))
    # It knows what it knew: the next windows give what an engine gives that never saw the lost ones.
    more = [replace(item, seq=99) for item in work(range(8, 10))[1:]]
    lane.submit(tuple(more))
    assert lane.drain(60)
    kept = [*items[:-4], items[-1], *more]
    assert listener.targets[-1] == inline(kept)


def test_a_full_queue_drops_the_oldest_windows_and_names_them(listener: Listener) -> None:
    lane = EstimatorLane(EstimatorSettings(), listener.outputs, listener.failed, queue_windows=5)
    items = work(range(1, 4))
    dropped = lane.submit(tuple(items))  # not started yet: nothing is taken
    windows = [item.item.key for item in items if isinstance(item.item, LinkWindow)]
    assert list(dropped) == windows[:4]
    assert lane.backlog_windows == 5
    lane.close()
