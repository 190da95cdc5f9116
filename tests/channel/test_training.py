"""Training end to end on a tiny data set: a file in, a classifier and its card out."""

from __future__ import annotations

import importlib.util
import json
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from groundstation.channel import ChannelCapture, load_classifier
from groundstation.channel.training import TrainingOptions, TrainingProgress, TrainingReport, train
from groundstation.channel.training.data import read_links
from groundstation.channel.training.progress import ConsoleProgress
from groundstation.channel.training.run import merged
from groundstation.domain.errors import InputError, ResourceError

pytestmark = [
    pytest.mark.train,
    pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs the train extra"),
    # torch's exporter trips over deprecations of its own dependencies.
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
]
BY_LINK = ("first", "packets", "is_los", "group", "bandwidth_hz", "window_taps")
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
    assert sorted(path.name for path in report.out.iterdir()) == [
        "card.json",
        "card.md",
        "metadata.json",
        "model.onnx",
        "weights.npz",
    ]
    card = (report.out / "card.md").read_text(encoding="utf-8")
    assert report.version in card
    assert "| again, first capture only | 80 |" in card
    assert (report.out / "model.onnx").stat().st_size < 1_000_000


def test_the_card_is_json_too_with_confusion_and_intervals(
    trained: tuple[TrainingReport, list[TrainingProgress]],
) -> None:
    report, _ = trained
    card = json.loads((report.out / "card.json").read_text(encoding="utf-8"))
    assert card["version"] == report.version
    assert len(card["data_sha256"]) == 64
    held_out = card["evaluations"][0]
    assert held_out["figures"]["auc"] == pytest.approx(report.test.auc)
    assert sum(held_out["confusion"].values()) == held_out["figures"]["links"]
    assert held_out["auc_interval"]["low"] <= report.test.auc <= held_out["auc_interval"]["high"]
    assert [one["seed"] for one in card["seeds"]] == [3]
    assert card["start"] == "random weights"


def test_what_is_unlike_the_training_data_is_unknown_with_a_reason(
    trained: tuple[TrainingReport, list[TrainingProgress]], make_capture: Callable[..., ChannelCapture]
) -> None:
    """Nanoseconds told in femtoseconds; responses of the training's kind stay classified."""
    classifier = load_classifier(trained[0].out)
    assert np.isfinite(classifier.metadata.novelty_max)
    ordinary = [[make_capture(seed=s, taps=128, first_path=20, los=s % 2 == 0)] for s in range(100)]
    assert sum(v.status == "unknown" for v in classifier.classify(ordinary)) <= 3
    strange = make_capture(taps=128, first_path=20, tap_spacing_ns=1e6)
    verdict = classifier.classify([[strange]], prior=0.4)[0]
    assert verdict.status == "unknown"
    assert verdict.reason.startswith("unlike anything seen in training: novelty ")
    assert verdict.los_probability == 0.4
    assert verdict.captures_used == 0


def test_weights_are_gone_on_from(
    trained: tuple[TrainingReport, list[TrainingProgress]], tiny_npz: Path, tmp_path: Path
) -> None:
    start = trained[0].out
    again = train(
        tiny_npz, tmp_path / "out", options=replace(OPTIONS, epochs=1, learning_rate=1e-6, start=start)
    )
    assert again.test.auc > 0.95
    assert trained[0].version in (again.out / "card.md").read_text(encoding="utf-8")
    with pytest.raises(InputError, match="a folder that training wrote is needed"):
        train(tiny_npz, tmp_path / "out", options=replace(OPTIONS, start=tmp_path))


def test_several_files_are_trained_on_as_one(tiny_npz: Path) -> None:
    one = read_links(tiny_npz)
    both = merged([one, one])
    assert len(both) == 160
    assert len(np.unique(both.group)) == 2 * len(np.unique(one.group))
    last = np.array([159])
    np.testing.assert_array_equal(
        both.batch(last, 3, np.zeros(1, int)), one.batch(last - 80, 3, np.zeros(1, int))
    )


def test_files_weigh_alike_however_many_links_they_have(tiny_npz: Path) -> None:
    from groundstation.channel.training.fit import _loss, logits
    from groundstation.channel.training.model import CnnLstm

    one = read_links(tiny_npz)
    few = replace(one, **{name: getattr(one, name)[:40:2] for name in BY_LINK})
    both = merged([one, few])
    assert both.weight is not None
    assert both.source is not None
    assert [both.weight[both.source == file].sum() for file in (0, 1)] == pytest.approx([50, 50])
    # The loss of both is the mean of the losses of each.
    model = CnnLstm().eval()
    parts = [_loss(model, part, np.arange(len(part))) for part in (one, few)]
    assert parts[0] != pytest.approx(parts[1], rel=1e-4)
    assert _loss(model, both, np.arange(100)) == pytest.approx(np.mean(parts))
    assert len(logits(model, both, np.arange(100))) == 100


def test_several_seeds_are_each_told_and_the_best_is_kept(tiny_npz: Path, tmp_path: Path) -> None:
    options = replace(OPTIONS, epochs=2, seeds=2, learning_curve=True)
    report = train(tiny_npz, tmp_path, options=options)
    card = json.loads((tmp_path / "card.json").read_text(encoding="utf-8"))
    losses = {one["seed"]: one["validation_loss"] for one in card["seeds"]}
    assert set(losses) == {3, 4}
    kept = json.loads((tmp_path / "metadata.json").read_text(encoding="utf-8"))["seed"]
    assert losses[kept] == min(losses.values())
    assert report.epochs == 4
    assert [point["groups"] for point in card["learning_curve"]] == [3, 9, 28]
    assert "AUC over seeds" in (tmp_path / "card.md").read_text(encoding="utf-8")


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
    notes = (tmp_path / "model.onnx").read_bytes()
    assert not any(word in notes for word in (b".py", b"/home", b"/work", b"site-packages"))


def test_every_link_is_in_one_batch_with_as_many_captures_as_its_batch_has() -> None:
    from groundstation.channel.training.fit import _batches

    rng = np.random.default_rng(0)
    links, counts = rng.permutation(1000), rng.integers(1, 5, 1000)
    counts[7] = 8  # alone: no batch of one
    batches = _batches(links, counts, 32, rng)
    seen = np.concatenate([members for members, _ in batches])
    assert sorted(seen.tolist()) == sorted(set(range(1000)) - {int(links[7])})
    assert all(2 <= len(members) <= 32 for members, _ in batches)
    told = dict(zip(links.tolist(), counts.tolist(), strict=True))
    assert all({told[link] for link in members.tolist()} == {count} for members, count in batches)
    # Counts come in random order: not all of one kind at the end of an epoch.
    assert np.count_nonzero(np.diff([count for _, count in batches])) > 10


def test_a_batch_seen_blindly_is_one_of_untold_spacing(make_capture: Callable[..., ChannelCapture]) -> None:
    import torch

    from groundstation.channel import ChannelSettings
    from groundstation.channel.preprocess import network_input
    from groundstation.channel.training.fit import blind

    told, untold = (network_input(make_capture(tap_spacing_ns=ns), ChannelSettings()) for ns in (7.0, 1.0))
    batch = torch.from_numpy(told[None, None])
    np.testing.assert_array_equal(blind(batch)[0, 0].numpy(), untold)
    np.testing.assert_array_equal(batch[0, 0].numpy(), told)


def test_the_figures_are_told_by_file_and_windows_are_trained_on(tiny_npz: Path, tmp_path: Path) -> None:
    report = train(tiny_npz, tmp_path, options=replace(OPTIONS, epochs=1, windows=(32,)), also=[tiny_npz])
    card = json.loads((tmp_path / "card.json").read_text(encoding="utf-8"))
    titles = [one["title"] for one in card["evaluations"]]
    assert (
        titles.count("held out, of tiny.npz")
        == titles.count("held out, of tiny.npz, first capture only")
        == 2
    )
    by_title = {one["title"]: one["figures"]["links"] for one in card["evaluations"]}
    # Each link once as it is and once as a window, of the same groups.
    assert by_title["held out, window of 32 taps"] == by_title["held out, window of 128 taps"]
    assert report.test.links == 2 * by_title["held out, window of 32 taps"]


def test_the_command_line_passes_the_tap_spacing_on(
    tiny_npz: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from typer.testing import CliRunner

    from groundstation.channel.training import run
    from groundstation.cli import app

    seen: dict[str, object] = {}

    def note(*paths: Path, **options: object) -> None:
        seen.update(options)
        raise InputError("enough")

    monkeypatch.setattr(run, "train", note)
    CliRunner().invoke(
        app, ["train", "--data", str(tiny_npz), "--out", str(tmp_path), "--tap-spacing-ns", "333"]
    )
    assert seen["tap_spacing_ns"] == 333
    assert str(seen["command"]).endswith("--tap-spacing-ns 333")


def test_resuming_gives_the_uninterrupted_network(tiny_npz: Path, tmp_path: Path) -> None:
    import torch

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


def test_a_killed_training_goes_on_where_it_was(tiny_npz: Path, tmp_path: Path) -> None:
    """A real process, killed after its first epochs: the second start does only the rest."""
    program = (
        "import sys; from pathlib import Path; from groundstation.channel.training import *; "
        "options = TrainingOptions(epochs=6, batch_links=16, seed=3); "
        "train(Path(sys.argv[1]), Path(sys.argv[2]), options=options, "
        "progress=lambda p: print(p.stage, p.done, flush=True))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, str(tiny_npz), str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    with process.stdout as lines:
        for line in lines:
            if line.startswith("training 3"):
                process.kill()
                break
    assert process.wait() == -signal.SIGKILL
    epochs: list[int] = []

    def note(progress: TrainingProgress) -> None:
        if progress.stage == "training":
            epochs.append(progress.done)

    report = train(tiny_npz, tmp_path / "out", options=OPTIONS, progress=note)
    assert epochs[0] > 3
    assert epochs[-1] == 6
    assert report.test.auc > 0.95
    assert list(report.out.glob("checkpoint*")) == []


def test_wrong_use_is_said_before_any_work(tiny_npz: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="a folder is needed"):
        train(tiny_npz, tmp_path / "file")
    with pytest.raises(InputError, match="file is no folder that can be written to"):
        train(tiny_npz, tmp_path / "file" / "out")
    with pytest.raises(InputError, match="is not a file"):
        train(tmp_path / "nowhere.npz", tmp_path / "out")
    with pytest.raises(InputError, match=r"tap spacing is -1\.0 ns"):
        train(tiny_npz, tmp_path / "out", tap_spacing_ns=-1.0)
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
