"""Training end to end on a tiny data set: a file in, a classifier and its card out."""

from __future__ import annotations

import importlib.util
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from groundstation.channel import load_classifier
from groundstation.channel.training import TrainingOptions, TrainingProgress, TrainingReport, train
from groundstation.channel.training.progress import ConsoleProgress
from groundstation.domain.errors import InputError, ResourceError

pytestmark = [
    pytest.mark.train,
    pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs the train extra"),
    # torch's exporter trips over deprecations of its own dependencies.
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
]
OPTIONS = TrainingOptions(epochs=6, batch_links=16, seed=3)


@pytest.fixture(scope="module")
def trained(
    tiny_npz: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[TrainingReport, list[TrainingProgress]]:
    seen: list[TrainingProgress] = []
    out = tmp_path_factory.mktemp("model")
    return train(tiny_npz, out, options=OPTIONS, progress=seen.append, evaluate=[("again", tiny_npz)]), seen


def test_learns_what_is_easy_and_writes_a_card(
    trained: tuple[TrainingReport, list[TrainingProgress]],
) -> None:
    report, seen = trained
    assert report.test.auc > 0.95
    assert 70_000 <= report.parameters <= 74_000
    assert {progress.stage for progress in seen} == {"reading", "training", "evaluating"}
    assert sum(progress.stage == "training" for progress in seen) == report.epochs == 6
    assert sorted(path.name for path in report.out.iterdir()) == ["card.md", "metadata.json", "model.onnx"]
    card = (report.out / "card.md").read_text(encoding="utf-8")
    assert report.version in card
    assert "| again, first capture only | 80 |" in card
    assert (report.out / "model.onnx").stat().st_size < 1_000_000


def test_exported_network_is_the_trained_one(
    trained: tuple[TrainingReport, list[TrainingProgress]], tiny_npz: Path, tmp_path: Path
) -> None:
    import torch

    from groundstation.channel.training.export import export_onnx, write_metadata
    from groundstation.channel.training.model import CnnLstm, parameter_count

    torch.manual_seed(1)
    model = CnnLstm().eval()
    assert 70_000 <= parameter_count(model) <= 74_000
    export_onnx(model, tmp_path)
    write_metadata(tmp_path, version="test", temperature=1.0, los_threshold=0.5, seed=1)
    assert [path.name for path in tmp_path.glob("*.data")] == []
    classifier = load_classifier(tmp_path)
    rng = np.random.default_rng(0)
    for links, packets in ((1, 1), (1, 8), (64, 1), (7, 4)):
        tensor = rng.random((links, packets, 4, 128)).astype(np.float32)
        with torch.no_grad():
            expected = model(torch.from_numpy(tensor)).numpy()
        np.testing.assert_allclose(classifier.logits(tensor), expected, atol=1e-5)


def test_resuming_gives_the_uninterrupted_network(tiny_npz: Path, tmp_path: Path) -> None:
    import torch

    from groundstation.channel.training.data import read_links
    from groundstation.channel.training.fit import FitOptions, fit

    data = read_links(tiny_npz)
    training, validation = np.arange(60), np.arange(60, 80)
    options = FitOptions(
        seed=1,
        epochs=4,
        patience=9,
        batch_links=16,
        learning_rate=2e-3,
        weight_decay=1e-3,
        crop_probability=0.5,
    )

    class InterruptedTrainingError(Exception):
        pass

    def run(
        name: str, fingerprint: str = "this", stop_after: int = 99
    ) -> tuple[dict[str, torch.Tensor], list[int]]:
        epochs: list[int] = []

        def on_epoch(epoch: int, training_loss: float, validation_loss: float) -> None:
            epochs.append(epoch)
            assert np.isfinite([training_loss, validation_loss]).all()
            if epoch == stop_after:
                raise InterruptedTrainingError

        return fit(
            data, training, validation, options, tmp_path / name, fingerprint, on_epoch
        ).state_dict(), epochs

    whole, _ = run("whole.npz")
    again, _ = run("again.npz")
    with pytest.raises(InterruptedTrainingError):
        run("stopped.npz", stop_after=2)
    resumed, epochs = run("stopped.npz")
    assert epochs == [3, 4]
    for name, value in whole.items():
        assert torch.equal(value, resumed[name]), name
        assert torch.equal(value, again[name]), name
    # A checkpoint of another training, or a broken one, is not gone on from.
    assert run("stopped.npz", fingerprint="that")[1] == [1, 2, 3, 4]
    (tmp_path / "broken.npz").write_bytes(b"garbage")
    assert run("broken.npz")[1] == [1, 2, 3, 4]


def test_wrong_use_is_said_before_any_work(tiny_npz: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="a folder is needed"):
        train(tiny_npz, tmp_path / "file")
    with pytest.raises(InputError, match="is not a file"):
        train(tmp_path / "nowhere.npz", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_missing_torch_names_the_extra(
    tiny_npz: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "torch" else found(name))
    with pytest.raises(ResourceError, match=r"groundstation\[train\]"):
        train(tiny_npz, tmp_path / "out")


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_is_a_bar_on_a_terminal_and_lines_elsewhere() -> None:
    plain, terminal = StringIO(), Terminal()
    for stream in (plain, terminal):
        progress = ConsoleProgress(stream)
        for row in range(1, 101):
            progress(TrainingProgress("reading", row, 100))
    assert plain.getvalue().count("\n") == 11
    assert terminal.getvalue().count("\r") == 100
    assert terminal.getvalue().endswith("reading 100/100\n")
