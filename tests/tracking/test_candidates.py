"""Boxes that are let go: the belief is the same without them, and they come back when they matter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.localization import SearchArea, SignalModel
from groundstation.localization.likelihood import ExponentGrid
from groundstation.localization.mesh import MeshSettings, moments
from groundstation.localization.regressors import Mixer
from groundstation.localization.whitening import whiten
from groundstation.tracking import Belief, TrackingSettings, TrackObservation, candidates
from groundstation.tracking.history import observations_of

PAPER = SignalModel(nlos_bias_max_db=8.0)
SETTINGS = TrackingSettings(sample_std_db=0.3)


def area_m2(belief: Belief) -> float:
    """Of all boxes, those that were let go included, by the heights' own extent."""
    return float(np.exp(belief.mesh.log_volume).sum() + np.exp(belief.gone.log_volume).sum()) / 19.0


@pytest.fixture
def keep_all(monkeypatch: pytest.MonkeyPatch):
    def apply() -> None:
        monkeypatch.setattr(candidates, "_NOTHING", np.inf)

    return apply


def test_boxes_that_hold_nothing_go_and_the_belief_stays(
    fly, keep_all, monkeypatch: pytest.MonkeyPatch
) -> None:
    laid = []
    lay = candidates.Candidates.lay
    monkeypatch.setattr(candidates.Candidates, "lay", lambda *given: (laid.append(1), lay(*given))[1])
    flight = fly(np.random.default_rng(7), (1, 1, 1, 1), 100)
    lean = Belief(flight.area, PAPER, SETTINGS)
    whole_m2, gone = area_m2(lean), [0]
    for windows in flight.seconds:
        lean.update(windows)
        gone.append(lean.gone.count)
        # The rest of the area is still known.
        assert area_m2(lean) == pytest.approx(whole_m2, rel=0.02)
    assert max(gone) > 500
    # Looking at them brings nothing back that does not matter.
    few = len(laid)
    keep_all()
    full = Belief(flight.area, PAPER, SETTINGS)
    for windows in flight.seconds:
        full.update(windows)
    assert few <= len(laid) - few + 1
    assert lean.gone.count > 0.4 * full.mesh.count
    assert full.gone.count == 0
    mean, covariance = moments(lean.mesh, lean.mass)
    whole_mean, whole_covariance = moments(full.mesh, full.mass)
    np.testing.assert_allclose(mean, whole_mean, atol=1e-6)
    np.testing.assert_allclose(covariance, whole_covariance, atol=1e-6)


def test_those_that_go_later_join_those_that_went() -> None:
    boxes = candidates.Candidates(PAPER, ExponentGrid.of(PAPER), None)
    area = SearchArea(np.zeros(2), 100.0, 1.0, 20.0)
    nothing = observations_of(np.zeros((0, 15)), np.zeros((0, 0), dtype=np.int64))
    boxes.lay(
        area, MeshSettings(), nothing, whiten(nothing, 0, 0, 25.0, PAPER), 0,
        lambda mesh: np.zeros(mesh.count), False,
    )  # fmt: skip
    every = boxes.mesh.count
    assert boxes.let_go(np.zeros(every)) is None
    boxes._to_be_tried = True
    away = np.hypot(*boxes.mesh.center_enu_m[:, :2].T)
    kept = boxes.let_go(np.where(away > 70.0, -50.0, 0.0))
    assert kept is not None
    # Half a box's width stays round what holds something.
    assert 85.0 > np.hypot(*boxes.mesh.center_enu_m[:, :2].T).max() > 70.0
    boxes.let_go(np.where(away[kept] > 30.0, -50.0, 0.0))
    assert boxes.mesh.count + boxes.gone.count == every
    assert len({tuple(center) for center in boxes.gone.center_enu_m}) == boxes.gone.count
    assert boxes.evidence.candidates == boxes.mesh.count == boxes.bearings.mean.shape[-1]


def test_what_lies_beside_the_belief_is_not_let_go(fly) -> None:
    flight = fly(np.random.default_rng(7), (1, 1, 1, 1), 50)
    belief = Belief(flight.area, PAPER, SETTINGS)
    for windows in flight.seconds:
        belief.update(windows)
        likely = belief.mass > 1e-6
        for center, half in zip(belief.gone.center_enu_m, belief.gone.half_m, strict=True):
            apart = np.abs(belief.mesh.center_enu_m[likely] - center)
            reach = belief.mesh.half_m[likely][:, [0, 0, 1]] + half[[0, 0, 1]]
            assert not (apart < reach + 0.4 * half[[0, 0, 1]]).all(axis=1).any()
    assert belief.gone.count > 100


def test_a_belief_that_was_led_astray_comes_back(fly, keep_all) -> None:
    """Bearings agree on a wrong place until the right one is let go; then they are right, for longer."""
    flight = fly(np.random.default_rng(11), (1, 1, 1, 1), 120)
    wrong = np.array([-60.0, 40.0, 5.0]) if flight.truth_enu_m[0] > 0 else np.array([60.0, -40.0, 5.0])

    def lying(window: TrackObservation) -> TrackObservation:
        way = wrong - np.array(window.position_enu_m)
        return replace(
            window,
            azimuth_rad=float(np.arctan2(way[1], way[0])),
            elevation_rad=float(np.arctan2(way[2], np.hypot(way[0], way[1]))),
        )

    def told() -> tuple[list[bool], list[float]]:
        belief = Belief(flight.area, PAPER, replace(SETTINGS, maximum_windows=300))
        gone, error = [], []
        for second, windows in enumerate(flight.seconds):
            belief.update([lying(w) for w in windows] if second < 12 else windows)
            apart = np.abs(belief.gone.center_enu_m - flight.truth_enu_m) <= belief.gone.half_m[:, [0, 0, 1]]
            gone.append(bool(apart.all(axis=1).any()))
            error.append(float(np.hypot(*(belief.mass @ belief.mesh.center_enu_m - flight.truth_enu_m)[:2])))
        return gone, error

    gone, error = told()
    assert error[11] > 30.0
    assert any(gone[8:])
    assert not gone[-1]
    assert error[-1] < 5.0
    keep_all()
    assert error[-1] == pytest.approx(told()[1][-1], abs=1.0)


def test_a_belief_with_boxes_let_go_is_restored_bit_for_bit(fly) -> None:
    # Short of memory: windows are forgotten, and what is left is related anew at the next look.
    settings = replace(SETTINGS, maximum_windows=200)
    flight = fly(np.random.default_rng(7), (1, 1, 1, 1), 110)
    whole = Belief(flight.area, PAPER, settings)
    for windows in flight.seconds[:71]:
        whole.update(windows)
    assert whole.gone.count > 0
    again = Belief.restore(whole.state(), flight.area, PAPER, settings)
    for windows in flight.seconds[71:]:
        whole.update(windows)
        again.update(windows)
        assert (whole.mass == again.mass).all()
        for name, value in whole.state().items():
            np.testing.assert_array_equal(np.asarray(value), np.asarray(again.state()[name]), name)


def test_boxes_are_laid_later_where_all_windows_have_to_be_weighed_for_it(fly) -> None:
    flight = fly(np.random.default_rng(7), (0, 0, 0, 0), 10)
    belief = Belief(flight.area, PAPER, SETTINGS)
    for windows in flight.seconds:
        belief.update(windows)
    belief._remesh_mass = 0.7 * belief._heaviest()
    assert belief._is_coarse()
    belief._whole = False
    assert not belief._is_coarse()
    belief._remesh_mass *= 0.7
    assert belief._is_coarse()


def test_another_area_brings_everything_back(fly) -> None:
    flight = fly(np.random.default_rng(7), (1, 1, 1, 1), 50)
    belief = Belief(flight.area, PAPER, SETTINGS)
    for windows in flight.seconds:
        belief.update(windows)
    assert belief.gone.count > 0
    belief.set_area(SearchArea(np.zeros(2), 140.0, 1.0, 20.0))
    assert belief.gone.count == 0
    assert np.exp(belief.mesh.log_volume).sum() == pytest.approx(np.pi * 140.0**2 * 19.0, rel=0.02)


def test_after_forgetting_boxes_are_laid_and_looked_at_by_windows_related_anew(
    fly, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows that had been related to forgotten ones, and now to none, would be told apart twice as sure."""
    related: list[bool] = []
    looks: list[int] = []
    weighed = candidates.Candidates._weighed

    def watched(self, observations, windows, *given):
        # The first of a vehicle have nobody, and the oldest are thinned until nobody is near enough.
        newer = observations.parents[windows[windows >= 4 + observations.count // 2]]
        related.append(bool((newer >= 0).any(axis=1).all()))
        looks.append(windows.size < observations.count)
        return weighed(self, observations, windows, *given)

    monkeypatch.setattr(candidates.Candidates, "_weighed", watched)
    flight = fly(np.random.default_rng(7), (1, 1, 1, 1), 110)
    belief = Belief(flight.area, PAPER, replace(SETTINGS, maximum_windows=200))
    forgotten = 0
    for windows in flight.seconds:
        asked = len(related)
        forgotten += belief.update(windows).forgotten
        assert all(related[asked:])
    assert forgotten > 0
    assert len(related) > 4
    # At some it is enough to look at a few windows, and no others are related for it.
    assert any(looks)
    belief.set_area(flight.area)
    assert all(related)


def test_what_is_kept_beside_the_sums_is_theirs(fly, monkeypatch: pytest.MonkeyPatch) -> None:
    """Through letting go, forgetting, laying anew and a new vehicle: losses and the regression solved."""
    met: set[str] = set()
    regressors = candidates.Candidates.regressors

    def checked(self, observations, rows):
        given = regressors(self, observations, rows)
        assert self._losses.count == observations.count
        anew = Mixer.of(observations, rows).regressors(self.mesh.center_enu_m, False)
        for one, other in zip(given, anew, strict=True):
            assert (one is None) == (other is None)
            if one is not None:
                np.testing.assert_allclose(one, other, atol=1e-4)
        now, kept = self.evidence.solved(belief.exponents), self.solved
        for name in ("constant", "slope", "curve"):
            np.testing.assert_allclose(getattr(kept, name), getattr(now, name), rtol=1e-9)
        assert kept.whitener.shape == (1 + len(belief.vehicles),) * 2
        return given

    monkeypatch.setattr(candidates.Candidates, "regressors", checked)
    for name in ("lay", "forget"):
        plain = getattr(candidates.Candidates, name)
        monkeypatch.setattr(
            candidates.Candidates, name, lambda *given, n=name, p=plain: (met.add(n), p(*given))[1]
        )
    flight = fly(np.random.default_rng(7), (1, 1, 1, 1), 90)
    belief = Belief(flight.area, PAPER, replace(SETTINGS, maximum_windows=200))
    met.clear()
    for second, windows in enumerate(flight.seconds):
        # The fourth vehicle comes late.
        belief.update(windows if second > 20 else windows[:3])
    assert met == {"lay", "forget"}
    assert belief.gone.count > 0


def test_windows_without_power_go_into_the_bearings_alone(fly) -> None:
    flight = fly(np.random.default_rng(7), (1, 1, 1, 1), 12)
    belief = Belief(flight.area, PAPER, SETTINGS)
    for windows in flight.seconds:
        belief.update([replace(window, rss_dbm=None) for window in windows])
    assert belief.evidence.count == 0
    found = belief.mass @ belief.mesh.center_enu_m
    assert np.hypot(*(found - flight.truth_enu_m)[:2]) < 10.0


def test_what_a_look_leaves_likely_more_windows_are_asked_of(fly) -> None:
    flight = fly(np.random.default_rng(7), (1, 1, 1, 1), 50)
    belief = Belief(flight.area, PAPER, SETTINGS)
    for windows in flight.seconds:
        belief.update(windows)
    asked: list[int] = []

    def told(some):
        asked.append(some.size)
        return belief._remembered(some)

    def found(field) -> bool:
        asked.clear()
        return belief._boxes.found_again(belief.log_likelihood, belief.windows, told, 4, field)

    nothing = found(lambda mesh: np.zeros(mesh.count))
    assert (nothing, asked) == (False, [-(-belief.windows // 13)])
    # Where something else makes all that were let go likely, every window is asked.
    high = belief.gone.center_enu_m[:, 2].size * [1e6]
    assert found(lambda mesh: np.array([0.0, *high[: mesh.count - 1]]))
    assert asked == [-(-belief.windows // stride) for stride in (13, 3, 1)]
