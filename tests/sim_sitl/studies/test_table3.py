"""Table III and the bandwidth study in miniature: what they write, and that it can be had again."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from groundstation.domain.errors import UsageError

pytest.importorskip("torch")
pytest.importorskip("sklearn")
pytest.importorskip("matplotlib")

from sim_sitl.studies import bandwidth, table3
from sim_sitl.studies.commands import StudyOptions

pytestmark = pytest.mark.train


def options(
    out: Path, name: str = "table3", trials: int = 240, methods: tuple[str, ...] = ()
) -> StudyOptions:
    return StudyOptions(name, trials, 3, out, methods=methods)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], list[tuple[int, int]]]:
    told: list[tuple[int, int]] = []
    out = tmp_path_factory.mktemp("table3")
    files = table3.run(options(out), lambda done, total: told.append((done, total)), epochs=1, splits=2)
    return files, told


def test_files_and_progress(made: tuple[list[Path], list[tuple[int, int]]]) -> None:
    files, told = made
    assert [path.name for path in files] == [
        "table3.md", "table3.csv", "table3-profile.csv", "table3-geometry.png",
    ]  # fmt: skip
    assert all(path.stat().st_size > 0 for path in files)
    done = [count for count, _ in told]
    assert done == sorted(done)
    assert told[-1][0] == told[-1][1]
    assert len({total for _, total in told}) == 1


def test_every_classifier_is_given_the_same_captures(made: tuple[list[Path], list[tuple[int, int]]]) -> None:
    rows = rows_of(made[0][1])
    assert {row["section"] for row in rows} == {
        "geometry", "row", "unscaled", "equal-noise", "3mhz", "3mhz-unscaled",
    }  # fmt: skip
    for section in {row["section"] for row in rows}:
        for instance in ("capture", "link"):
            here = [row for row in rows if (row["section"], row["instance"]) == (section, instance)]
            assert len({row["tested"] for row in here}) <= 1
    geometry = {
        row["method"]: row for row in rows if (row["section"], row["instance"]) == ("geometry", "capture")
    }
    assert {"RF", "GPC", "SVM", "CNN–LSTM"} <= geometry.keys()
    # Two splits of twelve of sixty links with four captures each.
    assert geometry["RF"]["tested"] == str(2 * 12 * 4)
    counts = [
        int(geometry["RF"][f"{was}_called_{called}_count"])
        for was in ("los", "nlos")
        for called in ("los", "nlos")
    ]
    assert sum(counts) == 2 * 12 * 4
    assert float(geometry["RF"]["accuracy"]) == pytest.approx((counts[0] + counts[3]) / sum(counts), abs=1e-6)
    assert float(geometry["RF"]["auc"]) > 0.75


def test_the_papers_figures_stand_beside_like_alone(made: tuple[list[Path], list[tuple[int, int]]]) -> None:
    rows = rows_of(made[0][1])
    beside = {row["method"]: row["paper_accuracy"] for row in rows if row["paper_accuracy"]}
    assert beside == {"RF": "0.9519", "GPC": "0.7124", "SVM": "0.7001", "CNN–LSTM": "0.929"}
    assert {row["section"] for row in rows if row["paper_accuracy"]} == {"geometry"}
    report = made[0][0].read_text(encoding="utf-8")
    for figure in ("0.9519", "0.7124", "0.7001", "0.9290", "0.9696", "6.7676"):
        assert figure in report


def test_the_same_seed_gives_the_same_figures(
    tmp_path: Path, made: tuple[list[Path], list[tuple[int, int]]]
) -> None:
    table3.run(options(tmp_path, methods=("RF", "SVM")), epochs=1, splits=2)
    again = rows_of(tmp_path / "table3.csv")
    assert again == [row for row in rows_of(made[0][1]) if row["method"] in {"RF", "SVM"}]


@pytest.mark.parametrize("run", [table3.run, bandwidth.run])
def test_too_few_rows_and_a_cluster_are_refused(run: Callable[..., object], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="200 or more"):
        run(options(tmp_path / "x", trials=100))
    with pytest.raises(UsageError, match="this machine"):
        run(StudyOptions("table3", 400, 1, tmp_path / "x", scheduler="tcp://nowhere:1"))
    assert not (tmp_path / "x").exists()
    with pytest.raises(UsageError, match="asked for: nobody"):
        table3.run(options(tmp_path / "x", methods=("nobody",)))


def test_bandwidth_counts_bytes_as_the_wire_does(tmp_path: Path) -> None:
    files = bandwidth.run(options(tmp_path, "bandwidth"), epochs=1)
    assert [path.name for path in files] == ["bandwidth.md", "bandwidth.csv", "bandwidth.png"]
    rows = rows_of(files[1])
    sizes = {(row["window_taps"], row["packets"]): int(row["bytes_per_link"]) for row in rows}
    # A frame of 64 taps has 116 bytes; the full response is five frames of 1,016 + 5 · 52.
    assert sizes["64", "1"] == 116
    assert sizes["1016", "1"] == 1276
    assert sizes["1016", "4"] == 4 * 1276
    assert {row["frames_a_packet"] for row in rows if row["window_taps"] == "1016"} == {"5"}
    assert {float(row["auc_loss"]) for row in rows if row["window_taps"] == "1016"} == {0.0}
    for row in rows:
        assert float(row["auc_low"]) <= float(row["auc"]) <= float(row["auc_high"])
    assert len(rows) == 3 * 5 * 3
    assert np.mean([float(row["auc"]) for row in rows if row["classifier"].startswith("RF")]) > 0.6


def test_windows_are_decoded_as_they_were_sent() -> None:
    given = np.array([0.2, 4.0, 1.0, 0.02, 1e-7], np.float32)
    below_db = -20 * np.log10(bandwidth._decoded(given))
    np.testing.assert_allclose(below_db, [26.0, 0.0, 12.0, 46.0, 63.75], atol=0.13)
