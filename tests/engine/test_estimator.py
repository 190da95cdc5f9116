from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from groundstation.domain.events import Event
from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.inputs import MissionInput, SessionInput, TickInput
from groundstation.domain.mission import Area, Mission
from groundstation.domain.radio import CirCapture, CloseReason, LinkWindow
from groundstation.domain.target import (
    Environment,
    LinkVerdict,
    LosSource,
    SearchMap,
    TargetExplanation,
    TargetState,
    TargetWaiting,
)
from groundstation.domain.vehicle import PlaceAccuracy
from groundstation.engine.estimator import Estimator
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.tracking import Tracker, TrackingSettings

SECOND = 1_000_000_000
ORIGIN = Geodetic(-35.3625, 149.1654, 584.0)
FRAME = LocalFrame(ORIGIN)
TRUTH = np.array([22.0, -31.0, 4.0])
QUICK = EstimatorSettings(tracking=TrackingSettings(base_cells=12, maximum_cells=900))


class MarkedCaptures:
    """Judges a capture by its first tap: the answer is written into it."""

    def __init__(self) -> None:
        self.asked = 0

    def classify(self, links: Sequence[Sequence[object]], *, prior: float | None = None) -> list[object]:
        self.asked += len(links)
        answers = []
        for link in links:
            mark = float(link[-1].magnitude[0])  # type: ignore[attr-defined]
            if mark < 0:
                raise ValueError("spoilt")
            known = mark <= 1.0
            answers.append(
                SimpleNamespace(
                    los_probability=mark if known else prior,
                    status="classified" if known else "unknown",
                    reason="" if known else "too short",
                )
            )
        return answers


def mission(revision: int = 1, half_m: float = 110.0, **changed: object) -> MissionInput:
    corners = [(-half_m, -half_m), (half_m, -half_m), (half_m, half_m), (-half_m, half_m), (-half_m, -half_m)]
    ring = []
    for east, north in corners:
        place = FRAME.to_geodetic((east, north, 0.0))
        ring.append((place.latitude_deg, place.longitude_deg))
    plain = Mission(revision, ORIGIN, Area(((tuple(ring),),)), ground_amsl_m=584.0, height_reference="home")
    return MissionInput(replace(plain, **changed), "test")  # type: ignore[arg-type]


def window(
    vehicle: int, second: float, rng: np.random.Generator, beacon: int = 7, mark: float | None = None,
    **changed: object,
) -> LinkWindow:  # fmt: skip
    turn = math.pi / 2 * vehicle + 0.1 * second
    place = np.array([90.0 * math.cos(turn), 90.0 * math.sin(turn), 50.0])
    offset = TRUTH - place
    distance = float(np.linalg.norm(offset))
    end = int(second * SECOND)
    captures = ()
    if mark is not None:
        captures = (CirCapture(end, 1, np.array([mark, 0.5], dtype=np.float32), 1.0, None, 0),)
    plain = LinkWindow(
        vehicle_id=vehicle, beacon_id=beacon, start_ns=end - SECOND, end_ns=end,
        position=FRAME.to_geodetic(tuple(place)), attitude=(1.0, 0.0, 0.0, 0.0), path_length_m=9.0,
        rss_dbm=-16.0 - 25.0 * math.log10(distance) + 2.0 * float(rng.standard_normal()),
        rss_std_error_db=0.5, rss_count=16, noise_dbm=-110.0, frequency_hz=867_500_000, missed_count=0,
        azimuth_rad=math.atan2(offset[1], offset[0]) + 0.01 * float(rng.standard_normal()),
        azimuth_std_error_rad=0.005,
        elevation_rad=math.atan2(offset[2], math.hypot(offset[0], offset[1])),
        elevation_std_error_rad=0.005, aoa_count=16, captures=captures, sensor_los_probability=None,
        close_reason=CloseReason.FULL,
    )  # fmt: skip
    return replace(plain, **changed)  # type: ignore[arg-type]


def play(estimator: Estimator, inputs: list[tuple[int, object]]) -> list[object]:
    return [output for time_ns, item in inputs for output in estimator.handle(time_ns, item)]  # type: ignore[arg-type]


def story(
    seconds: int, vehicles: int = 4, mark: float | None = None, beacons: tuple[int, ...] = (7,)
) -> list:
    rng = np.random.default_rng(3)
    inputs: list = [(0, mission())]
    for second in range(1, seconds + 1):
        for beacon in beacons:
            for vehicle in range(1, vehicles + 1):
                heard = window(vehicle, second, rng, beacon, mark)
                inputs.append((heard.end_ns, heard))
        inputs.append((second * SECOND + 1, TickInput()))
    return inputs


def states(outputs: list) -> list[TargetState]:
    return [output for output in outputs if isinstance(output, TargetState)]


def error_m(state: TargetState) -> float:
    east, north, _ = FRAME.to_enu(state.position)
    return math.hypot(east - TRUTH[0], north - TRUTH[1])


def tally(estimator: Estimator) -> dict[str, int]:
    return {counter.name: counter.value for counter in estimator.counters()}


def test_line_of_sight_is_found_with_its_uncertainty() -> None:
    outputs = play(Estimator(QUICK, MarkedCaptures()), story(12, mark=0.97))
    states = [output for output in outputs if isinstance(output, TargetState)]
    last = states[-1]
    assert error_m(last) < 5.0
    assert error_m(last) < 2.0 * last.radius_90_m
    assert last.radius_90_m < 15.0
    assert (last.environment, last.los_links, last.links, last.windows) == (Environment.LOS, 4, 4, 48)
    assert last.height_reference == "home"
    assert [state.sequence for state in states] == list(range(1, len(states) + 1))
    assert last.snapshot is not None
    assert last.snapshot.method == "posterior"
    assert last.snapshot.vehicle_ids == last.snapshot.los_vehicle_ids == (1, 2, 3, 4)
    assert any(state.regions for state in states)
    _, _, up = FRAME.to_enu(last.position)
    assert 0.0 <= up <= 20.0


def test_no_answer_is_surer_than_the_vehicles_of_where_they_are() -> None:
    """Told 3 m, not 0: estimate, regions and snapshot are wider by that, and where they were."""
    told = {}
    for std_m in (0.0, 3.0):
        model = replace(
            QUICK.localization.model, vehicle_position_std_m=std_m, vehicle_height_std_m=0.5 * std_m
        )
        settings = replace(QUICK, localization=replace(QUICK.localization, model=model))
        outputs = play(Estimator(settings, MarkedCaptures()), story(12, mark=0.97))
        told[std_m] = states(outputs)[-1], [output for output in outputs if isinstance(output, SearchMap)][-1]
    (sharp, small), (wide, large) = told[0.0], told[3.0]
    assert math.hypot(*np.subtract(FRAME.to_enu(sharp.position), FRAME.to_enu(wide.position))[:2]) < 3.0
    assert sharp.snapshot is not None
    assert wide.snapshot is not None
    for one, other in [
        (sharp.covariance_enu_m2, wide.covariance_enu_m2),
        (sharp.snapshot.covariance_enu_m2, wide.snapshot.covariance_enu_m2),
    ]:
        assert one is not None
        assert other is not None
        # East–east and north–north of the upper triangle.
        assert other[0] > one[0] + 8.9
        assert other[3] > one[3] + 8.9
    assert wide.radius_90_m > max(sharp.radius_90_m, 2.1 * 3.0)
    area_m2 = [
        float((np.frombuffer(each.containment, "<u2") <= 9000).sum()) * each.cell_m**2
        for each in (small, large)
    ]
    assert area_m2[1] > area_m2[0] + 0.8 * math.pi * (2.1 * 3.0) ** 2


def test_who_says_line_of_sight() -> None:
    rng = np.random.default_rng(0)
    judge = MarkedCaptures()
    estimator = Estimator(QUICK, judge)
    cases = [
        (window(1, 1, rng, mark=0.8), LosSource.CLASSIFIER, 0.8, ""),
        (window(1, 2, rng, mark=5.0), LosSource.PRIOR, 0.3, "too short"),
        (window(1, 3, rng, mark=5.0, sensor_los_probability=0.6), LosSource.SENSOR, 0.6, ""),
        (window(1, 4, rng, sensor_los_probability=0.9), LosSource.SENSOR, 0.9, ""),
        (window(1, 5, rng), LosSource.PRIOR, 0.3, "no capture"),
    ]
    for heard, source, probability, reason in cases:
        (verdict,) = estimator.handle(heard.end_ns, heard)
        assert isinstance(verdict, LinkVerdict)
        assert (verdict.source, verdict.reason) == (source, reason)
        assert verdict.los_probability == pytest.approx(probability, abs=1e-6)
    assert judge.asked == 3
    (verdict,) = Estimator(QUICK, None).handle(0, window(1, 1, rng, mark=0.8))
    assert (verdict.source, verdict.reason) == (LosSource.PRIOR, "no classifier loaded")


def test_a_failing_classifier_costs_one_link() -> None:
    rng = np.random.default_rng(0)
    estimator = Estimator(QUICK, MarkedCaptures())
    event, verdict = estimator.handle(1, window(1, 1, rng, mark=-1.0))
    assert isinstance(event, Event)
    assert event.code == "link.classifier_failed"
    assert verdict.source is LosSource.PRIOR
    assert tally(estimator)["estimator_classifier_failures_total"] == 1


def test_waits_for_an_origin_and_loses_nothing() -> None:
    rng = np.random.default_rng(0)
    estimator = Estimator(QUICK, None)
    play(estimator, [(0, MissionInput(Mission(), "begin"))])
    play(estimator, [(SECOND, window(1, 1, rng)), (2 * SECOND, window(1, 2, rng))])
    (waiting,) = estimator.handle(2 * SECOND, TickInput())
    assert isinstance(waiting, TargetWaiting)
    assert "origin" in waiting.needed
    assert waiting.links == 1
    estimator.handle(3 * SECOND, mission())
    event, state, raster, reasons = estimator.handle(4 * SECOND, TickInput())
    assert isinstance(event, Event)
    assert event.code == "target.first_estimate"
    assert isinstance(state, TargetState)
    assert isinstance(raster, SearchMap)
    assert isinstance(reasons, TargetExplanation)
    assert state.windows == 2
    assert tally(estimator)["estimator_windows_taken_total"] == 2
    assert state.snapshot is None


def test_without_an_area_a_disc_round_the_first_place() -> None:
    rng = np.random.default_rng(0)
    estimator = Estimator(QUICK, None)
    play(estimator, [(0, MissionInput(Mission(1, ORIGIN), "begin")), (SECOND, window(1, 1, rng))])
    (state,) = states(estimator.handle(2 * SECOND, TickInput()))
    assert 100.0 < state.radius_90_m < 500.0
    assert state.height_reference == "unknown"


def test_empty_windows_wait_in_plain_words() -> None:
    rng = np.random.default_rng(0)
    estimator = Estimator(QUICK, None)
    silent = window(1, 1, rng, rss_dbm=None, azimuth_rad=None, elevation_rad=None)
    play(estimator, [(0, mission()), (SECOND, silent)])
    (waiting,) = estimator.handle(2 * SECOND, TickInput())
    assert isinstance(waiting, TargetWaiting)
    assert "received power" in waiting.needed


def test_windows_without_a_place_are_counted() -> None:
    rng = np.random.default_rng(0)
    estimator = Estimator(QUICK, None)
    estimator.handle(1, window(1, 1, rng, position=Geodetic(0.0, 0.0, 0.0)))
    assert tally(estimator)["estimator_windows_without_position_total"] == 1


def test_snapshot_takes_fresh_windows_only() -> None:
    estimator = Estimator(QUICK, MarkedCaptures())
    play(estimator, story(5, mark=0.9))
    rng = np.random.default_rng(1)
    late = 5 + QUICK.localization.window_age_s + 1
    play(estimator, [(int(late * SECOND), window(1, late, rng, mark=0.9))])
    (state,) = states(estimator.handle(int(late * SECOND) + 1, TickInput()))
    assert (state.links, state.snapshot) == (1, None)
    long = window(2, late, rng, mark=0.9, path_length_m=QUICK.localization.window_path_m + 1)
    play(estimator, [(int(late * SECOND) + SECOND, long)])
    (state,) = states(estimator.handle(int(late * SECOND) + 2 * SECOND, TickInput()))
    assert state.links == 1


def test_a_region_is_as_wide_as_the_vehicles_say_that_their_places_are() -> None:
    """The same windows with nothing said, without corrections to 10 m, and with RTK to 2 cm."""
    told = {}
    for accuracy in (None, PlaceAccuracy(10.0, 15.0, False), PlaceAccuracy(0.02, 0.03, True)):
        estimator, again = Estimator(QUICK, MarkedCaptures()), Estimator(QUICK, MarkedCaptures())
        said = [
            (time_ns, replace(item, place_accuracy=accuracy) if isinstance(item, LinkWindow) else item)
            for time_ns, item in story(8, mark=0.95)
        ]
        play(estimator, said[:-2])
        again.restore(estimator.state())
        told[accuracy] = states(play(estimator, [*said[-2:], (9 * SECOND, TickInput())]))[-1]
        assert states(play(again, [*said[-2:], (9 * SECOND, TickInput())]))[-1] == told[accuracy]
    assumed, vague, exact = told.values()
    assert [state.vehicle_position_std_m for state in told.values()] == pytest.approx(
        [1.0, 10.0 / math.sqrt(2.0), 0.02 / math.sqrt(2.0)]
    )
    assert exact.radius_90_m < assumed.radius_90_m < vague.radius_90_m
    assert vague.radius_90_m > vague.least_radius_90_m > 15.0
    assert exact.snapshot.covariance_enu_m2[0] < assumed.snapshot.covariance_enu_m2[0]
    assert vague.snapshot.covariance_enu_m2[0] > 50.0


def test_all_vehicles_in_one_place_fail_the_snapshot_only() -> None:
    rng = np.random.default_rng(0)
    estimator = Estimator(QUICK, None)
    here = FRAME.to_geodetic((10.0, 10.0, 50.0))
    play(estimator, [(0, mission())] + [(SECOND, window(v, 1, rng, position=here)) for v in range(1, 5)])
    (state,) = states(estimator.handle(2 * SECOND, TickInput()))
    # The posterior alone could answer; Algorithm 1 asks for two places.
    assert state.snapshot is None or state.snapshot.status == "ok"
    assert state.radius_90_m > 20.0


def test_another_area_moves_the_belief_at_once() -> None:
    estimator = Estimator(QUICK, None)
    play(estimator, story(8))
    (moved,) = states(estimator.handle(9 * SECOND, mission(2, half_m=15.0)))
    assert moved.radius_90_m < 25.0
    assert moved.windows == 32
    # The same ground again: nothing to do.
    assert estimator.handle(10 * SECOND, mission(3, half_m=15.0)) == []


def test_an_impossible_area_is_refused_in_one_line() -> None:
    estimator = Estimator(QUICK, None)
    line = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    (event,) = estimator.handle(0, mission(1, search_area=Area(((line,),))))
    assert isinstance(event, Event)
    assert event.code == "mission.area_refused"


def test_beacons_do_not_mix() -> None:
    """Several beacons in one run say what each says alone."""
    together = play(Estimator(QUICK, None), story(4, beacons=(7, 8)))
    inputs = [(t, i) for t, i in story(4, beacons=(7, 8)) if getattr(i, "beacon_id", 7) == 7]
    alone = play(Estimator(QUICK, None), inputs)
    assert [o for o in together if isinstance(o, TargetState) and o.beacon_id == 7] == [
        o for o in alone if isinstance(o, TargetState)
    ]


def test_bounds_on_beacons_and_pending_windows() -> None:
    rng = np.random.default_rng(0)
    estimator = Estimator(replace(QUICK, maximum_beacons=2, maximum_pending=3), None)
    for beacon in (1, 2, 3):
        estimator.handle(0, window(1, 1, rng, beacon))
    for second in range(2, 6):
        estimator.handle(0, window(1, second, rng, 1))
    counts = tally(estimator)
    assert counts["estimator_windows_of_refused_beacons_total"] == 1
    assert counts["estimator_windows_pending_dropped_total"] == 2


def test_restart_continues_bit_for_bit() -> None:
    inputs = story(9, mark=0.9, beacons=(7, 2**63 + 5))
    whole = Estimator(QUICK, MarkedCaptures())
    cut = 2 * len(inputs) // 3 - 3
    play(whole, inputs[:cut])
    again = Estimator(QUICK, MarkedCaptures())
    again.restore(whole.state())
    assert play(again, inputs[cut:]) == play(whole, inputs[cut:])
    assert again.counters() == whole.counters()
    with pytest.raises(Exception, match="version"):
        again.restore({"version": 99})


def test_same_inputs_same_outputs() -> None:
    first, second = (play(Estimator(QUICK, MarkedCaptures()), story(5, mark=0.6)) for _ in range(2))
    assert first == second


def test_resumed_session_tells_all_beliefs_again_and_drops_snapshots() -> None:
    estimator = Estimator(QUICK, MarkedCaptures())
    told = play(estimator, story(4, mark=0.9, beacons=(7, 8)))
    before = {state.beacon_id: state for state in told if isinstance(state, TargetState)}
    outputs = estimator.handle(5 * SECOND, SessionInput("resumed", "1"))
    again = states(outputs)
    for kind in (SearchMap, TargetExplanation):
        assert [told.beacon_id for told in outputs if isinstance(told, kind)] == [7, 8]
    assert [state.beacon_id for state in again] == [7, 8]
    for state in again:
        old = before[state.beacon_id]
        assert (state.position, state.radius_90_m, state.windows) == (old.position, old.radius_90_m, 16)
        assert (state.links, state.snapshot, state.environment) == (0, None, Environment.UNKNOWN)
        assert [share for share, _ in state.regions] == [0.5, 0.9, 0.95]
        assert state.sequence == old.sequence + 1
    rng = np.random.default_rng(2)
    play(estimator, [(6 * SECOND, window(1, 6, rng, mark=0.9))])
    (state,) = states(estimator.handle(7 * SECOND, TickInput()))
    assert (state.windows, state.links, state.snapshot) == (17, 1, None)
    assert error_m(state) < 10.0


def test_ended_session_fuses_what_waits_and_draws_all_regions() -> None:
    estimator = Estimator(QUICK, MarkedCaptures())
    play(estimator, story(4, mark=0.9, beacons=(7, 8)))
    rng = np.random.default_rng(2)
    # Beacon 7 was updated just now: a tick would leave this window for the next one.
    heard = window(1, 4.1, rng, 7, 0.9)
    play(estimator, [(heard.end_ns, heard)])
    assert states(estimator.handle(heard.end_ns + 1, TickInput())) == []
    taken = tally(estimator)["estimator_windows_taken_total"]
    outputs = estimator.handle(heard.end_ns + 2, SessionInput("ended", "1"))
    assert tally(estimator)["estimator_windows_taken_total"] == taken + 1
    last = {state.beacon_id: state for state in outputs if isinstance(state, TargetState)}
    assert {beacon: state.windows for beacon, state in last.items()} == {7: 17, 8: 16}
    assert all(state.regions for state in last.values())
    # Nothing waits any more, and what is known is told again in full.
    assert len(states(estimator.handle(heard.end_ns + 3, SessionInput("ended", "1")))) == 2


def test_nothing_is_told_of_a_beacon_without_belief() -> None:
    estimator = Estimator(QUICK, None)
    play(estimator, [(SECOND, window(1, 1, np.random.default_rng(0)))])
    assert estimator.handle(2 * SECOND, SessionInput("resumed", "1")) == []
    (waiting,) = estimator.handle(3 * SECOND, SessionInput("ended", "1"))
    assert isinstance(waiting, TargetWaiting)


def test_updates_are_spaced() -> None:
    rng = np.random.default_rng(0)
    estimator = Estimator(QUICK, None)
    estimator.handle(0, mission())
    updates = 0
    for tenth in range(1, 31):
        estimator.handle(tenth * SECOND // 10, window(1, tenth / 10, rng))
        outputs = estimator.handle(tenth * SECOND // 10, TickInput())
        updates += sum(isinstance(output, TargetState) for output in outputs)
    assert updates == pytest.approx(3.0 / QUICK.update_interval_s, abs=1)


def test_of_many_beacons_snapshots_and_regions_take_turns() -> None:
    """Twelve beacons, 26 s: a snapshot each 6 s and regions each 4.8 s, spread evenly over all ticks."""
    beacons = tuple(range(1, 13))
    settings = replace(QUICK, snapshots_interval_s=0.5, all_regions_interval_s=0.4)
    inputs = story(26, mark=0.9, beacons=beacons)
    inputs += [(s * SECOND + t * SECOND // 10, TickInput()) for s in range(1, 27) for t in range(1, 10)]
    outputs = play(Estimator(settings, MarkedCaptures()), sorted(inputs, key=lambda item: item[0]))
    made: dict[int, set[int]] = {beacon: set() for beacon in beacons}
    drawn: dict[int, list[int]] = {beacon: [] for beacon in beacons}
    for output in outputs:
        if isinstance(output, TargetState) and output.snapshot is not None:
            made[output.beacon_id].add(output.snapshot.time_ns)
        if isinstance(output, SearchMap):
            drawn[output.beacon_id].append(output.time_ns)
    for times in [sorted(times) for times in made.values()]:
        # Those few that are there before the others have their first without a turn; beacons are updated
        # once a second, and so late may a turn be taken.
        assert all(abs(b - a - 6 * SECOND) <= 1.3 * SECOND for a, b in pairwise(times[1:]))
        assert 3 <= len(times) <= 6
    for first, *again in drawn.values():
        # The first at once.
        assert first <= 2 * SECOND
        assert all(abs(b - a - 4.8 * SECOND) <= 1.3 * SECOND for a, b in pairwise(again[1:]))
        assert len(again) >= 4
    seconds = np.bincount([moment // SECOND for times in made.values() for moment in times])
    assert seconds[:2].max() <= 5
    assert seconds[2:].max() <= 4


def test_beliefs_that_nothing_comes_for_keep_no_more_than_they_must(monkeypatch: pytest.MonkeyPatch) -> None:
    rested: list[int] = []
    plain = Tracker.rest
    monkeypatch.setattr(Tracker, "rest", lambda self: (rested.append(id(self)), plain(self))[1])
    estimator = Estimator(QUICK, MarkedCaptures())
    play(estimator, story(4, beacons=(7, 8)))
    assert not rested
    # Eight goes on, seven is silent.
    rng = np.random.default_rng(1)
    for second in range(5, 17):
        play(estimator, [(second * SECOND, window(1, second, rng, beacon=8))])
        play(estimator, [(second * SECOND + 1, TickInput())])
        assert len(set(rested)) == (second >= 14)
    monkeypatch.setattr("groundstation.engine.estimator._AWAKE", 0)
    play(estimator, [(17 * SECOND, TickInput())])
    assert len(set(rested)) == 2


def test_many_beacons_take_turns() -> None:
    """Seven beacons wait and three are updated a tick: all have had their turn after three ticks."""
    rng = np.random.default_rng(0)
    estimator = Estimator(replace(QUICK, updates_per_tick=3), None)
    estimator.handle(0, mission())
    beacons = list(range(11, 18))
    for beacon in beacons:
        estimator.handle(0, window(1, 1, rng, beacon))
    turns = []
    for tick in range(1, 5):
        outputs = estimator.handle(SECOND + tick, TickInput())
        turns.append([output.beacon_id for output in outputs if isinstance(output, TargetState)])
    assert turns == [beacons[:3], beacons[3:6], beacons[6:], []]
    assert tally(estimator)["estimator_updates_put_off_total"] == 4 + 1
    for beacon in beacons:
        estimator.handle(2 * SECOND, window(2, 2, rng, beacon))
    # At the end nobody is put off.
    assert tally(estimator)["estimator_windows_taken_total"] == 7
    estimator.handle(2 * SECOND, SessionInput("ended", "1"))
    assert tally(estimator)["estimator_windows_taken_total"] == 14
