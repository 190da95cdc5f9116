"""What ``sim-sitl dataset`` writes, ``groundstation train`` reads: both formats alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from groundstation.channel.training.data import read_links
from sim_sitl.dataset import DatasetOptions, dataset_sounder, write_dataset


def test_both_formats_are_read_alike(tmp_path: Path) -> None:
    options = DatasetOptions(dataset_sounder(taps=256))
    for suffix in ("npz", "csv"):
        write_dataset(120, 3, tmp_path / f"d.{suffix}", options=options)
    npz = read_links(tmp_path / "d.npz", with_features=True)
    csv = read_links(tmp_path / "d.csv", with_features=True, tap_spacing_ns=1.0016)
    # The CSV has no log_id: a link's captures are told by their positions.
    assert npz.grouped
    assert csv.grouped
    for name in ("is_los", "packets", "first", "group"):
        np.testing.assert_array_equal(getattr(npz, name), getattr(csv, name))
    assert npz.features is not None
    assert csv.features is not None
    np.testing.assert_allclose(npz.features, csv.features, rtol=2e-3, atol=1e-5)


def test_randomised_data_can_be_read(tmp_path: Path) -> None:
    write_dataset(200, 3, tmp_path / "d.npz", options=DatasetOptions(randomise=True))
    data = read_links(tmp_path / "d.npz")
    assert data.grouped
    assert 0.4 < np.mean(data.is_los) < 0.6
    assert len(data.inputs) + sum(data.left_out.values()) == 200
    assert len(np.unique(data.window_taps)) > 3
