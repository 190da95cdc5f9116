"""The data set: the paper's rows, balanced, the same bytes for the same seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from groundstation.domain.errors import InputError
from sim_sitl.cir import Sounder
from sim_sitl.dataset import DatasetOptions, write_dataset


@pytest.mark.parametrize("randomise", [False, True])
def test_same_seed_same_bytes_and_another_seed_others(tmp_path: Path, randomise: bool) -> None:
    options = DatasetOptions(randomise=randomise)
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        write_dataset(41, seed, tmp_path / f"{name}.npz", options=options)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert (tmp_path / "a.npz").read_bytes() != (tmp_path / "c.npz").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "b.npz", "c.npz"]


def test_rows_are_the_papers(tmp_path: Path) -> None:
    done: list[tuple[int, int]] = []
    write_dataset(
        4000,
        3,
        tmp_path / "d.npz",
        lambda row, rows: done.append((row, rows)),
        DatasetOptions(packets_per_link=1, sounder=Sounder(taps=32, first_path_tap=8)),
    )
    assert done[-1] == (4000, 4000)
    with np.load(tmp_path / "d.npz", allow_pickle=False) as data:
        los = data["los"] == 1
        assert data["cir_magnitude"].shape == (4000, 32)
        assert np.all(np.isfinite(data["cir_magnitude"]))
        assert np.array_equal(los, data["label"] == "LOS")
        assert los.sum() == 2000
        range_m = np.sqrt(data["x_m"] ** 2 + data["y_m"] ** 2 + data["z_m"] ** 2)
        np.testing.assert_allclose(range_m, data["range_m"])
        # Standard error of a share of a half among 4,000: 0.8 %.
        assert np.mean(range_m < 100) == pytest.approx(0.5, abs=0.03)
        assert np.mean(range_m > 150) == pytest.approx(0.2, abs=0.03)
        assert data["z_m"].min() >= 0
        assert data["z_m"].max() <= 20
        power_dbm = data["total_received_power_dbm"] - data["link_budget_db"]
        assert power_dbm.min() >= 13
        assert power_dbm.max() <= 18
        assert np.all(data["aoa_deg"][~los] == 0)
        assert np.all(data["zoa_deg"][~los] == 0)
        assert np.array_equal(data["aoa_deg"], np.rint(data["aoa_deg"]))
        # Seen from a vehicle above, the beacon at the origin is below the horizon.
        assert np.all(data["zoa_deg"][los] >= 90)
        azimuth_rad = np.deg2rad(data["aoa_deg"][los])
        towards = -np.stack([data["x_m"], data["y_m"]], 1)[los]
        cosine = np.sum(towards * np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], 1), 1)
        assert np.all(cosine / np.linalg.norm(towards, axis=1) > np.cos(np.deg2rad(0.51)))


def test_captures_of_a_link_share_geometry_and_differ(tmp_path: Path) -> None:
    write_dataset(10, 5, tmp_path / "d.npz", options=DatasetOptions(packets_per_link=4))
    with np.load(tmp_path / "d.npz") as data:
        assert list(data["log_id"]) == [0, 0, 0, 0, 1, 1, 1, 1, 2, 2]
        assert list(data["packet"]) == [0, 1, 2, 3, 0, 1, 2, 3, 0, 1]
        assert len(set(data["label"][:4])) == 1
        assert not np.array_equal(data["cir_magnitude"][0], data["cir_magnitude"][1])


def test_more_rows_leave_the_earlier_ones(tmp_path: Path) -> None:
    for rows in (8, 16):
        write_dataset(rows, 5, tmp_path / f"{rows}.npz", options=DatasetOptions(randomise=True))
    with np.load(tmp_path / "8.npz") as few, np.load(tmp_path / "16.npz") as many:
        np.testing.assert_array_equal(few["cir_magnitude"], many["cir_magnitude"][:8])


def test_randomised_domain_does_not_give_the_label_away(tmp_path: Path) -> None:
    """What varies by link varies alike for both labels: means within four standard errors."""
    write_dataset(1600, 6, tmp_path / "d.npz", options=DatasetOptions(packets_per_link=1, randomise=True))
    with np.load(tmp_path / "d.npz") as data:
        los = data["los"] == 1
        for name in ("bandwidth_hz", "tap_spacing_ns", "window_taps"):
            values = data[name].astype(float)
            error = values.std() * np.sqrt(4 / len(values))
            assert abs(values[los].mean() - values[~los].mean()) < 4 * error, name
        assert np.isnan(data["first_path_index"]).mean() == pytest.approx(0.5, abs=0.06)
        beyond = np.arange(data["cir_magnitude"].shape[1]) >= data["window_taps"][:, None]
        assert np.all(data["cir_magnitude"][beyond] == 0)


def test_bad_requests_are_said_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least 1"):
        write_dataset(0, 1, tmp_path / "d.npz")
    with pytest.raises(InputError, match="does not exist"):
        write_dataset(1, 1, tmp_path / "nowhere" / "d.npz")
