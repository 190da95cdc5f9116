"""When beliefs are explained, and what the map of a belief says of where it lies."""

from __future__ import annotations

import math
import struct
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.inputs import MissionInput, SessionInput, TickInput
from groundstation.domain.mission import Area, Mission
from groundstation.domain.radio import CloseReason, LinkWindow
from groundstation.domain.target import SearchMap, TargetExplanation, TargetState
from groundstation.engine.estimator import Estimator
from groundstation.engine.estimator_beacon import Beacon
from groundstation.engine.estimator_explanations import due_explanation
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.localization import SearchArea
from groundstation.tracking import Tracker, TrackingSettings

SECOND = 1_000_000_000
ORIGIN = Geodetic(47.25, -122.5, 120.0)
FRAME = LocalFrame(ORIGIN)
TRUTH = np.array([22.0, -31.0, 4.0])
SETTINGS = EstimatorSettings(tracking=TrackingSettings(base_cells=10, maximum_cells=400))


def window(vehicle: int, second: int, beacon: int) -> LinkWindow:
    turn = math.pi / 2 * vehicle + 0.1 * second
    place = np.array([90.0 * math.cos(turn), 90.0 * math.sin(turn), 50.0])
    away = TRUTH - place
    # The third vehicle's compass is off by 8° to the right, and its nose 5° higher than it thinks.
    turned, lifted = (-math.radians(8.0), math.radians(5.0)) if vehicle == 3 else (0.0, 0.0)
    return LinkWindow(
        vehicle_id=vehicle, beacon_id=beacon, start_ns=(second - 1) * SECOND, end_ns=second * SECOND,
        position=FRAME.to_geodetic((float(place[0]), float(place[1]), float(place[2]))),
        attitude=(1.0, 0.0, 0.0, 0.0), path_length_m=9.0,
        rss_dbm=15.0 - 25.0 * math.log10(float(np.linalg.norm(away))), rss_std_error_db=0.5, rss_count=16,
        noise_dbm=-110.0, frequency_hz=867_500_000, missed_count=0,
        azimuth_rad=math.atan2(away[1], away[0]) + turned, azimuth_std_error_rad=0.01,
        elevation_rad=math.atan2(away[2], math.hypot(away[0], away[1])) + lifted,
        elevation_std_error_rad=0.01,
        aoa_count=16, captures=(), sensor_los_probability=0.95, close_reason=CloseReason.FULL,
    )  # fmt: skip


def mission() -> MissionInput:
    corners = ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
    places = [FRAME.to_geodetic((110.0 * east, 110.0 * north, 0.0)) for east, north in corners]
    ring = tuple((place.latitude_deg, place.longitude_deg) for place in places)
    return MissionInput(
        Mission(1, ORIGIN, Area(((ring,),)), ground_amsl_m=120.0, height_reference="home"), "test"
    )


def run(estimator: Estimator, first: int, last: int, beacons: tuple[int, ...] = (7,)) -> list[Any]:
    outputs: list[Any] = []
    for second in range(first, last + 1):
        for beacon in beacons:
            for vehicle in (1, 2, 3):
                outputs += estimator.handle(second * SECOND, window(vehicle, second, beacon))
        for tenth in range(10):
            outputs += estimator.handle(second * SECOND + tenth * SECOND // 10, TickInput())
    return outputs


@pytest.fixture(scope="module")
def outputs() -> list[Any]:
    """Of a run of twelve seconds."""
    estimator = Estimator(SETTINGS, None)
    estimator.handle(0, mission())
    return run(estimator, 1, 12)


def test_a_belief_is_explained_now_and_then_each_vehicle_in_it(outputs: list[Any]) -> None:
    told = [output for output in outputs if isinstance(output, TargetExplanation)]
    times_s = [explanation.time_ns / SECOND for explanation in told]
    assert len(times_s) == 3
    assert all(b - a >= SETTINGS.explanation_interval_s for a, b in pairwise(times_s))
    last = told[-1]
    assert [link.vehicle_id for link in last.contributions] == [1, 2, 3]
    assert sum(link.weight for link in last.contributions) == pytest.approx(1.0, abs=1e-3)
    states = {o.sequence: o for o in outputs if isinstance(o, TargetState)}
    assert states[last.sequence].time_ns == last.time_ns


def test_windows_are_counted_and_the_turned_compass_is_found(outputs: list[Any]) -> None:
    last = [output for output in outputs if isinstance(output, TargetExplanation)][-1]
    right, _, wrong = last.contributions
    # It flies 9 m a window: none is from a place that was heard from before.
    assert (wrong.windows, wrong.redundant, right.los_probability) == (11, 0, 0.95)
    assert wrong.azimuth_residual_deg == pytest.approx(8.0, abs=3.5)
    assert abs(right.azimuth_residual_deg or 99.0) < 3.0
    assert (wrong.azimuth_score or 0.0) > abs(right.azimuth_score or 0.0)
    # Above the estimate is positive, for people as in mathematics.
    assert 1.5 < (wrong.elevation_residual_deg or 0.0) < 6.0
    assert (wrong.elevation_score or 0.0) > abs(right.elevation_score or 0.0)


def test_many_beacons_take_turns_and_cost_no_more() -> None:
    estimator = Estimator(SETTINGS, None)
    estimator.handle(0, mission())
    beacons = (5, 6, 7, 8)
    outputs = run(estimator, 1, 3, beacons)
    told = [output for output in outputs if isinstance(output, TargetExplanation)]
    gaps_s = [(b.time_ns - a.time_ns) / SECOND for a, b in pairwise(told)]
    assert min(gaps_s) >= SETTINGS.explanations_interval_s
    # Who was never explained comes first.
    assert sorted(output.beacon_id for output in told[:4]) == list(beacons)
    # At the end all are.
    final = estimator.handle(4 * SECOND, SessionInput("ended", "1"))
    assert sorted(o.beacon_id for o in final if isinstance(o, TargetExplanation)) == list(beacons)


def test_who_has_waited_longest_is_explained_next() -> None:
    area = SearchArea(np.array([0.0, 0.0]), 100.0, 0.0, 10.0)
    belief = Tracker(area, SETTINGS.localization.model, SETTINGS.tracking, 7)
    beacons = [
        Beacon(beacon_id, 0, 0, belief=belief, sequence=2, explained_ns=explained_ns, explained_sequence=1)
        for beacon_id, explained_ns in ((5, 30 * SECOND), (6, None), (7, 10 * SECOND), (8, 59 * SECOND))
    ]
    order = []
    for second in (60, 61, 62):
        due = due_explanation(beacons, second * SECOND, (second - 1) * SECOND, SETTINGS)
        assert due is not None
        due.explained_ns, due.explained_sequence = second * SECOND, due.sequence
        order.append(due.beacon_id)
    # Never explained, 10 s, 30 s; the fourth was explained a moment ago and the others are not due again.
    assert order == [6, 7, 5]
    assert due_explanation(beacons, 62 * SECOND + 1, 62 * SECOND, SETTINGS) is None


def test_the_map_comes_with_the_regions_and_lies_where_the_belief_is(outputs: list[Any]) -> None:
    states = {o.sequence: o for o in outputs if isinstance(o, TargetState)}
    maps = [output for output in outputs if isinstance(output, SearchMap)]
    assert [found.sequence for found in maps] == [s for s, state in states.items() if state.regions]
    found = maps[-1]
    state = states[found.sequence]
    assert (found.rows, found.columns, found.origin) == (64, 64, ORIGIN)
    share = np.array([value for (value,) in struct.iter_unpack("<f", found.share)]).reshape(64, 64)
    contained = np.array([v for (v,) in struct.iter_unpack("<H", found.containment)]).reshape(64, 64)
    assert share.sum() == pytest.approx(1.0, abs=1e-3)
    # Its centre of mass, counted from the north-western corner, is the estimate.
    north = found.north_m - found.cell_m * (np.arange(64) + 0.5)
    east = found.west_m + found.cell_m * (np.arange(64) + 0.5)
    at_east, at_north, _ = FRAME.to_enu(state.position)
    assert float((share * east).sum()) == pytest.approx(at_east, abs=found.cell_m)
    assert float((share * north[:, None]).sum()) == pytest.approx(at_north, abs=found.cell_m)
    assert contained[np.unravel_index(share.argmax(), share.shape)] == contained.min()
    # The corners on WGS84 are those of the plane.
    half = found.cell_m * 32
    for (latitude, longitude), (x, y) in zip(
        found.corners, ((-1, 1), (1, 1), (1, -1), (-1, -1)), strict=True
    ):
        corner_east, corner_north, _ = FRAME.to_enu(Geodetic(latitude, longitude, ORIGIN.altitude_amsl_m))
        assert corner_east == pytest.approx(found.west_m + half + x * half, abs=0.02)
        assert corner_north == pytest.approx(found.north_m - half + y * half, abs=0.02)
