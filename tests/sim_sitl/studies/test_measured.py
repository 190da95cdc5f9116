"""Study of a user's measured logs: paired figures over logs, clear refusals."""

from __future__ import annotations

import csv
import importlib.util
from pathlib import Path

import numpy as np
import pytest

from groundstation.channel.training.data import read_links
from groundstation.channel.training.metrics import auc, figures
from groundstation.domain.errors import InputError, UsageError
from sim_sitl.studies import measured
from sim_sitl.studies.commands import StudyOptions, run_study

pytestmark = [
    pytest.mark.train,
    pytest.mark.skipif(
        any(importlib.util.find_spec(name) is None for name in ("torch", "sklearn", "matplotlib")),
        reason="needs the train and study extras",
    ),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
]
LOGS, LOS_LOGS, SOUNDINGS = 12, 5, 6


def write_logs(path: Path, *, named: bool = True, los_logs: int = LOS_LOGS) -> Path:
    """Twelve static channels, six soundings each; half of the NLOS ones look like the others."""
    rng = np.random.default_rng(8)
    rows = []
    for log in range(LOGS):
        delay = np.arange(96) - 20
        strong = log < LOS_LOGS or log % 2 == 0
        tail = np.where(delay >= 0, np.exp(-np.maximum(delay, 0) / (16 if strong else 50)), 0)
        field = (rng.standard_normal(96) + 1j * rng.standard_normal(96)) * np.sqrt(0.5 * tail)
        field *= 0.4 if strong else 1.0
        field[20] += 1.0 if strong else 0.0
        noise = rng.standard_normal((SOUNDINGS, 96)) + 1j * rng.standard_normal((SOUNDINGS, 96))
        rows.append(np.abs(field + 0.01 * noise))
    log_id = np.repeat(np.arange(LOGS), SOUNDINGS)
    fields = {"log_id": log_id} if named else {}
    label = np.where(log_id < los_logs, "LOS", "NLOS")
    np.savez(path, cir_magnitude=np.concatenate(rows), label=label, **fields)  # type: ignore[arg-type]
    return path


def options(out: Path, **changes: object) -> StudyOptions:
    given: dict[str, object] = {"name": "measured", "trials": 1, "seed": 1, "out": out, **changes}
    return StudyOptions(**given)  # type: ignore[arg-type]


def test_figures_and_files(tmp_path: Path) -> None:
    data = write_logs(tmp_path / "logs.npz")
    names = (measured.TRAINED, measured.PULSE, measured.TREES[1])
    seen: list[tuple[int, int]] = []
    files = run_study(
        options(tmp_path / "out", data=data, methods=names), lambda done, total: seen.append((done, total))
    )
    assert [path.name for path in files] == [
        "measured.md", "measured.csv", "measured-curve.csv", "measured.png",
    ]  # fmt: skip
    assert seen[-1][0] == seen[-1][1]
    report = files[0].read_text(encoding="utf-8")
    assert "72 responses of 12 logs, 5 with a line of sight" in report
    assert "--data logs.npz" in report
    with files[1].open(encoding="utf-8") as file:
        rows = {row["method"]: row for row in csv.DictReader(file)}
    assert list(rows) == list(names)
    tree, trained = rows[measured.TREES[1]], rows[measured.TRAINED]
    assert float(tree["auc_gain"]) == float(tree["auc_gain_high"]) == 0.0
    gain = float(trained["auc"]) - float(tree["auc"])
    assert float(trained["auc_gain"]) == pytest.approx(gain, abs=1e-5)
    assert float(trained["auc_low"]) < float(trained["auc"]) < float(trained["auc_high"])
    assert float(trained["auc_least"]) <= float(trained["auc"]) <= float(trained["auc_most"])
    with files[2].open(encoding="utf-8") as file:
        curve = [row for row in csv.DictReader(file) if row["method"] == measured.TRAINED]
    assert [float(row["logs_trained_on"]) for row in curve] == sorted(
        float(row["logs_trained_on"]) for row in curve
    )
    again = run_study(options(tmp_path / "again", data=data, methods=names))
    assert again[1].read_bytes() == files[1].read_bytes()


def test_areas_from_pairs_of_logs_are_the_areas_of_the_links(tmp_path: Path) -> None:
    """As the logs are, and with logs drawn twice or not at all."""
    data = read_links(write_logs(tmp_path / "logs.npz"))
    rng = np.random.default_rng(0)
    probability = np.round(rng.random((1, len(data))), 1)  # with ties
    counts = np.ones((2, LOGS))
    counts[1] = [2, 0, 1, 1, 3, 0, 0, 2, 1, 1, 1, 0]
    found = measured.Draws.of(data, probability, counts)
    for number, drawn in enumerate(counts.astype(int)):
        rows = np.concatenate(
            [np.tile(np.flatnonzero(data.group == log), times) for log, times in enumerate(drawn)]
        ).astype(int)
        assert found.auc[number] == pytest.approx(auc(probability[0][rows], data.is_los[rows]))
        plain = figures(probability[0][rows], data.is_los[rows])
        assert found.balanced[number] == pytest.approx(plain.balanced_accuracy)
    one_class = measured.Draws.of(data, probability, np.array([np.ones(LOGS), np.arange(LOGS) < LOS_LOGS]))
    assert np.isnan(one_class.auc[1])


def test_every_method_answers_every_link(tmp_path: Path) -> None:
    data = read_links(write_logs(tmp_path / "logs.npz"), with_features=True)
    judges, taken = measured._judges(data, ())
    assert tuple(judges) == measured.METHODS
    seen, held_out = np.flatnonzero(data.group % 3 != 0), np.flatnonzero(data.group % 3 == 0)
    for judge in judges.values():
        probability = judge(seen, held_out, 0)
        assert probability.shape == held_out.shape
        assert np.all((probability >= 0) & (probability <= 1))
    assert len(taken) == 1


def test_refusals(tmp_path: Path) -> None:
    data = write_logs(tmp_path / "logs.npz")
    out = tmp_path / "out"
    with pytest.raises(UsageError, match="measured needs --data FILE"):
        run_study(options(out))
    with pytest.raises(UsageError, match="--data goes with measured only"):
        run_study(options(out, name="fig9", data=data))
    with pytest.raises(UsageError, match="measured has no 'magic'"):
        run_study(options(out, data=data, methods=("magic",)))
    with pytest.raises(UsageError, match="--scheduler does not go with measured"):
        run_study(options(out, data=data, scheduler="tcp://localhost:1"))
    with pytest.raises(InputError, match="nowhere"):
        run_study(options(out, data=tmp_path / "nowhere.npz"))
    with pytest.raises(InputError, match="log_id is needed"):
        run_study(options(out, data=write_logs(tmp_path / "unnamed.npz", named=False)))
    with pytest.raises(InputError, match="2 LOS and 10 NLOS logs; 3 of each are needed"):
        run_study(options(out, data=write_logs(tmp_path / "scarce.npz", los_logs=2)))
    assert not out.exists()
