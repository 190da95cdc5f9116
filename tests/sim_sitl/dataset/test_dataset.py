"""The data set: the paper's rows, balanced, the same bytes for the same seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from groundstation.domain.errors import InputError, UsageError
from sim_sitl.cir import Sounder
from sim_sitl.cir_encoding import CirEncoding
from sim_sitl.dataset import DatasetOptions, dataset_sounder, write_dataset
from sim_sitl.dataset.rows import _as_decoded

SMALL = Sounder(taps=128, first_path_tap=16)


@pytest.mark.parametrize("suffix", ["npz", "csv"])
@pytest.mark.parametrize("randomise", [False, True])
def test_same_seed_same_bytes_and_another_seed_others(tmp_path: Path, randomise: bool, suffix: str) -> None:
    options = DatasetOptions(SMALL, randomise=randomise)
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        write_dataset(41, seed, tmp_path / f"{name}.{suffix}", options=options)
    first, again, other = ((tmp_path / f"{name}.{suffix}").read_bytes() for name in "abc")
    assert first == again
    assert first != other
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_an_interrupted_write_leaves_nothing(tmp_path: Path, suffix: str) -> None:
    def interrupt(done: int, rows: int) -> None:
        if done >= 8:
            raise KeyboardInterrupt

    out = tmp_path / f"d.{suffix}"
    out.write_text("what was there before")
    with pytest.raises(KeyboardInterrupt):
        write_dataset(40, 1, out, interrupt, DatasetOptions(SMALL))
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    assert out.read_text() == "what was there before"


def test_csv_is_the_papers_row_and_agrees_with_the_npz(tmp_path: Path) -> None:
    for suffix in ("npz", "csv"):
        write_dataset(22, 4, tmp_path / f"d.{suffix}", options=DatasetOptions())
    header, *rows = (tmp_path / "d.csv").read_text().splitlines()
    assert header.startswith("X,Y,Z,Range,LOS,AOA,ZOA,TotalReceivedPower,LinkBudget,CIR0,CIR1,")
    assert header.endswith(",CIR1015")
    values = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    with np.load(tmp_path / "d.npz", allow_pickle=False) as data:
        names = ("x_m", "y_m", "z_m", "range_m", "los", "aoa_deg", "zoa_deg", "total_received_power_dbm")
        front = np.stack([data[name] for name in (*names, "link_budget_db")], axis=1)
        np.testing.assert_allclose(values[:, :9], front, rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(values[:, 9:], data["cir_magnitude"], rtol=1e-5)


def test_received_power_is_the_integrated_response_noise_and_all(tmp_path: Path) -> None:
    """Squares of a row, in √mW, add up to its power; far behind the last path only noise is left."""
    write_dataset(400, 2, tmp_path / "d.npz", options=DatasetOptions())
    with np.load(tmp_path / "d.npz", allow_pickle=False) as data:
        magnitude = data["cir_magnitude"].astype(np.float64)
        power_dbm = 10 * np.log10(np.sum(magnitude**2, axis=1))
        np.testing.assert_allclose(power_dbm, data["total_received_power_dbm"], atol=1e-4)
        np.testing.assert_allclose(
            data["total_received_power_dbm"] - data["transmit_power_dbm"], data["link_budget_db"], atol=1e-9
        )
        # Before the first path (tap 64) there is nothing but noise: −174 dBm/Hz, 30 dB of processing gain,
        # spread over the taps as a path of one unit is.
        spacing_ns = float(data["tap_spacing_ns"][0])
        path_energy = (1 - 0.25 / 4) / (spacing_ns * 1e-9 * 500e6)
        floor_dbm = 10 * np.log10(np.mean(magnitude[:, :8] ** 2, axis=1) * path_energy)
        weak = data["snr_db"] < 25
        assert weak.sum() > 50
        assert np.median(floor_dbm[weak]) == pytest.approx(-174 + 87 - 30, abs=0.5)


def test_equal_noise_does_not_depend_on_the_label(tmp_path: Path) -> None:
    """Or on the channel: the option changes nothing else of a row's link."""
    for name, equal in (("plain", False), ("equal", True)):
        options = DatasetOptions(SMALL, packets_per_link=1, equal_noise=equal)
        write_dataset(600, 2, tmp_path / f"{name}.npz", options=options)
    with np.load(tmp_path / "plain.npz") as plain, np.load(tmp_path / "equal.npz") as equal_noise:
        los = plain["los"] == 1
        np.testing.assert_array_equal(plain["x_m"], equal_noise["x_m"])
        assert plain["snr_db"][los].mean() > plain["snr_db"][~los].mean() + 15
        # Standard error of a difference of means: 14.4 · √(4/600) = 1.2 dB.
        assert abs(equal_noise["snr_db"][los].mean() - equal_noise["snr_db"][~los].mean()) < 4.8
    with pytest.raises(InputError, match="equal-noise"):
        DatasetOptions(randomise=True, equal_noise=True)


def test_losses_are_drawn_by_label_and_links_move(tmp_path: Path) -> None:
    write_dataset(2400, 8, tmp_path / "d.npz", options=DatasetOptions(SMALL))
    with np.load(tmp_path / "d.npz", allow_pickle=False) as data:
        los = data["los"] == 1
        assert np.all(data["foliage_db"][los] == 0)
        assert np.all(data["penetration_db"][los] == 0)
        assert data["foliage_db"][~los].max() <= 4.0
        assert data["penetration_db"][~los].mean() == pytest.approx(9.2, abs=1.0)
        # The log-distance exponents: a regression over the losses that are left, shadowing about it.
        elevation_deg = np.rad2deg(np.arcsin(data["z_m"] / data["range_m"]))
        antenna_db = np.minimum(12 * (elevation_deg / 45) ** 2, 20)
        excess_db = -data["link_budget_db"] - data["foliage_db"] - data["penetration_db"] - antenna_db
        for which, exponent in ((los, 2.0), (~los, 2.9)):
            slope = np.polyfit(10 * np.log10(data["range_m"][which]), excess_db[which], 1)[0]
            # Standard error: 7 dB (NLOS) over 2.9 dB of spread and √300 links, 0.14.
            assert slope == pytest.approx(exponent, abs=0.4)
        moving = data["target_speed_m_s"] > 0
        assert moving.mean() == pytest.approx(0.5, abs=0.08)
        steps = np.hypot(np.diff(data["x_m"]), np.diff(data["y_m"]))[data["packet"][1:] > 0]
        assert steps.max() <= 0.1 * (8.0 + 3.0) + 1e-9
        assert np.count_nonzero(data["blockage_state"]) > 0


def test_rows_are_the_papers(tmp_path: Path) -> None:
    done: list[tuple[int, int]] = []
    write_dataset(
        2000,
        3,
        tmp_path / "d.npz",
        lambda row, rows: done.append((row, rows)),
        DatasetOptions(packets_per_link=1, sounder=Sounder(taps=32, first_path_tap=8)),
    )
    assert done[-1] == (2000, 2000)
    with np.load(tmp_path / "d.npz", allow_pickle=False) as data:
        los = data["los"] == 1
        assert data["cir_magnitude"].shape == (2000, 32)
        assert np.all(np.isfinite(data["cir_magnitude"]))
        assert np.array_equal(los, data["label"] == "LOS")
        assert los.sum() == 1000
        range_m = np.sqrt(data["x_m"] ** 2 + data["y_m"] ** 2 + data["z_m"] ** 2)
        np.testing.assert_allclose(range_m, data["range_m"])
        # Standard error of a share of a half among 2,000: 1.1 %.
        assert np.mean(range_m < 100) == pytest.approx(0.5, abs=0.045)
        assert np.mean(range_m > 150) == pytest.approx(0.2, abs=0.04)
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
    write_dataset(10, 5, tmp_path / "d.npz", options=DatasetOptions(SMALL))
    with np.load(tmp_path / "d.npz") as data:
        assert list(data["log_id"]) == [0, 0, 0, 0, 1, 1, 1, 1, 2, 2]
        assert list(data["packet"]) == [0, 1, 2, 3, 0, 1, 2, 3, 0, 1]
        assert len(set(data["label"][:4])) == 1
        assert not np.array_equal(data["cir_magnitude"][0], data["cir_magnitude"][1])


def test_more_rows_leave_the_earlier_ones(tmp_path: Path) -> None:
    for rows in (8, 16):
        write_dataset(rows, 5, tmp_path / f"{rows}.npz", options=DatasetOptions(SMALL, randomise=True))
    with np.load(tmp_path / "8.npz") as few, np.load(tmp_path / "16.npz") as many:
        np.testing.assert_array_equal(few["cir_magnitude"], many["cir_magnitude"][:8])


def test_randomised_domain_does_not_give_the_label_away(tmp_path: Path) -> None:
    """What varies by link varies alike for both labels: means within four standard errors."""
    options = DatasetOptions(SMALL, packets_per_link=1, randomise=True)
    write_dataset(1000, 6, tmp_path / "d.npz", options=options)
    with np.load(tmp_path / "d.npz") as data:
        los = data["los"] == 1
        for name in ("bandwidth_hz", "tap_spacing_ns", "window_taps"):
            values = data[name].astype(float)
            error = values.std() * np.sqrt(4 / len(values))
            assert abs(values[los].mean() - values[~los].mean()) < 4 * error, name
        noiseless = np.isinf(data["snr_db"])
        assert 0.1 < noiseless.mean() < 0.4
        assert abs(noiseless[los].mean() - noiseless[~los].mean()) < 0.12
        assert np.isnan(data["first_path_index"]).mean() == pytest.approx(0.5, abs=0.065)
        assert (data["tap_spacing_ns"] == 1.0).mean() == pytest.approx(0.2, abs=0.05)
        beyond = np.arange(data["cir_magnitude"].shape[1]) >= data["window_taps"][:, None]
        assert np.all(data["cir_magnitude"][beyond] == 0)


def test_bad_requests_are_said_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least 1"):
        write_dataset(0, 1, tmp_path / "d.npz")
    with pytest.raises(UsageError, match=r"ends neither in \.npz nor in \.csv"):
        write_dataset(1, 1, tmp_path / "d.parquet")
    with pytest.raises(InputError, match="at least 1 is needed"):
        DatasetOptions(packets_per_link=0)
    with pytest.raises(InputError, match="does not exist"):
        write_dataset(1, 1, tmp_path / "nowhere" / "d.npz")


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((0.0,), "0.1 to 5000"),
        ((float("nan"),), "0.1 to 5000"),
        ((3.0, -1.0), "a positive number"),
        ((3.0, 400.0), "3 MHz need at most 1/bandwidth = 333.333 ns"),
        ((None, None, 8), "at least 16"),
    ],
)
def test_sounders_that_cannot_be_are_refused(arguments: tuple[float, ...], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        dataset_sounder(*arguments)


def test_bandwidth_and_spacing_are_options(tmp_path: Path) -> None:
    assert dataset_sounder() == dataset_sounder(500.0, 1.0016)
    assert dataset_sounder(100.0).tap_spacing_ns == pytest.approx(5.008, rel=1e-3)
    paper = DatasetOptions(dataset_sounder(3.0, 333.0, taps=64))
    write_dataset(16, 1, tmp_path / "d.npz", options=paper)
    with np.load(tmp_path / "d.npz") as data:
        assert set(data["tap_spacing_ns"]) == {333.0}
        assert set(data["bandwidth_hz"]) == {3e6}
        # Unresolved: all of a line of sight lies within two taps.
        magnitude = data["cir_magnitude"][data["los"] == 1].astype(float)
        largest = np.sort(magnitude**2, axis=1)[:, ::-1]
        assert np.all(largest[:, :3].sum(axis=1) > 0.8 * largest.sum(axis=1))


@pytest.mark.parametrize("encoding", [None, *CirEncoding])
def test_what_the_wire_carries_is_decoded_as_it_was_sent(encoding: CirEncoding | None) -> None:
    given = np.array([0.2, 4.0j, 1.0, 0.1])
    decoded = _as_decoded(given, encoding)
    np.testing.assert_allclose(decoded / decoded.max(), np.abs(given) / 4.0, atol=0.005)
