"""Few measured logs: physics in the signs, a log counts once, nothing of a log in its own answer."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from groundstation.channel import ChannelCapture, ChannelSettings, load_classifier
from groundstation.channel.preprocess import network_input
from groundstation.channel.training import TrainingOptions, TrainingProgress, train
from groundstation.channel.training.data import LinkData, read_links

pytestmark = [
    pytest.mark.train,
    pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs the train extra"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
]
OPTIONS = TrainingOptions(folds=2)
LOGS, LOS_LOGS, SOUNDINGS = 10, 4, 12


def log_responses(
    rng: np.random.Generator, los: bool, soundings: int, taps: int = 128
) -> NDArray[np.float64]:
    """(soundings, taps): one channel, sounded with new noise each time."""
    delay = np.arange(taps) - 20
    tail = np.where(delay >= 0, np.exp(-np.maximum(delay, 0) / (16 if los else 60)), 0)
    field = (rng.standard_normal(taps) + 1j * rng.standard_normal(taps)) * np.sqrt(0.5 * tail)
    channel = (0.3 if los else 1.0) * field
    channel[20] += 1.0 if los else 0.0
    noise = rng.standard_normal((soundings, taps)) + 1j * rng.standard_normal((soundings, taps))
    return np.abs(channel + 0.01 * noise)


@pytest.fixture(scope="module")
def logs_npz(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten logs of one class each, twelve noisy soundings of one channel each."""
    rng = np.random.default_rng(5)
    rows = [log_responses(rng, log < LOS_LOGS, SOUNDINGS) for log in range(LOGS)]
    log_id = np.repeat(np.arange(LOGS), SOUNDINGS)
    path = tmp_path_factory.mktemp("logs") / "logs.npz"
    label = np.where(log_id < LOS_LOGS, "LOS", "NLOS")
    np.savez(path, cir_magnitude=np.concatenate(rows), label=label, log_id=log_id)
    return path


@pytest.fixture(scope="module")
def logs(logs_npz: Path) -> LinkData:
    return read_links(logs_npz)


def statistics_of(magnitude: NDArray[np.float64], tap_spacing_ns: float = 1.0) -> NDArray[np.float64]:
    import torch

    from groundstation.channel.training.measured import DirectPath

    prepared = network_input(ChannelCapture(magnitude, tap_spacing_ns), ChannelSettings(reject_noise=False))
    with torch.no_grad():
        return DirectPath()(torch.from_numpy(prepared[None]))[0].double().numpy()


def pulse(taps: int, at: int, *later: tuple[int, float]) -> NDArray[np.float64]:
    magnitude = np.full(taps, 1e-3)
    magnitude[at] = 1.0
    for tap, height in later:
        magnitude[tap] = height
    return magnitude


def test_statistics_are_what_they_are_called() -> None:
    # Half of the energy 20 ns behind the first tap; 4 ns a tap.
    share, _, peak_delay, rise_time = statistics_of(pulse(256, 30, (35, 1.0)), 4.0)
    assert share == pytest.approx(np.log(0.5), abs=1e-3)
    assert peak_delay == rise_time == pytest.approx(0.0, abs=1e-6)
    # The first path at 0.4 of a peak 10 taps later: found by the edge, below half of the peak.
    share, _, peak_delay, rise_time = statistics_of(pulse(256, 30, (20, 0.4)), 2.0)
    assert share == pytest.approx(np.log(0.16 / 1.16), abs=1e-3)
    assert peak_delay == rise_time == pytest.approx(-np.log1p(20.0), rel=1e-4)
    # At 0.6 it has risen at once, but the peak is as late.
    _, _, peak_delay, rise_time = statistics_of(pulse(256, 30, (20, 0.6)), 2.0)
    assert rise_time == pytest.approx(0.0, abs=1e-6)
    assert peak_delay == pytest.approx(-np.log1p(20.0), rel=1e-4)
    # 54 known taps with one pulse on a flat floor: kurtosis of a single outlier, n - 2 + 1 / (n - 1).
    assert np.exp(statistics_of(pulse(256, 30))[1]) == pytest.approx(53 - 1 + 1 / 53, rel=1e-3)


def test_a_window_of_64_taps_gives_the_statistics_of_the_full_response() -> None:
    rng = np.random.default_rng(3)
    for lead in (2, 8, 12):
        full = log_responses(rng, True, 1, taps=512)[0]
        window = full[20 - lead : 84 - lead]
        np.testing.assert_allclose(statistics_of(window), statistics_of(full), atol=0.02)


def test_weights_keep_the_sign_that_physics_gives() -> None:
    from groundstation.channel.training.measured import fit_head

    rng = np.random.default_rng(1)
    is_los = np.arange(400) % 2 == 0
    helps = is_los + rng.normal(0, 1, 400)
    misleads = -1.0 * is_los + rng.normal(0, 0.5, 400)
    head = fit_head(np.column_stack([helps, misleads, np.ones(400)]), is_los, np.arange(400))
    assert head.weight[0] > 0.5
    assert head.weight[1:] == (0.0, 0.0)


def test_a_log_counts_once_however_often_it_was_sounded() -> None:
    from groundstation.channel.training.measured import fit_head, log_weights

    rng = np.random.default_rng(2)
    inputs, is_los, group = rng.normal(0, 1, (20, 2)), np.arange(20) < 5, np.arange(20)
    inputs[:5, 0] += 2
    often = np.repeat(np.arange(20), np.where(group == 7, 500, 3))
    once, repeated = fit_head(inputs, is_los, group), fit_head(inputs[often], is_los[often], group[often])
    np.testing.assert_allclose(repeated.weight, once.weight, rtol=1e-3)
    assert repeated.offset == pytest.approx(once.offset, rel=1e-3)
    weight = log_weights(group[often], is_los[often])
    assert weight.sum() == pytest.approx(20)
    assert weight[is_los[often]].sum() == pytest.approx(10)


def test_a_fit_is_the_minimum_of_what_it_says() -> None:
    from groundstation.channel.training.measured import fit_head, log_weights

    rng = np.random.default_rng(4)
    is_los, group = np.arange(60) < 25, np.arange(60)
    inputs = rng.normal(3, 2, (60, 2)) + is_los[:, None] * [2.0, 1.0]
    weight = log_weights(group, is_los)
    share = weight / weight.sum()
    deviation = np.sqrt(share @ (inputs - share @ inputs) ** 2)
    head = fit_head(inputs, is_los, group, ridge=2.0)

    def loss(weights: NDArray[np.float64], offset: float) -> float:
        margin = np.where(is_los, 1, -1) * (inputs @ weights + offset)
        return float(weight @ np.logaddexp(0, -margin) + np.sum((weights * deviation) ** 2))

    least = loss(np.array(head.weight), head.offset)
    for change in ((1e-2, 0, 0), (-1e-2, 0, 0), (0, 1e-2, 0), (0, -1e-2, 0), (0, 0, 1e-2), (0, 0, -1e-2)):
        assert loss(np.array(head.weight) + change[:2], head.offset + change[2]) > least


def test_the_network_is_taken_in_only_where_logs_left_out_say_so() -> None:
    from groundstation.channel.training.measured import STATISTICS, choose_head

    rng = np.random.default_rng(6)
    group = np.repeat(np.arange(24), 10)
    is_los = group < 10
    statistics = np.repeat(rng.normal(0, 1, (24, len(STATISTICS))), 10, axis=0) + 0.8 * is_los[:, None]
    knows = 6.0 * (is_los - 0.5) + rng.normal(0, 1, 240)
    guesses = np.repeat(rng.normal(0, 3, 24), 10)
    assert len(choose_head(np.column_stack([statistics, knows]), is_los, group, 0).weight) == 5
    assert len(choose_head(np.column_stack([statistics, guesses]), is_los, group, 0).weight) == 4
    # One log of a class: nothing can be left out, the statistics alone are fitted.
    few = np.isin(group, [0, 20, 21, 22])
    head = choose_head(np.column_stack([statistics, knows])[few], is_los[few], group[few], 0)
    assert len(head.weight) == 4
    assert np.all(np.isfinite(head.weight))


def test_groups_are_dealt_whole_and_by_class(logs: LinkData) -> None:
    from groundstation.channel.training.measured import deal_groups

    for seed in range(5):
        fold = deal_groups(logs.group, logs.is_los, 2, seed)
        for group in np.unique(logs.group):
            assert len(np.unique(fold[logs.group == group])) == 1
        for part in (0, 1):
            inside = fold == part
            assert len(np.unique(logs.group[inside & logs.is_los])) == 2
            assert len(np.unique(logs.group[inside & ~logs.is_los])) == 3
    first, second = (deal_groups(logs.group, logs.is_los, 2, seed) for seed in (0, 1))
    assert not np.array_equal(first, second)


def test_a_held_out_log_has_no_part_in_its_own_answer(logs: LinkData) -> None:
    """Turning the labels of one fold's logs leaves that fold's own logits as they were."""
    from groundstation.channel.training.measured import deal_groups
    from groundstation.channel.training.measured_recipe import cross_fit

    fold = deal_groups(logs.group, logs.is_los, 2, 0)
    # The classes change places within the fold, so that the deal stays as it is.
    inputs = np.random.default_rng(0).normal(0, 1, (len(logs), 5)) + logs.is_los[:, None]
    changed = np.where((fold == 0)[:, None], inputs + 3.0, inputs)
    honest, moved = (cross_fit(logs, columns, 2, 0) for columns in (inputs, changed))
    np.testing.assert_array_equal(moved[fold == 1] == honest[fold == 1], False)
    slope = (moved - honest)[fold == 0]
    np.testing.assert_allclose(slope, slope[0])


def test_few_logs_weigh_statistics_and_the_card_says_so(logs_npz: Path, tmp_path: Path) -> None:
    seen: list[TrainingProgress] = []
    options = replace(OPTIONS, seeds=2, learning_curve=True)
    report = train(logs_npz, tmp_path, options=options, progress=seen.append)
    assert report.test.links == LOGS * SOUNDINGS
    assert report.test.auc > 0.95
    assert report.test.balanced_accuracy > 0.85
    assert report.method.startswith("10 logs are 10 examples, too few for a network to learn from")
    assert ", with the network's logit (logs left out decided); weights: first_pulse_share " in report.method
    card = json.loads((tmp_path / "card.json").read_text(encoding="utf-8"))
    assert card["method"] == report.method
    assert report.method in (tmp_path / "card.md").read_text(encoding="utf-8")
    assert card["start"] == f"the weights of model {load_classifier().version}"
    assert [one["seed"] for one in card["seeds"]] == [0, 1]
    assert [point["groups"] for point in card["learning_curve"]] == [2, 4, 5]
    assert "no part in any of its numbers" in card["split"]
    assert sum(progress.stage == "training" for progress in seen) == 4
    _answers_as_the_head(logs_npz, tmp_path)


def _answers_as_the_head(logs_npz: Path, folder: Path) -> None:
    """The exported model through the service's own code; from one capture of a link and from two."""
    from groundstation.channel.classifier import WEIGHTS_DIR
    from groundstation.channel.training.export import load_weights
    from groundstation.channel.training.measured import choose_head, inputs_of
    from groundstation.channel.training.model import CnnLstm

    network = CnnLstm()
    network.load_state_dict(load_weights(WEIGHTS_DIR))
    network.eval()
    logs = read_links(logs_npz)
    head = choose_head(inputs_of(logs, network), logs.is_los, logs.group, 0)
    pairs = replace(logs, first=logs.first[::2], packets=np.full(len(logs) // 2, 2), is_los=logs.is_los[::2])
    with np.load(logs_npz) as archive:
        captures = [ChannelCapture(row, 1.0) for row in archive["cir_magnitude"]]
    alone = [[capture] for capture in captures]
    in_pairs = [list(pair) for pair in zip(captures[::2], captures[1::2], strict=True)]
    for links, data in ((alone, logs), (in_pairs, pairs)):
        found = [verdict.los_probability for verdict in load_classifier(folder).classify(links)]
        expected = 1 / (1 + np.exp(-head.logit(inputs_of(data, network))))
        np.testing.assert_allclose(found, expected, atol=2e-4)


def test_the_graph_answers_as_the_head_does(logs: LinkData) -> None:
    from groundstation.channel.classifier import WEIGHTS_DIR
    from groundstation.channel.training.export import load_weights
    from groundstation.channel.training.fit import logits
    from groundstation.channel.training.measured import Head, MeasuredModel, inputs_of
    from groundstation.channel.training.model import CnnLstm

    network = CnnLstm()
    network.load_state_dict(load_weights(WEIGHTS_DIR))
    network.eval()
    for head in (Head((0.5, 1.0, 0.25, 0.75), 2.0), Head((0.5, 1.0, 0.25, 0.75, 0.4), 2.0)):
        model = MeasuredModel(head, network)
        assert (model.network is None) == (len(head.weight) == 4)
        found = logits(model, logs, np.arange(len(logs)))
        np.testing.assert_allclose(found, head.logit(inputs_of(logs, network)), atol=1e-4)


def test_a_capture_without_its_first_tap_or_without_shape_gives_finite_answers() -> None:
    for magnitude in (pulse(20, 0), pulse(20, 19), np.linspace(1, 2, 64)):
        assert np.all(np.isfinite(statistics_of(magnitude)))
    assert np.all(np.isfinite(statistics_of(pulse(64, 8), 1e6)))


def test_many_groups_or_mixed_ones_train_the_network_as_before(logs: LinkData) -> None:
    from groundstation.channel.training.run import is_few

    assert is_few(logs, TrainingOptions())
    assert not is_few(logs, TrainingOptions(few_groups=LOGS))
    assert not is_few(replace(logs, is_los=np.arange(len(logs)) % 2 == 0), TrainingOptions())
    assert not is_few(replace(logs, grouped=False), TrainingOptions())
    one_los = replace(logs, is_los=logs.group == 0)
    assert not is_few(one_los, TrainingOptions())
