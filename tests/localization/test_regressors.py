"""Losses kept and losses worked out anew are the same regression."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.localization import SignalModel, regressors
from groundstation.localization.regression import Evidence
from groundstation.localization.regressors import Losses, Mixer
from groundstation.localization.whitening import Observations, Whitened, informative_parents, whiten_rows

MODEL = SignalModel(nlos_rss_std_db=5.0, shared_shadowing=0.5)
CORRELATION_M = 25.0
RNG = np.random.default_rng(5)
CANDIDATES = RNG.uniform(-80.0, 80.0, (37, 3)) * [1.0, 1.0, 0.1]


def seen(count: int, los: float | None = None) -> Observations:
    """Windows of three vehicles, each conditioned on those that foretell most of it; ``los`` None: mixed."""
    rng = np.random.default_rng(6)
    nothing = np.full(count, np.nan)
    plain = Observations(
        rng.uniform(-90.0, 90.0, (count, 3)) * [1.0, 1.0, 0.2] + [0.0, 0.0, 50.0],
        np.arange(count) % 3,
        rng.normal(-60.0, 4.0, count),
        rng.choice([0.0, 0.3, 1.0], count) if los is None else np.full(count, los),
        np.full(count, 0.5),
        nothing,
        nothing,
        np.full((count, 2), 0.02),
        np.zeros(count),
        np.ones(count),
        np.full((count, 0), -1),
        np.zeros((count, 2)),
    )
    return replace(plain, parents=parents_of(plain, np.arange(count)))


def parents_of(plain: Observations, rows: np.ndarray) -> np.ndarray:
    usable = np.arange(plain.count) < rows[:, None]
    return np.asarray(informative_parents(plain, rows, usable, 4, CORRELATION_M, MODEL))


def whitened(told: Observations, rows: np.ndarray) -> Whitened:
    return whiten_rows(told, rows, 3, CORRELATION_M, MODEL)


@pytest.mark.parametrize("null", [False, True])
@pytest.mark.parametrize("los", [None, 0.0, 1.0])
def test_kept_losses_give_the_regressors_of_losses_worked_out_anew(los: float | None, null: bool) -> None:
    told = seen(40, los)
    rows = whitened(told, np.arange(30, 40))
    losses = Losses(CANDIDATES, null)
    losses.add(told.position_enu_m)
    kept, anew = losses.regressors(told, rows), Mixer.of(told, rows).regressors(CANDIDATES, null)
    # What is zero everywhere is left out by both.
    expected = [los != 0.0, los != 1.0, null]
    assert [part is not None for part in kept] == [part is not None for part in anew] == expected
    for one, other in zip(kept, anew, strict=True):
        if one is not None and other is not None:
            assert one.dtype == np.float64
            np.testing.assert_allclose(one, other, atol=2e-5)


def test_it_does_not_matter_which_windows_come_together_nor_where_room_was_left() -> None:
    """A session taken up again works them all out at once: to the last bit what was kept before."""
    told = seen(60)
    alone = Losses(CANDIDATES, True)
    for place in told.position_enu_m[:40]:
        alone.add(place[None])
    dropped = np.arange(1, 30, 2)
    left = told.take(np.delete(np.arange(60), dropped))
    left = replace(left, parents=parents_of(left, np.arange(left.count)))
    alone.forget(dropped)
    room = alone._kept.shape
    alone.add(left.position_enu_m[alone.count :][:5])
    alone.add(left.position_enu_m[alone.count :])
    # What was forgotten makes room.
    assert alone._kept.shape == room
    together = Losses(CANDIDATES, True)
    together.add(left.position_enu_m)
    assert alone.count == together.count == left.count
    rows = whitened(left, np.arange(left.count))
    for one, other in zip(alone.regressors(left, rows), together.regressors(left, rows), strict=True):
        np.testing.assert_array_equal(one, other)


def test_how_many_losses_are_worked_out_at_once_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    told = seen(40)
    rows = whitened(told, np.arange(20, 40))
    found = []
    for block in (1, 150, 48_000):
        monkeypatch.setattr(regressors, "_BLOCK", block)
        losses = Losses(CANDIDATES, True)
        losses.add(told.position_enu_m)
        found.append((losses.regressors(told, rows), Mixer.of(told, rows).regressors(CANDIDATES, True)))
    for kept, anew in found[1:]:
        for one, other in zip((*kept, *anew), (*found[0][0], *found[0][1]), strict=True):
            np.testing.assert_allclose(one, other, atol=2e-5)


def test_regressors_taken_in_are_the_rows_taken_in() -> None:
    told = seen(40)
    rows = whitened(told, np.arange(40))
    losses = Losses(CANDIDATES, True)
    losses.add(told.position_enu_m)
    one, other = Evidence.empty(len(CANDIDATES), 3), Evidence.empty(len(CANDIDATES), 3)
    one.add(told, rows, CANDIDATES, True)
    other.add_regressors(rows, losses.regressors(told, rows))
    for name, value in one.state().items():
        np.testing.assert_allclose(value, other.state()[name], rtol=1e-5, atol=1e-3, err_msg=name)


def test_no_rows_are_nothing() -> None:
    told = seen(5)
    rows = whitened(told, np.zeros(0, dtype=np.int64))
    losses = Losses(CANDIDATES, True)
    losses.add(told.position_enu_m)
    assert losses.regressors(told, rows) == (None, None, None)
    evidence = Evidence.empty(len(CANDIDATES), 3)
    evidence.add_regressors(rows, (None, None, None))
    assert evidence.count == 0
