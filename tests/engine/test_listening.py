"""From frames to silences: who listened, and what the estimator makes of it."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from groundstation.domain.events import Event
from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.inputs import (
    Direction,
    FrameInput,
    JoinInput,
    MissionInput,
    Record,
    SessionInput,
    TickInput,
)
from groundstation.domain.mission import Area, LastKnownPlace, Mission, Terrain
from groundstation.domain.radio import CloseReason, LinkWindow, Listener, Listening
from groundstation.domain.target import TargetState
from groundstation.engine.estimator import Estimator
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.engine.ingest import Ingest
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.store.codec import decode_record, dump_json, encode_record, load_json
from groundstation.tracking import TrackingSettings

SECOND = 1_000_000_000
START = 1_795_308_500 * SECOND
ORIGIN = Geodetic(47.0, 8.0, 500.0)
FRAME = LocalFrame(ORIGIN)
SETTINGS = EstimatorSettings(tracking=TrackingSettings(base_cells=12, maximum_cells=500))


# --- ingest


class Swarm:
    """Vehicles that fly north at 5 m/s; each hears or not, lives or not."""

    def __init__(self) -> None:
        self.records: list[Record] = []
        self.encoders = {v: (Encoder(v, 1), Encoder(v, 191)) for v in (1, 2)}

    def put(self, time_ns: int, item: Any) -> None:
        self.records.append(Record(len(self.records), time_ns, time_ns // 1000, item))

    def second(
        self, second: int, hears: tuple[int, ...], alive: tuple[int, ...], posed: tuple[int, ...]
    ) -> None:
        for tenth in range(10):
            now = START + second * SECOND + tenth * SECOND // 10
            boot_ms = (now - START) // 1_000_000 + 5000
            for vehicle, (autopilot, sensor) in self.encoders.items():
                frames = []
                if tenth == 0:
                    frames.append(autopilot.pack(dialect.MAVLink_heartbeat_message(2, 3, 129, 4, 4, 3)))
                    if vehicle in alive:
                        frames.append(sensor.pack(dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)))
                if vehicle in posed:
                    north_deg = math.degrees(5.0 * (now - START) / SECOND / 6_378_137.0)
                    place = round((47.0 + north_deg) * 1e7), 80_000_000 + 10_000 * vehicle
                    frames.append(
                        autopilot.pack(
                            dialect.MAVLink_global_position_int_message(
                                boot_ms, *place, 550_000, 50_000, 500, 0, 0, 0
                            )
                        )
                    )
                    frames.append(autopilot.pack(dialect.MAVLink_attitude_message(boot_ms, 0, 0, 0, 0, 0, 0)))
                if vehicle in hears and tenth % 5 == 3:
                    frames.append(
                        sensor.pack(
                            dialect.MAVLink_sar_rss_message(
                                boot_ms * 1000, 77, 868_000_000, -9000, -11000, 2 * second + tenth // 5
                            )
                        )
                    )
                for frame in frames:
                    self.put(now, FrameInput("udp", Direction.IN, frame))
            self.put(now, TickInput())


def told(swarm: Swarm, ingest: Ingest | None = None) -> list[Listening]:
    ingest = ingest or Ingest()
    outputs = [output for record in swarm.records for output in ingest.handle(record)]
    return [output for output in outputs if isinstance(output, Listening)]


def test_who_lives_and_is_placed_listens_whether_it_hears_or_not() -> None:
    swarm = Swarm()
    for second in range(12):
        swarm.second(second, hears=(1,), alive=(1, 2), posed=(1, 2))
    intervals = told(swarm)
    assert len(intervals) >= 4
    for interval in intervals[1:]:
        assert interval.end_ns - interval.start_ns == 2 * SECOND
        first, second = interval.listeners
        assert first.packets == ((77, 4),)
        assert (second.vehicle_id, second.packets) == (2, ())
        middle_s = 0.5 * (interval.start_ns + interval.end_ns - 2 * START) / SECOND
        assert LocalFrame(ORIGIN).to_enu(second.position)[1] == pytest.approx(5.0 * middle_s, abs=0.3)
    for before, after in itertools.pairwise(intervals):
        assert after.start_ns == before.end_ns


def test_a_dead_sensor_or_an_unknown_place_is_no_silence() -> None:
    swarm = Swarm()
    for second in range(30):
        swarm.second(second, hears=(1,), alive=(1, 2) if second < 10 else (1,), posed=(1, 2))
    for second in range(30, 50):
        swarm.second(second, hears=(1,), alive=(1, 2), posed=(1,))
    listening = {
        (interval.end_ns - START) // SECOND: {listener.vehicle_id for listener in interval.listeners}
        for interval in told(swarm)
    }
    assert listening[8] == {1, 2}
    assert listening[16] == listening[28] == {1}
    assert listening[40] == {1}


def test_listening_continues_to_the_bit_after_a_restart() -> None:
    swarm = Swarm()
    for second in range(13):
        swarm.second(second, hears=(1, 2) if second % 3 else (1,), alive=(1, 2), posed=(1, 2))
    records, cut = swarm.records, len(swarm.records) // 2 + 7
    whole, again = Ingest(), Ingest()
    for record in records[:cut]:
        whole.handle(record)
    again.restore(whole.state())
    swarm.records = records[cut:]
    rest = told(swarm, whole)
    assert len(rest) >= 2
    assert rest == told(swarm, again)


def test_after_a_stop_nobody_is_said_to_have_listened_meanwhile() -> None:
    swarm = Swarm()
    for second in range(6):
        swarm.second(second, hears=(1,), alive=(1, 2), posed=(1, 2))
    swarm.put(START + 100 * SECOND, SessionInput("resumed", "1"))
    for second in range(100, 106):
        swarm.second(second, hears=(1,), alive=(1, 2), posed=(1, 2))
    assert max(interval.end_ns - interval.start_ns for interval in told(swarm)) <= 2 * SECOND
    # Nor when the station stood still without being told so.
    swarm.records = [record for record in swarm.records if not isinstance(record.input, SessionInput)]
    assert max(interval.end_ns - interval.start_ns for interval in told(swarm)) <= 2 * SECOND


# --- estimator


def mission(**changed: Any) -> MissionInput:
    corners = [(-200.0, -200.0), (200.0, -200.0), (200.0, 200.0), (-200.0, 200.0), (-200.0, -200.0)]
    places = [FRAME.to_geodetic((east, north, 0.0)) for east, north in corners]
    ring = tuple((place.latitude_deg, place.longitude_deg) for place in places)
    plain = Mission(1, ORIGIN, Area(((ring,),)), ground_amsl_m=500.0, height_reference="home")
    return MissionInput(replace(plain, **changed), "test")


def window(vehicle: int, second: int, place: tuple[float, float, float], rss_dbm: float) -> LinkWindow:
    end = second * SECOND
    return LinkWindow(
        vehicle_id=vehicle, beacon_id=77, start_ns=end - SECOND, end_ns=end,
        position=FRAME.to_geodetic(place), attitude=(1.0, 0.0, 0.0, 0.0), path_length_m=5.0,
        rss_dbm=rss_dbm, rss_std_error_db=0.5, rss_count=4, noise_dbm=-112.0, frequency_hz=868_000_000,
        missed_count=0, azimuth_rad=None, azimuth_std_error_rad=None, elevation_rad=None,
        elevation_std_error_rad=None, aoa_count=0, captures=(), sensor_los_probability=None,
        close_reason=CloseReason.AGE,
    )  # fmt: skip


def story(seconds: int, listens: bool, speaks: bool = True) -> list[tuple[int, Any]]:
    """Vehicle 1 hears beacon 77 in the west; vehicle 2 flies up and down in the east in vain."""
    inputs: list[tuple[int, Any]] = [(0, mission())]
    for second in range(2, seconds, 2):
        now = second * SECOND
        west = (-120.0, 3.0 * second - 60.0, 40.0)
        east = (120.0, 150.0 * math.sin(0.1 * second), 40.0)
        inputs.append((now, window(1, second, west, -86.0 - 2.0 * math.sin(second))))
        listeners = [Listener(1, FRAME.to_geodetic(west), ((77, 4),))]
        if listens:
            listeners.append(Listener(2, FRAME.to_geodetic(east), ()))
        inputs.append((now, Listening(now - 2 * SECOND, now, tuple(listeners))))
        inputs.append((now, TickInput()))
    return inputs


def play(estimator: Estimator, inputs: list[tuple[int, Any]]) -> list[Any]:
    return [output for time_ns, item in inputs for output in estimator.handle(time_ns, item)]


def last(outputs: list[Any]) -> TargetState:
    return [output for output in outputs if isinstance(output, TargetState)][-1]


def east_m(state: TargetState) -> float:
    return FRAME.to_enu(state.position)[0]


def test_what_the_other_one_did_not_hear_moves_the_belief_away_from_it() -> None:
    def share_near(listens: bool) -> tuple[float, float]:
        estimator = Estimator(SETTINGS, None)
        state = last(play(estimator, story(40, listens=listens)))
        belief = estimator._beacons[77].belief
        assert belief is not None
        away = np.hypot(*(belief.mesh.center_enu_m[:, :2] - [-120.0, 0.0]).T)
        return float(belief.mass[away < 70.0].sum()), east_m(state)

    (share, east), (share_silent, east_silent) = share_near(False), share_near(True)
    assert share_silent > 1.25 * share
    assert east_silent < east - 5.0


def test_a_joint_beacon_spoke_when_any_of_its_ids_was_heard() -> None:
    def east_of(listens: bool) -> float:
        inputs: list[tuple[int, Any]] = []
        for time_ns, item in story(44, listens=listens):
            if time_ns >= 6 * SECOND and isinstance(item, LinkWindow):
                item = replace(item, beacon_id=78)
            if time_ns >= 6 * SECOND and isinstance(item, Listening):
                renamed = tuple(
                    replace(ear, packets=tuple((78, packets) for _, packets in ear.packets))
                    for ear in item.listeners
                )
                item = replace(item, listeners=renamed)
            inputs.append((time_ns, item))
        inputs.append((7 * SECOND, JoinInput("ann", 78, 77)))
        told = play(Estimator(SETTINGS, None), sorted(inputs, key=lambda entry: entry[0]))
        return east_m(
            [state for state in told if isinstance(state, TargetState) and state.beacon_id == 77][-1]
        )

    assert east_of(True) < east_of(False) - 5.0


def test_state_goes_on_bit_for_bit_with_silences_priors_and_terrain() -> None:
    inputs = story(44, listens=True)
    inputs[0] = (0, mission(last_known=(LastKnownPlace(47.0005, 8.0, 80.0, "hut", 77),), terrain=slope()))
    whole, again = Estimator(SETTINGS, None), Estimator(SETTINGS, None)
    cut = 2 * len(inputs) // 3
    play(whole, inputs[:cut])
    again.restore(load_json(dump_json(listed(whole.state()))))
    assert play(again, inputs[cut:]) == play(whole, inputs[cut:])
    assert again.counters() == whole.counters()
    assert {c.name: c.value for c in whole.counters()}["estimator_silences_weighed_total"] > 1


def listed(tree: Any) -> Any:
    """As a snapshot keeps it: arrays as numbers."""
    if isinstance(tree, np.ndarray):
        return tree.tolist()
    if isinstance(tree, dict):
        return {name: listed(value) for name, value in tree.items()}
    return [listed(value) for value in tree] if isinstance(tree, list | tuple) else tree


def test_places_listened_at_before_the_first_packet_are_remembered() -> None:
    def first(listened: bool) -> TargetState:
        estimator = Estimator(SETTINGS, None)
        inputs: list[tuple[int, Any]] = [(0, mission())]
        for second in range(2, 80, 2):
            if listened:
                place = FRAME.to_geodetic((120.0, 5.0 * second - 190.0, 40.0))
                item = Listening((second - 2) * SECOND, second * SECOND, (Listener(2, place, ()),))
                inputs.append((second * SECOND, item))
        later = [(time_ns + 80 * SECOND, item) for time_ns, item in story(30, listens=False)[1:]]
        moved = [
            (time_ns, replace(item, start_ns=item.start_ns + 80 * SECOND, end_ns=item.end_ns + 80 * SECOND))
            if not isinstance(item, TickInput)
            else (time_ns, item)
            for time_ns, item in later
        ]
        return last(play(estimator, inputs + moved))

    assert east_m(first(True)) < east_m(first(False)) - 1.0


def test_a_last_known_place_draws_the_belief_until_another_mission_takes_it_back() -> None:
    estimator = Estimator(SETTINGS, None)
    plain = last(play(estimator, story(20, listens=False)))
    hut = FRAME.to_geodetic((-40.0, -120.0, 0.0))
    known = (LastKnownPlace(hut.latitude_deg, hut.longitude_deg, 40.0),)
    drawn = last(estimator.handle(30 * SECOND, mission(revision=2, last_known=known)))

    def away_m(state: TargetState) -> float:
        east, north, _ = FRAME.to_enu(state.position)
        return math.hypot(east + 40.0, north + 120.0)

    assert away_m(drawn) < 0.6 * away_m(plain)
    # Of another beacon: nothing to this one.
    others = mission(revision=3, last_known=(replace(known[0], beacon_id=78),))
    free = last(estimator.handle(31 * SECOND, others))
    assert away_m(free) == pytest.approx(away_m(plain), abs=6.0)


def test_listening_before_there_is_a_frame_is_counted() -> None:
    estimator = Estimator(SETTINGS, None)
    estimator.handle(0, Listening(0, 2 * SECOND, (Listener(1, ORIGIN, ()),)))
    assert [(c.name, c.value) for c in estimator.counters()] == [
        ("estimator_listening_without_frame_total", 1)
    ]


# --- terrain


def slope(columns: int = 80, home_m: float = 500.0, rise: float = 0.3) -> Terrain:
    """The ground rises to the east by ``rise``; ``home_m`` at the origin; unknown in the far west."""
    step = 1e-4
    metres = step * math.cos(math.radians(47.0)) * 111_320.0
    altitude: list[int | None] = []
    for _ in range(columns):
        for column in range(columns):
            east = (column - columns / 2) * metres
            altitude.append(None if column < 4 else round(10.0 * (home_m + rise * east)))
    half = 0.5 * columns * step
    return Terrain(47.0 - half, 8.0 - half, step, step, columns, tuple(altitude), "slope.asc")


def heights(estimator: Estimator) -> tuple[np.ndarray, np.ndarray]:
    belief = estimator._beacons[77].belief
    assert belief is not None
    return belief.mesh.center_enu_m[:, 0], belief.mesh.center_enu_m[:, 2]


def test_boxes_stand_on_the_ground_under_them() -> None:
    estimator = Estimator(SETTINGS, None)
    inputs = story(12, listens=False)
    inputs[0] = (0, mission(terrain=slope()))
    state = last(play(estimator, inputs))
    east, up = heights(estimator)
    above = up - 0.3 * east
    assert above.min() > -0.5
    assert above.max() < 20.5
    assert up.max() - up.min() > 80.0
    assert state.height_reference == "terrain"


@pytest.mark.parametrize(
    ("home_m", "code", "shift"), [(494.0, "terrain.tied", 0.0), (560.0, "terrain.disagrees", 60.0)]
)
def test_terrain_meets_home_or_says_that_it_does_not(home_m: float, code: str, shift: float) -> None:
    estimator = Estimator(SETTINGS, None)
    inputs = story(12, listens=False)
    inputs[0] = (0, mission(terrain=slope(home_m=home_m)))
    outputs = play(estimator, inputs)
    events = [output for output in outputs if isinstance(output, Event) and output.code.startswith("terrain")]
    assert [event.code for event in events] == [code]
    assert "slope.asc" in events[0].text
    east, up = heights(estimator)
    assert (up - 0.3 * east).min() == pytest.approx(shift, abs=6.0)


def test_outside_the_file_heights_count_from_the_mission_s_ground_and_say_so() -> None:
    estimator = Estimator(SETTINGS, None)
    inputs = story(12, listens=False)
    # The file begins 76 m east of the origin: the belief's middle is beyond it.
    file = replace(slope(), west_deg=8.001)
    inputs[0] = (0, mission(terrain=file, ground_amsl_m=507.0, height_reference="settings"))
    state = last(play(estimator, inputs))
    assert state.height_reference == "settings"
    east, up = heights(estimator)
    beyond = east < 40.0
    assert up[beyond].min() > 6.5
    assert up[beyond].max() < 27.5


def test_the_journal_holds_the_terrain() -> None:
    entry = mission(terrain=slope(), last_known=(LastKnownPlace(47.0, 8.0, 50.0, "hut", 2**64 - 1),))
    data = encode_record(Record(3, 4, 5, entry))
    back = decode_record(data[2], 3, 4, 5, data[32:-4])
    assert back.input == entry
