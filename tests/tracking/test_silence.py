"""Silence as evidence: it moves the belief where somebody would have heard, and nowhere else."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from groundstation.localization import SearchArea, SignalModel
from groundstation.localization.containment import raster
from groundstation.tracking import Belief, TrackingSettings, TrackObservation
from groundstation.tracking.detection import SilenceField, shares
from groundstation.tracking.receivers import Receivers
from groundstation.tracking.silence import Ear, Silence

MODEL = SignalModel(nlos_bias_max_db=8.0)
SETTINGS = TrackingSettings(sample_std_db=0.3, base_cells=14, maximum_cells=500)
AREA = SearchArea(np.zeros(2), 250.0, 1.0, 20.0)
HEARD_AT, FLOWN_OVER = (-150.0, 0.0, 50.0), (120.0, 0.0, 50.0)


class Story:
    """Vehicle 1 hears the beacon in the west, vehicle 2 listens in the east, interval by interval."""

    def __init__(self, settings: TrackingSettings = SETTINGS) -> None:
        self.settings = settings
        self.silence = Silence(settings)
        self.receivers = Receivers(settings)
        self.time_s = 0.0
        self.receivers.heard(2, -50.0, None)
        for level in (-70.0, -70.5, -71.0):
            self.receivers.heard(1, level, None)
            self.receivers.heard(2, level, None)

    def heard(self, level_dbm: float = -45.0, place: tuple[float, float, float] = HEARD_AT) -> None:
        self.silence.heard(1, place, level_dbm, 0.0, (4, 0))

    def interval(self, packets: int, *, strong: bool = True, listens: bool = True) -> None:
        ears = [Ear(1, HEARD_AT, packets)]
        if listens:
            turn = 0.4 * self.time_s
            place = (FLOWN_OVER[0] + 40.0 * math.cos(turn), 40.0 * math.sin(turn), 50.0)
            ears.append(Ear(2, place, 0))
        self.silence.listen(self.time_s, self.time_s + 2.0, ears, [1] if strong else [])
        self.time_s += 2.0

    def field(self) -> SilenceField | None:
        return self.silence.field(self.receivers, MODEL)

    def log_at(self, place: tuple[float, float, float]) -> float:
        field = self.field()
        assert field is not None
        return float(field(np.array([place]), np.full((1, 2), 5.0))[0])


def area_of_90_percent_m2(belief: Belief) -> float:
    picture = raster(belief.mesh, belief.mass)
    reached = np.cumsum(np.sort(picture.mass.ravel())[::-1])
    return float(picture.cell_m**2 * np.searchsorted(reached, 0.9 * reached[-1]))


def test_where_another_one_listened_in_vain_the_belief_falls() -> None:
    story = Story()
    story.heard(-60.0)
    for _ in range(8):
        story.interval(4)
    over, near = story.log_at((*FLOWN_OVER[:2], 3.0)), story.log_at((*HEARD_AT[:2], 3.0))
    assert over < math.log(0.25)
    assert near > math.log(0.6)
    belief = Belief(AREA, MODEL, SETTINGS)
    belief.update([TrackObservation(1, HEARD_AT, -60.0, None, None, None, None, None, 0.0)])
    before = area_of_90_percent_m2(belief)
    east = belief.mesh.center_enu_m[:, 0] > 60.0
    share = belief.mass[east].sum()
    belief.set_field("silence", story.field())
    assert belief.mass[belief.mesh.center_enu_m[:, 0] > 60.0].sum() < 0.8 * share
    assert area_of_90_percent_m2(belief) < 0.95 * before


def test_it_never_rules_out() -> None:
    story = Story()
    story.heard(-30.0)
    for _ in range(200):
        story.interval(8)
    for east in np.linspace(-240.0, 240.0, 25):
        assert story.log_at((float(east), 0.0, 3.0)) >= math.log(SETTINGS.silence_doubt) - 1e-9


def test_a_weak_beacon_may_well_not_be_heard_elsewhere() -> None:
    strong, weak = Story(), Story()
    strong.heard(-55.0)
    weak.heard(-70.0)
    for story in (strong, weak):
        for _ in range(8):
            story.interval(4)
    # Heard at the limit from right above, it has no power to reach the other one.
    assert weak.log_at((-150.0, 0.0, 3.0)) > math.log(0.9)
    for east in (-240.0, -100.0, -50.0):
        assert weak.log_at((east, 0.0, 3.0)) > strong.log_at((east, 0.0, 3.0)) + 0.8


def test_nobody_heard_it_and_nothing_is_known_of_its_habits_says_little() -> None:
    story = Story()
    story.heard()
    story.interval(4, strong=False, listens=False)
    for _ in range(30):
        story.interval(0, strong=False)
    # quiet with 1/2: at most the other half is lost.
    assert story.silence.quiet_probability == pytest.approx(0.5)
    assert story.log_at((*FLOWN_OVER[:2], 3.0)) > math.log(0.45)


def test_a_beacon_that_stops_while_it_is_heard_well_is_not_absent() -> None:
    story = Story()
    story.heard()
    for _ in range(20):
        story.interval(4, listens=False)
    assert story.silence.quiet_probability == SETTINGS.quiet_probability
    for _ in range(30):
        story.interval(0)
    # Vehicle 1 stayed where it heard it well and lost it: it stopped speaking.
    assert story.silence.quiet_probability == 1.0
    assert story.field() is None


def test_a_regular_beacon_was_there_when_nobody_heard_it() -> None:
    story = Story()
    story.heard()
    for _ in range(20):
        story.interval(4, listens=False)
    for _ in range(8):
        # Vehicle 1 listens no more: only the beacon's habit says that it spoke.
        place = (FLOWN_OVER[0], 5.0 * story.time_s - 250.0, 50.0)
        story.silence.listen(story.time_s, story.time_s + 2.0, [Ear(2, place, 0)], [])
        story.time_s += 2.0
    assert story.log_at((120.0, -30.0, 3.0)) < math.log(0.5)


def test_before_it_was_first_heard_counts_less() -> None:
    def story(before: bool) -> float:
        told = Story()
        for north in range(-60, 61, 15):
            place = (120.0, float(north), 50.0)
            if before:
                told.silence.before(2, place, 4.0)
        told.heard()
        for _ in range(20):
            told.interval(4, listens=False)
        if not before:
            for north in range(-60, 61, 15):
                told.silence.listen(
                    told.time_s, told.time_s + 2.0, [Ear(2, (120.0, float(north), 50.0), 0)], []
                )
                told.time_s += 2.0
        return told.log_at((120.0, 0.0, 3.0))

    assert story(False) < story(True) - 0.5
    assert story(True) < math.log(0.7)


def test_a_slow_beacon_must_have_had_the_time_to_speak() -> None:
    story = Story()
    story.heard()
    # One packet in ten intervals: nothing is certain of a single interval.
    for number in range(40):
        story.interval(1 if number % 10 == 0 else 0, strong=False, listens=False)
    story.silence.listen(story.time_s, story.time_s + 2.0, [Ear(2, FLOWN_OVER, 0)], [])
    assert story.field() is None


def test_one_deaf_receiver_cannot_do_more_than_be_deaf() -> None:
    settings = replace(SETTINGS, silence_doubt=1e-6)
    story = Story(settings)
    story.heard(-30.0)
    for _ in range(100):
        story.interval(8)
    field = story.field()
    assert field is not None
    over = float(field(np.array([[*FLOWN_OVER[:2], 3.0]]), np.full((1, 2), 5.0))[0])
    assert math.log(settings.deaf_probability) - 1e-6 <= over < math.log(2.0 * settings.deaf_probability)


def test_a_receiver_is_no_better_than_it_proved() -> None:
    receivers = Receivers(SETTINGS)
    assert receivers.sensitivity_dbm(1) is None
    receivers.heard(1, -60.0, None)
    assert receivers.sensitivity_dbm(1) == -60.0
    for level in (-80.0, -81.0, -120.0):
        receivers.heard(1, level, None)
    # The single reading far below is not believed.
    assert receivers.sensitivity_dbm(1) == -80.0
    receivers.heard(1, None, -110.0)
    assert receivers.sensitivity_dbm(1) == -110.0 + SETTINGS.detection_snr_db
    # Of a receiver that never heard anything: the worst of the others.
    receivers.heard(2, -70.0, None)
    assert receivers.sensitivity_dbm(3) == -70.0
    assert not receivers.proven(3)
    assert Receivers(replace(SETTINGS, sensitivity_dbm=-99.0)).sensitivity_dbm(3) == -99.0
    again = Receivers(SETTINGS)
    again.restore(receivers.state())
    assert [again.sensitivity_dbm(v) for v in (1, 2, 3)] == [receivers.sensitivity_dbm(v) for v in (1, 2, 3)]


def test_passing_twice_over_the_same_ground_teaches_little() -> None:
    once, often = Story(), Story()
    for story, rounds in ((once, 8), (often, 80)):
        story.heard()
        for _ in range(rounds):
            story.interval(4)
    place = (100.0, 130.0, 3.0)
    assert abs(often.log_at(place) - once.log_at(place)) < 0.25


def test_neighbours_share_their_evidence() -> None:
    places = np.array([[0.0, 0.0, 50.0], [0.0, 0.0, 50.0], [1000.0, 0.0, 50.0]])
    assert shares(places, np.array([0, 0, 0]), 30.0, 0.5).tolist() == pytest.approx([0.5, 0.5, 1.0])
    assert shares(places, np.array([0, 1, 1]), 30.0, 0.5).tolist() == pytest.approx([2 / 3, 2 / 3, 1.0])


def test_state_gives_the_same_numbers_to_the_bit() -> None:
    story = Story()
    story.heard()
    for _ in range(11):
        story.interval(3)
    again = Silence(SETTINGS)
    again.restore(story.silence.state())
    for silence in (story.silence, again):
        silence.listen(
            story.time_s, story.time_s + 2.0, [Ear(2, (30.0, 30.0, 40.0), 0), Ear(1, HEARD_AT, 2)], [1]
        )
    first, second = story.field(), again.field(story.receivers, MODEL)
    assert first is not None
    assert second is not None
    places = np.random.default_rng(1).uniform(-200.0, 200.0, (1500, 3))
    half = np.full((1500, 2), 3.0)
    assert np.array_equal(first(places, half), second(places, half))
    # In whatever portions the belief asks.
    parts = [SilenceField.restore(first.state())(places[a : a + 77], half[:77]) for a in range(0, 1500, 77)]
    assert np.array_equal(np.concatenate(parts), first(places, half))


def test_an_order_of_the_antennas_null_explains_silence_overhead() -> None:
    story = Story()
    story.heard()
    for _ in range(8):
        story.interval(4)
    field = story.field()
    assert field is not None
    field = replace(field, deaf=np.zeros(1), doubt=1e-12)
    under = np.array([[FLOWN_OVER[0] + 40.0, 0.0, 3.0]])
    plain = float(field(under, np.full((1, 2), 5.0))[0])
    nulled = float(replace(field, null_mean=1.0, null_std=0.5)(under, np.full((1, 2), 5.0))[0])
    assert nulled > plain + 0.1
