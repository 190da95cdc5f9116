"""Few measured logs: folds by log, nothing of a log in its own training, an honest card."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from groundstation.channel import load_classifier
from groundstation.channel.training import TrainingOptions, TrainingProgress, train
from groundstation.channel.training.data import LinkData, read_links

pytestmark = [
    pytest.mark.train,
    pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs the train extra"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
]
OPTIONS = TrainingOptions(folds=2, adapt_steps=8)


@pytest.fixture(scope="module")
def logs_npz(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten logs of one class each, twelve noisy soundings of one channel each."""
    rng = np.random.default_rng(5)
    rows, label, log_id = [], [], []
    for log in range(10):
        los = log < 4
        delay = np.arange(128) - 20
        tail = np.where(delay >= 0, np.exp(-np.maximum(delay, 0) / (16 if los else 60)), 0)
        field = (rng.standard_normal(128) + 1j * rng.standard_normal(128)) * np.sqrt(0.5 * tail)
        channel = (0.3 if los else 1.0) * field
        channel[20] += 1.0 if los else 0.0
        for _ in range(12):
            noise = 0.01 * (rng.standard_normal(128) + 1j * rng.standard_normal(128))
            rows.append(np.abs(channel + noise))
            label.append("LOS" if los else "NLOS")
            log_id.append(log)
    path = tmp_path_factory.mktemp("logs") / "logs.npz"
    np.savez(path, cir_magnitude=np.array(rows), label=np.array(label), log_id=np.array(log_id))
    return path


@pytest.fixture(scope="module")
def logs(logs_npz: Path) -> LinkData:
    return read_links(logs_npz)


def test_groups_are_dealt_whole_and_by_class(logs: LinkData) -> None:
    from groundstation.channel.training.adapt import deal_groups

    for seed in range(5):
        fold = deal_groups(logs, 2, seed)
        for group in np.unique(logs.group):
            assert len(np.unique(fold[logs.group == group])) == 1
        for part in (0, 1):
            inside = fold == part
            assert len(np.unique(logs.group[inside & logs.is_los])) == 2
            assert len(np.unique(logs.group[inside & ~logs.is_los])) == 3
    assert not np.array_equal(deal_groups(logs, 2, 0), deal_groups(logs, 2, 1))


def test_a_held_out_log_has_no_part_in_its_own_answer(logs: LinkData, tmp_path: Path) -> None:
    """Turning the labels of one fold's logs leaves that fold's own logits as they were."""
    from groundstation.channel.training.adapt import AdaptOptions, cross_fit, deal_groups

    fold = deal_groups(logs, 2, 0)
    options = AdaptOptions(steps=4)

    def run(data: LinkData, name: str) -> NDArray[np.float64]:
        return cross_fit(None, data, fold, options, tmp_path / name, name, lambda *_: None)

    honest = run(logs, "honest")
    turned = run(replace(logs, is_los=np.where(fold == 0, ~logs.is_los, logs.is_los)), "turned")
    np.testing.assert_array_equal(honest[fold == 0], turned[fold == 0])
    assert not np.array_equal(honest[fold == 1], turned[fold == 1])


def test_an_interrupted_cross_fit_does_only_the_rest(
    logs: LinkData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from groundstation.channel.training import adapt

    fold = adapt.deal_groups(logs, 2, 0)
    options = adapt.AdaptOptions(steps=2)
    whole = adapt.cross_fit(None, logs, fold, options, tmp_path / "w.npz", "w", lambda *_: None)

    class InterruptedTrainingError(Exception):
        pass

    def stop(done: int, total: int) -> None:
        raise InterruptedTrainingError

    with pytest.raises(InterruptedTrainingError):
        adapt.cross_fit(None, logs, fold, options, tmp_path / "i.npz", "i", stop)
    trained: list[int] = []
    original = adapt.adapt

    def counted(*arguments: object) -> object:
        trained.append(1)
        return original(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(adapt, "adapt", counted)
    resumed = adapt.cross_fit(None, logs, fold, options, tmp_path / "i.npz", "i", lambda *_: None)
    assert len(trained) == 1
    np.testing.assert_array_equal(resumed, whole)


def test_few_logs_adapt_the_shipped_network_and_the_card_tells_of_folds(
    logs_npz: Path, tmp_path: Path
) -> None:
    seen: list[TrainingProgress] = []
    options = replace(OPTIONS, seeds=2, learning_curve=True)
    report = train(logs_npz, tmp_path, options=options, progress=seen.append)
    assert report.test.links == 120
    assert report.test.auc > 0.9
    card = json.loads((tmp_path / "card.json").read_text(encoding="utf-8"))
    assert card["start"] == f"the weights of model {load_classifier().version}"
    assert [one["seed"] for one in card["seeds"]] == [0, 1]
    assert [point["groups"] for point in card["learning_curve"]] == [2, 3, 5]
    assert "neither it nor its calibration saw" in card["split"]
    assert sum(progress.stage == "training" for progress in seen) == 8
    adapted = load_classifier(tmp_path)
    assert adapted.version == report.version != load_classifier().version
    assert adapted.metadata.novelty_max == np.inf
    assert list(tmp_path.glob("checkpoint*")) == []


def test_the_new_fading_keeps_the_envelope_and_the_gaps(logs: LinkData) -> None:
    import torch

    from groundstation.channel.training.adapt import _fade

    batch = torch.from_numpy(logs.batch(np.arange(40), 1, np.zeros(40, np.int64)))
    faded = _fade(batch, 3.0, np.random.default_rng(0))
    assert torch.equal(faded[:, :, 2:], batch[:, :, 2:])
    assert torch.all(faded[:, :, :2][(batch[:, :, 3:4] == 0).expand(-1, -1, 2, -1)] == 0)
    assert float(faded[:, :, 1].amax()) == pytest.approx(1.0)
    # About the shift that puts each response's strongest tap back to 0 dB.
    spread = [
        float((new - old)[old > 0.5].std()) for new, old in zip(faded[:, 0, 1], batch[:, 0, 1], strict=True)
    ]
    assert np.median(spread) * 50 == pytest.approx(3.0, rel=0.2)
