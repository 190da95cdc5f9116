"""Windows cut for training: what a sensor would have sent, of the same geometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from groundstation.channel import ChannelCapture, ChannelSettings
from groundstation.channel.preprocess import INPUT_BINS, LEAD_TAPS, network_input
from groundstation.channel.training.data import joined, read_links, read_windows

ROWS, TAPS, FIRST_PATH = 60, 512, 100


def responses() -> np.ndarray:
    rng = np.random.default_rng(3)
    delay = np.arange(TAPS) - FIRST_PATH
    envelope = np.where(delay >= 0, np.exp(-np.maximum(delay, 0) / 40), 0.0)
    return envelope * rng.rayleigh(size=(ROWS, TAPS)) + 0.005 * rng.rayleigh(size=(ROWS, TAPS))


def write(path: Path, **columns: object) -> Path:
    label = np.where(np.arange(ROWS) // 2 % 2 == 0, "LOS", "NLOS")
    base: dict[str, object] = {
        "cir_magnitude": responses(),
        "label": label,
        "log_id": np.arange(ROWS) // 2,
        "packet": np.arange(ROWS) % 2,
    }
    np.savez(path, **{**base, **columns})  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize("told", [True, False])
def test_a_window_is_cut_from_the_response_round_the_first_path(tmp_path: Path, told: bool) -> None:
    columns = {"first_path_index": np.full(ROWS, FIRST_PATH + 0.3)} if told else {}
    path = write(tmp_path / "a.npz", **columns)
    full, cut = read_links(path), read_windows(path, (64, 128, 512), 5)
    assert len(cut) == len(full) == ROWS // 2
    np.testing.assert_array_equal(cut.group, full.group)
    np.testing.assert_array_equal(cut.is_los, full.is_los)
    assert set(cut.window_taps.tolist()) == {64, 128}  # 512 taps of 512 are no window
    taps_known = np.array([1] * 96 + np.diff(np.rint(np.geomspace(80, 1024, 33))).astype(int).tolist())
    leads = set()
    for link in range(len(cut)):
        known = cut.inputs[cut.first[link], 3] == 1
        lead = int(np.count_nonzero(known[:LEAD_TAPS]))
        leads.add(lead)
        taps = int(cut.window_taps[link])
        # What the service would make of a sensor's own window, to the last bit.
        starts = [FIRST_PATH - lead + shift for shift in range(-3, 12)]
        row = responses()[2 * link]
        candidates = [
            network_input(
                ChannelCapture(row[s : s + taps], 1.0, FIRST_PATH + 0.3 - s if told else None),
                ChannelSettings(reject_noise=False),
            )
            for s in starts
        ]
        assert any(np.array_equal(cut.inputs[cut.first[link]], one) for one in candidates)
        assert abs(int(taps_known[known].sum()) - taps) < 20
    assert len(leads) > 3


def test_the_same_seed_draws_the_same_windows_and_short_responses_have_none(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npz", window_taps=np.where(np.arange(ROWS) < 20, 127, TAPS))
    first, again, other = (read_windows(path, (64, 128), seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.inputs, again.inputs)
    assert not np.array_equal(first.window_taps, other.window_taps)
    assert len(first) == 20
    assert set(first.group.tolist()) == set(range(10, 30))
    none = read_windows(write(tmp_path / "b.npz", window_taps=np.full(ROWS, 100)), (64,), 1)
    assert len(none) == 0
    assert none.inputs.shape == (0, 4, INPUT_BINS)
    assert len(joined([read_links(path), none])) == ROWS // 2


def test_a_first_path_at_the_edge_keeps_the_window_inside(tmp_path: Path) -> None:
    """The last taps are noise, which no service would judge: nothing else is lost or out of bounds."""
    begins = read_windows(write(tmp_path / "a.npz", first_path_index=np.zeros(ROWS)), (256,), 1)
    assert set(begins.window_taps.tolist()) == {256}
    assert len(begins) == ROWS // 2
    assert not begins.inputs[:, 3, :LEAD_TAPS].all()
    ends = read_windows(write(tmp_path / "b.npz", first_path_index=np.full(ROWS, TAPS - 1.0)), (256,), 1)
    assert len(ends.inputs) + sum(ends.left_out.values()) == ROWS
    assert set(ends.left_out) <= {"all noise"}
