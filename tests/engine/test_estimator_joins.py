"""Joined ids: one transmitter under several names, joined and separated by an operator."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from groundstation.domain.events import Event
from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.inputs import JoinInput, MissionInput, SessionInput, TickInput
from groundstation.domain.mission import Area, LastKnownPlace, Mission
from groundstation.domain.radio import CloseReason, LinkWindow
from groundstation.domain.target import SearchMap, TargetJoined, TargetState
from groundstation.engine.estimator import Estimator
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.tracking import TrackingSettings

SECOND = 1_000_000_000
ORIGIN = Geodetic(-35.3625, 149.1654, 584.0)
FRAME = LocalFrame(ORIGIN)
TRUTH = np.array([22.0, -31.0, 4.0])
SETTINGS = EstimatorSettings(tracking=TrackingSettings(base_cells=10, maximum_cells=500))
OLD, NEW, THIRD = 7, 2**63 + 8, 9


def window(vehicle: int, second: int, beacon: int) -> LinkWindow:
    turn = math.pi / 2 * vehicle + 0.1 * second
    place = np.array([90.0 * math.cos(turn), 90.0 * math.sin(turn), 50.0])
    level_db = 2.0 * math.sin(7.0 * vehicle + 3.0 * second)
    return LinkWindow(
        vehicle_id=vehicle, beacon_id=beacon, start_ns=(second - 1) * SECOND, end_ns=second * SECOND,
        position=FRAME.to_geodetic((float(place[0]), float(place[1]), float(place[2]))),
        attitude=(1.0, 0.0, 0.0, 0.0), path_length_m=9.0,
        rss_dbm=-16.0 - 25.0 * math.log10(float(np.linalg.norm(TRUTH - place))) + level_db,
        rss_std_error_db=0.5, rss_count=16, noise_dbm=-110.0, frequency_hz=867_500_000, missed_count=0,
        azimuth_rad=None, azimuth_std_error_rad=None, elevation_rad=None, elevation_std_error_rad=None,
        aoa_count=0, captures=(), sensor_los_probability=None, close_reason=CloseReason.FULL,
    )  # fmt: skip


def mission(revision: int = 1, last_known: tuple[LastKnownPlace, ...] = ()) -> MissionInput:
    ring = tuple(
        (place.latitude_deg, place.longitude_deg)
        for place in (
            FRAME.to_geodetic((110.0 * east, 110.0 * north, 0.0))
            for east, north in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
        )
    )
    return MissionInput(
        Mission(
            revision,
            ORIGIN,
            Area(((ring,),)),
            ground_amsl_m=584.0,
            height_reference="home",
            last_known=last_known,
        ),
        "test",
    )


def hear(estimator: Estimator, first: int, last: int, beacon: int) -> list[Any]:
    """Four vehicles hear the beacon, one window a second each."""
    outputs: list[Any] = []
    for second in range(first, last + 1):
        for vehicle in range(1, 5):
            outputs += estimator.handle(second * SECOND, window(vehicle, second, beacon))
        outputs += estimator.handle(second * SECOND + 1, TickInput())
    return outputs


def of(outputs: list[Any], beacon: int) -> list[TargetState]:
    return [o for o in outputs if isinstance(o, TargetState) and o.beacon_id == beacon]


def ran(*phases: tuple[int, int, int]) -> Estimator:
    estimator = Estimator(SETTINGS, None)
    estimator.handle(0, mission())
    for phase in phases:
        hear(estimator, *phase)
    return estimator


def error_m(state: TargetState) -> float:
    east, north, _ = FRAME.to_enu(state.position)
    return math.hypot(east - TRUTH[0], north - TRUTH[1])


def test_windows_of_both_ids_feed_one_belief_that_is_told_under_the_old_one() -> None:
    estimator = ran((1, 8, OLD), (9, 12, NEW))
    outputs = estimator.handle(13 * SECOND, JoinInput("ann", NEW, OLD))
    (event,) = [o for o in outputs if isinstance(o, Event)]
    assert (event.code, event.beacon_id) == ("target.joined", NEW)
    assert "ann" in event.text
    (state,) = of(outputs, OLD)
    assert of(outputs, NEW) == []
    assert (state.windows, state.joined_beacon_ids) == (12 * 4, (NEW,))
    assert (state.first_heard_ns, state.last_heard_ns) == (0, 12 * SECOND)
    assert [share for share, _ in state.regions] == [0.5, 0.9, 0.95]
    assert [o.beacon_id for o in outputs if isinstance(o, SearchMap)] == [OLD]
    (joined,) = [o for o in outputs if isinstance(o, TargetJoined)]
    assert (joined.beacon_id, joined.into_beacon_id, joined.last_heard_ns) == (NEW, OLD, 12 * SECOND)
    # What the phone says under its new name moves the old one's estimate, and only that.
    later = hear(estimator, 14, 16, NEW)
    assert of(later, NEW) == []
    assert [s.windows for s in of(later, OLD)] == [52, 56, 60]
    assert of(later, OLD)[-1].last_heard_ns == 16 * SECOND
    assert of(later, OLD)[-1].sequence == state.sequence + 3
    assert [o.last_heard_ns for o in later if isinstance(o, TargetJoined)] == [
        second * SECOND for second in (14, 15, 16)
    ]


def test_the_joint_belief_is_that_of_one_beacon_heard_all_the_time() -> None:
    estimator = ran((1, 8, OLD), (9, 12, NEW))
    joint = of(estimator.handle(13 * SECOND, JoinInput("ann", NEW, OLD)), OLD)[0]
    one = of(hear(ran((1, 8, OLD)), 9, 12, OLD), OLD)[-1]
    # Not bit for bit: which windows look like outliers was judged in another order.
    assert error_m(joint) == pytest.approx(error_m(one), abs=3.0)
    assert joint.radius_90_m == pytest.approx(one.radius_90_m, rel=0.15)
    alone = of(hear(ran(), 1, 8, OLD), OLD)[-1]
    assert joint.radius_90_m < alone.radius_90_m


def test_a_last_known_place_of_any_of_its_ids_counts_for_the_joint_beacon() -> None:
    hut = FRAME.to_geodetic((-30.0, 40.0, 0.0))
    known = (LastKnownPlace(hut.latitude_deg, hut.longitude_deg, 5.0, "hut", NEW),)
    plain, told = ran((1, 1, OLD), (2, 2, NEW)), Estimator(SETTINGS, None)
    told.handle(0, mission(last_known=known))
    hear(told, 1, 1, OLD)
    hear(told, 2, 2, NEW)
    join = JoinInput("ann", NEW, OLD)
    free, drawn = (of(estimator.handle(3 * SECOND, join), OLD)[0] for estimator in (plain, told))

    def away_m(state: TargetState) -> float:
        east, north, _ = FRAME.to_enu(state.position)
        return math.hypot(east + 30.0, north - 40.0)

    assert away_m(drawn) < 0.7 * away_m(free)
    # A mission that takes it back, or gives it again, reaches the joint beacon too; a restart keeps it.
    assert away_m(of(told.handle(4 * SECOND, mission(2)), OLD)[0]) == pytest.approx(away_m(free), abs=3.0)
    again = of(told.handle(5 * SECOND, mission(3, known)), OLD)[0]
    assert away_m(again) == pytest.approx(away_m(drawn), abs=3.0)
    other = Estimator(SETTINGS, None)
    other.restore(told.state())
    assert hear(other, 6, 7, NEW) == hear(told, 6, 7, NEW)
    # Separated, it says nothing of the id that it was not said of.
    apart = of(told.handle(8 * SECOND, JoinInput("ann", NEW, None)), OLD)[0]
    alone = of(hear(ran(), 1, 1, OLD), OLD)[-1]
    assert away_m(apart) == pytest.approx(away_m(alone), abs=3.0)


def test_a_join_is_taken_back_and_nothing_was_lost() -> None:
    apart = ran((1, 6, OLD), (7, 10, NEW))
    joined = ran((1, 6, OLD), (7, 10, NEW))
    joined.handle(10 * SECOND + 5, JoinInput("ann", NEW, OLD))
    after = [hear(estimator, 11, 14, NEW) for estimator in (apart, joined)]
    outputs = joined.handle(15 * SECOND, JoinInput("ann", NEW, None))
    (old,), (new,) = of(outputs, OLD), of(outputs, NEW)
    before = of(apart.handle(15 * SECOND, SessionInput("ended", "1")), OLD)[0]
    assert (old.position, old.radius_90_m, old.windows) == (before.position, before.radius_90_m, 24)
    assert old.joined_beacon_ids == ()
    # It was fused at once instead of four times: the boxes may differ, the belief does not.
    expected = of(after[0], NEW)[-1]
    assert new.windows == expected.windows == 32
    assert new.radius_90_m == pytest.approx(expected.radius_90_m, rel=0.15)
    assert error_m(new) == pytest.approx(error_m(expected), abs=3.0)
    # Its update counter goes on where the joint belief's was.
    assert old.sequence > of(after[1], OLD)[-1].sequence
    assert of(hear(joined, 16, 16, NEW), NEW)[0].windows == 36


def test_three_ids_become_one_and_the_rest_stays_joined() -> None:
    estimator = ran((1, 3, OLD))
    alone = of(hear(estimator, 4, 4, OLD), OLD)[-1]
    hear(estimator, 5, 8, NEW)
    hear(estimator, 9, 12, THIRD)
    two = of(estimator.handle(13 * SECOND, JoinInput("ann", NEW, OLD)), OLD)[0]
    # Joined into one that is joined itself: they are all the first one's.
    state = of(estimator.handle(14 * SECOND, JoinInput("ann", THIRD, NEW)), OLD)[0]
    assert state.joined_beacon_ids == (THIRD, NEW)
    assert state.windows == 48
    outputs = estimator.handle(15 * SECOND, JoinInput("ann", NEW, None))
    (rest,), (new,) = of(outputs, OLD), of(outputs, NEW)
    assert (rest.joined_beacon_ids, rest.windows, new.windows) == ((THIRD,), 32, 16)
    # A page takes the highest number for the newest, whatever was joined and separated.
    assert alone.sequence < two.sequence < state.sequence < rest.sequence


def test_one_that_others_are_joined_into_takes_them_along() -> None:
    estimator = ran((1, 4, OLD), (5, 8, NEW), (9, 12, THIRD))
    estimator.handle(13 * SECOND, JoinInput("ann", NEW, OLD))
    outputs = estimator.handle(14 * SECOND, JoinInput("ann", OLD, THIRD))
    (state,) = of(outputs, THIRD)
    assert (state.joined_beacon_ids, state.windows) == ((OLD, NEW), 48)
    told = {o.beacon_id: o.into_beacon_id for o in outputs if isinstance(o, TargetJoined)}
    assert told == {OLD: THIRD, NEW: THIRD}


@pytest.mark.parametrize(
    ("join", "words"),
    [
        (JoinInput("ann", NEW, 12345), "beacon 12345 was never heard"),
        (JoinInput("ann", OLD, OLD), "one already"),
        (JoinInput("ann", THIRD, OLD), "joined into 7 already"),
        (JoinInput("ann", OLD, THIRD), "one already"),
        (JoinInput("ann", NEW, None), "not joined into another"),
    ],
)
def test_what_cannot_be_joined_is_refused_in_one_line(join: JoinInput, words: str) -> None:
    estimator = ran((1, 2, OLD), (1, 2, NEW), (1, 2, THIRD))
    estimator.handle(3 * SECOND, JoinInput("ann", THIRD, OLD))
    (event,) = estimator.handle(4 * SECOND, join)
    assert isinstance(event, Event)
    assert event.code == "target.join_refused"
    assert words in event.text


def test_joined_before_there_is_an_origin() -> None:
    estimator = Estimator(SETTINGS, None)
    hear(estimator, 1, 2, OLD)
    hear(estimator, 3, 4, NEW)
    estimator.handle(5 * SECOND, JoinInput("ann", NEW, OLD))
    estimator.handle(6 * SECOND, mission())
    (state,) = of(estimator.handle(7 * SECOND, TickInput()), OLD)
    assert (state.windows, state.joined_beacon_ids) == (16, (NEW,))


def test_a_restart_goes_on_bit_for_bit_with_what_is_joined() -> None:
    whole = ran((1, 4, OLD), (5, 6, NEW))
    whole.handle(7 * SECOND, JoinInput("ann", NEW, OLD))
    hear(whole, 8, 9, NEW)
    again = Estimator(SETTINGS, None)
    again.restore(whole.state())
    for estimator in (whole, again):
        estimator.handle(0, mission())
    rest = [
        [*hear(estimator, 10, 12, NEW), *estimator.handle(13 * SECOND, JoinInput("ann", NEW, None))]
        for estimator in (whole, again)
    ]
    assert rest[0] == rest[1]
    assert again.counters() == whole.counters()


def test_after_a_stop_the_page_is_told_of_joins_again() -> None:
    estimator = ran((1, 3, OLD), (4, 5, NEW))
    estimator.handle(6 * SECOND, JoinInput("ann", NEW, OLD))
    outputs = estimator.handle(7 * SECOND, SessionInput("resumed", "1"))
    assert [o.beacon_id for o in outputs if isinstance(o, TargetJoined)] == [NEW]
    assert [o.beacon_id for o in outputs if isinstance(o, TargetState)] == [OLD]
