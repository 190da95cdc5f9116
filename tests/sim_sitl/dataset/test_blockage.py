"""The blocker: its chain against its rates, its depth against the diffraction integral's limits."""

from __future__ import annotations

import numpy as np
import pytest

from sim_sitl.dataset.blockage import RATES_PER_S, UNSHADOWED, draw_blockage, screen_loss_db


def test_states_are_as_frequent_as_their_stays_are_long() -> None:
    rng = np.random.default_rng(1)
    states = np.concatenate([draw_blockage(rng, np.zeros(1), 4).state for _ in range(4000)])
    stay_s = 1 / np.array(RATES_PER_S)
    expected = stay_s / stay_s.sum()
    # Four captures of a chain count for little more than one: four standard errors of 4,000.
    for state in range(4):
        error = np.sqrt(expected[state] * (1 - expected[state]) / 4000)
        assert np.mean(states == state) == pytest.approx(expected[state], abs=4 * error)


def test_an_unshadowed_link_loses_nothing_and_a_shadowed_one_by_direction() -> None:
    rng = np.random.default_rng(2)
    azimuth = np.linspace(-np.pi, np.pi, 73)
    blockages = [draw_blockage(rng, azimuth, 4) for _ in range(300)]
    assert all(np.all(b.loss_db[b.state == UNSHADOWED] == 0) for b in blockages)
    deepest = max(float(b.loss_db.max()) for b in blockages)
    assert 3 < deepest < 15
    # Nobody stands on all sides at once.
    assert all(
        np.count_nonzero(b.loss_db.max(axis=0) > 0.5 * b.loss_db.max()) < 40
        for b in blockages
        if b.loss_db.any()
    )


def test_depth_has_the_limits_of_the_knife_edge() -> None:
    def depth(
        width_m: float, above_m: float = 1.6, distance_m: float = 1.0, offset_rad: float = 0.0
    ) -> float:
        return float(screen_loss_db(np.array([offset_rad]), distance_m, width_m, above_m)[0])

    # A screen without width casts no shadow; a wide one a deep shadow; 2 dB for a person at 1 m.
    assert depth(1e-9) == pytest.approx(0, abs=1e-3)
    assert depth(0.3) == pytest.approx(2.3, abs=0.5)
    assert depth(0.3) < depth(0.6) < depth(6.0)
    assert depth(0.3, distance_m=0.3) > depth(0.3, distance_m=3.0)
    # The edge of a half plane in the ray's own line halves the field.
    half = screen_loss_db(np.array([np.arctan2(50.0, 1.0)]), float(np.hypot(50.0, 1.0)), 100.0, 1e6)
    upright = 20 * np.log10(1 - 0.5 * (0.5 + 0.39))
    assert -float(half[0]) == pytest.approx(upright, abs=0.7)
    # Behind the beacon, and far to the side, nothing.
    assert depth(0.5, offset_rad=np.pi) == 0
    assert depth(0.3, offset_rad=1.2) < 0.5
