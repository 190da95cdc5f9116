"""The cluster model against its table, its physics against closed forms."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from sim_sitl.cir import (
    LOS_TABLE,
    NLOS_TABLE,
    SPEED_OF_LIGHT_M_S,
    ClusterChannel,
    band_limited_noise,
    draw_channel,
)

FREQUENCY_HZ = 867.5e6
DRAWS = 4000


def draw(line_of_sight: bool, count: int = DRAWS, seed: int = 7) -> list[ClusterChannel]:
    rng = np.random.default_rng(seed)
    return [draw_channel(rng, line_of_sight=line_of_sight, frequency_hz=FREQUENCY_HZ) for _ in range(count)]


@pytest.fixture(scope="module", params=[True, False], ids=["los", "nlos"])
def channels(request: pytest.FixtureRequest) -> list[ClusterChannel]:
    return draw(request.param)


def test_counts_are_discrete_uniform(channels: list[ClusterChannel]) -> None:
    clusters = np.array([channel.cluster[-1] + 1 for channel in channels])
    subpaths = np.concatenate([np.bincount(channel.cluster) for channel in channels])
    assert (clusters.min(), clusters.max()) == (1, 6)
    assert (subpaths.min(), subpaths.max()) == (1, 30)
    # Standard errors: 1.71/√4000 = 0.027 and 8.66/√14000 = 0.073; four of them allowed.
    assert clusters.mean() == pytest.approx(3.5, abs=0.11)
    assert subpaths.mean() == pytest.approx(15.5, abs=0.3)


def test_gaps_between_clusters_have_the_tables_mean(channels: list[ClusterChannel]) -> None:
    """Δτ = sort(Exp(μ)) − min: all n have mean μ and the least μ/n, so the n − 1 gaps above it average μ."""
    gaps = []
    for channel in channels:
        starts = np.searchsorted(channel.cluster, np.arange(channel.cluster[-1] + 1))
        for before, start in itertools.pairwise(starts):
            last = channel.delay_ns[start - 1]
            assert last >= channel.delay_ns[before]
            gaps.append(channel.delay_ns[start] - last - 25.0)
    mean_ns = channels[0].table.inter_cluster_delay_ns
    assert min(gaps) >= -1e-9
    assert np.mean(gaps) == pytest.approx(mean_ns, rel=0.05)


def test_excess_exponent_is_uniform_up_to_the_tables_maximum(channels: list[ClusterChannel]) -> None:
    exponent = [
        np.log(channel.within_cluster_ns[1]) / np.log(2.5) - 1
        for channel in channels
        if channel.within_cluster_ns[1:2].any()
    ]
    maximum = channels[0].table.excess_exponent_max
    assert min(exponent) >= -1e-9
    assert max(exponent) <= maximum + 1e-9
    assert np.mean(exponent) == pytest.approx(maximum / 2, rel=0.05)


def test_powers_sum_to_one_and_cluster_decay_is_the_tables(channels: list[ClusterChannel]) -> None:
    """Regression of ln(cluster power ratio to the first) on the delay gives −1/Γ."""
    delay, log_ratio = [], []
    for channel in channels:
        assert channel.power.sum() == pytest.approx(1.0)
        cluster_power = np.bincount(channel.cluster, weights=channel.power)
        starts = np.searchsorted(channel.cluster, np.arange(len(cluster_power)))
        delay.append(channel.delay_ns[starts[1:]])
        log_ratio.append(np.log(cluster_power[1:] / cluster_power[0]))
    x, y = np.concatenate(delay), np.concatenate(log_ratio)
    slope = np.polyfit(x, y, 1)[0]
    assert -1 / slope == pytest.approx(channels[0].table.cluster_decay_ns, rel=0.03)
    # Both clusters of a ratio are shadowed independently.
    spread_db = np.std(y - slope * x) * 10 / np.log(10)
    assert spread_db == pytest.approx(np.sqrt(2) * channels[0].table.cluster_sigma_db, rel=0.1)


def test_subpath_decay_is_the_tables_without_line_of_sight() -> None:
    delay, log_ratio = [], []
    for channel in draw(False):
        own = channel.cluster == 0
        delay.append(channel.within_cluster_ns[own])
        log_ratio.append(np.log(channel.power[own] / channel.power[0]))
    x, y = np.concatenate(delay), np.concatenate(log_ratio)
    slope = np.polyfit(x[x < 200], y[x < 200], 1)[0]
    assert -1 / slope == pytest.approx(NLOS_TABLE.subpath_decay_ns, rel=0.05)


def test_strongest_subpath_of_the_first_cluster_comes_first_in_line_of_sight_only() -> None:
    def share(channels: list[ClusterChannel]) -> float:
        return float(np.mean([np.argmax(channel.power[channel.cluster == 0]) == 0 for channel in channels]))

    assert share(draw(True, 500)) == 1.0
    assert share(draw(False, 500)) < 0.7


def test_a_single_path_is_the_pulse_at_its_tap() -> None:
    rng = np.random.default_rng(1)
    channel = next(
        c
        for c in (draw_channel(rng, line_of_sight=True, frequency_hz=1e9) for _ in range(5000))
        if len(c.delay_ns) == 1
    )
    response = channel.impulse_response(
        taps=128, tap_spacing_ns=2.0, bandwidth_hz=500e6, first_path_tap=40.0, snr_db=300, rng=rng
    )
    # At 1/bandwidth a tap Nyquist's criterion holds: one tap of one, zeros elsewhere.
    assert np.abs(response[40]) == pytest.approx(1.0)
    assert np.abs(np.delete(response, 40)).max() < 1e-12


def test_response_keeps_the_energy_of_the_paths() -> None:
    """Mean over channels of Σ|h|² times the raised cosine's ∫g² = (1 − α/4)/B, taps within the window."""
    rng = np.random.default_rng(2)
    energy = []
    for channel in draw(True, 300):
        response = channel.impulse_response(
            taps=2048, tap_spacing_ns=1.0, bandwidth_hz=500e6, first_path_tap=100.3, snr_db=300, rng=rng
        )
        energy.append(np.sum(np.abs(response) ** 2) * 1e-9 * 500e6)
    assert np.mean(energy) == pytest.approx(1 - 0.25 / 4, rel=0.05)


def test_noise_has_the_power_asked_for() -> None:
    rng = np.random.default_rng(3)
    for spacing_ns in (0.5, 1.0016, 3.0):
        noise = band_limited_noise(50_000, spacing_ns, 500e6, rng)
        assert np.mean(np.abs(noise) ** 2) == pytest.approx(1.0, rel=0.05)


def test_movement_turns_phases_by_direction_and_evolves_slowly() -> None:
    rng = np.random.default_rng(4)
    channel = draw_channel(
        rng, line_of_sight=True, frequency_hz=FREQUENCY_HZ, first_path_direction_enu=np.array([2.0, 0, 0])
    )
    assert channel.moved(rng, np.zeros(3)) is channel
    step_m = 0.01
    near = channel.moved(rng, np.array([step_m, 0, 0]))
    turned = np.mod(near.phase_rad[0] - channel.phase_rad[0], 2 * np.pi)
    assert turned == pytest.approx(2 * np.pi * FREQUENCY_HZ / SPEED_OF_LIGHT_M_S * step_m)
    assert np.array_equal(near.delay_ns, channel.delay_ns)

    def deviate_correlation(distance_m: float) -> float:
        pairs = [
            (c.subpath_deviate, c.moved(rng, np.array([0, distance_m, 0])).subpath_deviate)
            for c in draw(False, 200)
        ]
        before, after = (np.concatenate(part) for part in zip(*pairs, strict=True))
        assert after.std() == pytest.approx(1.0, abs=0.05)
        return float(np.corrcoef(before, after)[0, 1])

    assert deviate_correlation(12.0) == pytest.approx(np.exp(-1), abs=0.05)
    assert deviate_correlation(0.1) > 0.98


def test_consecutive_captures_are_alike_but_not_equal() -> None:
    rng = np.random.default_rng(5)

    def capture(channel: ClusterChannel) -> np.ndarray:
        return np.abs(
            channel.impulse_response(
                taps=64, tap_spacing_ns=1.0016, bandwidth_hz=500e6, first_path_tap=8.0, snr_db=25, rng=rng
            )
        )

    same, other = [], []
    for channel in draw(False, 100):
        first, second = capture(channel), capture(channel.moved(rng, np.array([0.03, 0, 0])))
        assert not np.array_equal(first, second)
        same.append(np.corrcoef(first, second)[0, 1])
        stranger = capture(draw_channel(rng, line_of_sight=False, frequency_hz=FREQUENCY_HZ))
        other.append(np.corrcoef(first, stranger)[0, 1])
    assert np.mean(same) > np.mean(other) + 0.15


def test_same_seed_same_channel() -> None:
    first, second = draw(True, 3), draw(True, 3)
    for a, b in zip(first, second, strict=True):
        assert np.array_equal(a.power, b.power)
    assert LOS_TABLE != NLOS_TABLE
