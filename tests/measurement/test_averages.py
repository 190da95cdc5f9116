"""Averages against closed forms and repetition."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.measurement.angles import IDENTITY
from groundstation.measurement.averages import mean_bearing, mean_position, mean_power, middle_attitude
from groundstation.measurement.pose_history import Pose


def test_power_is_averaged_in_milliwatts():
    """−70 and −80 dBm: (1e-7 + 1e-8)/2 mW is −72.596 dBm; the mean of decibels would say −75."""
    mean, error = mean_power([-70.0, -80.0])
    assert mean == pytest.approx(10 * math.log10(5.5e-8))
    # s = 6.364e-8, s/√2 = 4.5e-8; 4.343 · 4.5/5.5 dB.
    assert error == pytest.approx(4.342945 * 4.5 / 5.5, rel=1e-6)


@given(levels=st.lists(st.floats(-150, 30), min_size=2, max_size=30))
def test_mean_power_lies_between_the_levels(levels):
    mean, error = mean_power(levels)
    assert mean is not None
    assert error is not None
    assert min(levels) - 1e-9 <= mean <= max(levels) + 1e-9
    assert error >= 0.0


def test_standard_error_in_decibels_matches_repetition():
    """Rayleigh fading: exponential powers, 16 a window; the spread of window means is the error."""
    rng = np.random.default_rng(1)
    levels = 10 * np.log10(rng.exponential(1e-8, (4000, 16)))
    answers = [mean_power([float(x) for x in row]) for row in levels]
    spread = np.std([mean for mean, _ in answers])
    assert np.mean([error for _, error in answers]) == pytest.approx(spread, rel=0.12)


def test_no_and_one_level():
    assert mean_power([]) == (None, None)
    assert mean_power([-80.0]) == (pytest.approx(-80.0), None)


def test_azimuths_are_averaged_across_the_cut():
    rows = [(math.pi - 0.1, 0.0, 0.05, 0.05), (-math.pi + 0.1, 0.2, 0.05, 0.05)]
    azimuth, _, elevation, _ = mean_bearing(rows, 0.1)
    assert abs(azimuth) == pytest.approx(math.pi)
    assert elevation == pytest.approx(0.1)


@given(
    centre=st.floats(-math.pi, math.pi),
    away=st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=16),
    turn=st.floats(-math.pi, math.pi),
)
def test_turning_all_azimuths_turns_the_mean(centre, away, turn):
    here = mean_bearing([(centre + d, -0.3, 0.01, 0.01) for d in away], 0.1)
    there = mean_bearing([(centre + d + turn, -0.3, 0.01, 0.01) for d in away], 0.1)
    assert math.remainder(there[0] - here[0] - turn, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert there[1] == pytest.approx(here[1], abs=1e-9)
    assert abs(math.remainder(here[0] - centre, 2 * math.pi)) <= 0.5 + 1e-9


def test_azimuth_scatter_does_not_bias_the_elevation():
    rng = np.random.default_rng(2)
    rows = [(float(a), -0.8, None, None) for a in rng.normal(1.0, 0.3, 400)]
    assert mean_bearing(rows, 0.1)[2] == pytest.approx(-0.8)


def test_the_angle_error_is_the_larger_of_scatter_and_report_over_root_n():
    agreeing = [(1.0, -0.5, 0.04, 0.02)] * 16
    _, azimuth_error, _, elevation_error = mean_bearing(agreeing, 0.1)
    assert azimuth_error == pytest.approx(0.01)
    assert elevation_error == pytest.approx(0.005)
    flattering = [(1.0 + d, -0.5, 0.001, 0.001) for d in (-0.1, 0.1) * 8]
    assert mean_bearing(flattering, 0.1)[1] == pytest.approx(0.1 * math.sqrt(16 / 15) / 4)


def test_an_unreported_single_angle_takes_the_default():
    assert mean_bearing([(1.0, -0.5, None, None)], 0.175)[1] == pytest.approx(0.175)


def test_azimuths_that_cancel_out_are_admitted_to_be_worthless():
    rows = [(a, -1.5, 0.01, 0.01) for a in (0.0, math.pi / 2, math.pi, -math.pi / 2)]
    assert mean_bearing(rows, 0.1)[1] == math.pi


def test_mean_position_across_the_date_line():
    place = mean_position([Pose(10.0, 179.9999, 5.0, None), Pose(10.0, -179.9997, 7.0, None)])
    assert place.longitude_deg == pytest.approx(-179.9999)
    assert place.altitude_amsl_m == pytest.approx(6.0)


def test_a_window_without_attitudes_is_level():
    assert middle_attitude([(0, Pose(47.0, 8.0, 5.0, None))], 0) == IDENTITY
