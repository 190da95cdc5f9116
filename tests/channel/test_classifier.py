"""The shipped classifier through the service's door."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from groundstation.channel import ChannelCapture, ChannelSettings, Classifier, VerdictStatus, load_classifier
from groundstation.channel.classifier import METADATA_FILE, MODEL_FILE, WEIGHTS_DIR
from groundstation.domain.errors import InputError

MakeCapture = Callable[..., ChannelCapture]


@pytest.fixture(scope="module")
def classifier() -> Classifier:
    return load_classifier()


def links_of(make_capture: MakeCapture, count: int) -> list[list[ChannelCapture]]:
    """Links of 1 to 4 captures, of 64 or 256 taps, of both kinds."""
    return [
        [
            make_capture(
                seed=100 * link + packet, taps=64 if link % 3 else 256, first_path=8, los=link % 2 == 0
            )
            for packet in range(1 + link % 4)
        ]
        for link in range(count)
    ]


def test_shipped_model_is_small_and_named(classifier: Classifier) -> None:
    assert (WEIGHTS_DIR / MODEL_FILE).stat().st_size < 1_000_000
    assert classifier.version in (WEIGHTS_DIR / "card.md").read_text(encoding="utf-8")


def test_clear_channels_are_told_apart(classifier: Classifier, make_capture: MakeCapture) -> None:
    """UWB-like pulses, four captures: nearly every LOS link above nearly every NLOS link, and far above."""
    verdicts = classifier.classify(
        [
            [make_capture(seed=10 * link + p, taps=64, first_path=8, los=link % 2 == 0) for p in range(4)]
            for link in range(60)
        ]
    )
    probability = np.array([verdict.los_probability for verdict in verdicts])
    assert {verdict.status for verdict in verdicts} == {VerdictStatus.CLASSIFIED}
    assert np.mean(probability[::2, None] > probability[None, 1::2]) > 0.995
    assert probability[::2].mean() - probability[1::2].mean() > 0.55
    assert np.mean((probability >= 0.5) == (np.arange(60) % 2 == 0)) > 0.85


def test_a_links_answer_does_not_depend_on_its_company(
    classifier: Classifier, make_capture: MakeCapture
) -> None:
    links = links_of(make_capture, 48)
    together = classifier.classify(links)
    alone = [classifier.classify([link])[0] for link in links]
    backwards = classifier.classify(links[::-1])[::-1]
    for first, second, third in zip(together, alone, backwards, strict=True):
        assert first.los_probability == pytest.approx(second.los_probability, abs=2e-6)
        assert first.los_probability == pytest.approx(third.los_probability, abs=2e-6)
    assert classifier.classify(links) == together


def test_unknown_links_get_the_prior_and_a_reason(classifier: Classifier, make_capture: MakeCapture) -> None:
    noise = np.random.default_rng(0).rayleigh(size=64)
    links: list[list[ChannelCapture]] = [
        [],
        [ChannelCapture(np.ones(4), 1.0)],
        [ChannelCapture(noise, 1.0)],
        [make_capture()],
        [ChannelCapture(np.full(64, np.nan), 1.0), make_capture()],
    ]
    verdicts = classifier.classify(links, prior=0.3)
    assert [verdict.status.value for verdict in verdicts] == ["unknown"] * 3 + ["classified"] * 2
    assert [verdict.los_probability for verdict in verdicts[:3]] == [0.3] * 3
    assert [verdict.reason.split(":")[0] for verdict in verdicts[:3]] == [
        "no capture",
        "too short",
        "all noise",
    ]
    assert verdicts[3].reason == ""
    assert verdicts[4].reason == "1 of 2 captures left out: magnitudes are not finite"
    assert verdicts[4].captures_used == 1
    assert verdicts[4].los_probability == verdicts[3].los_probability
    assert classifier.classify(links[:1])[0].los_probability == 0.5


def test_any_magnitudes_give_a_probability_or_a_reason(classifier: Classifier) -> None:
    rng = np.random.default_rng(1)
    for taps in (16, 17, 100, 1016, 5000):
        for scale in (1e-30, 1.0, 1e30):
            magnitude = scale * np.abs(rng.standard_cauchy(taps))
            verdict = classifier.classify([[ChannelCapture(magnitude, float(10 ** rng.uniform(-2, 4)))]])[0]
            assert 0 <= verdict.los_probability <= 1
            assert verdict.status is VerdictStatus.CLASSIFIED or verdict.reason


def test_only_the_newest_captures_are_used_and_batches_are_bounded(make_capture: MakeCapture) -> None:
    small = load_classifier(settings=ChannelSettings(packets_max=2, batch_max=3))
    links = links_of(make_capture, 20)
    verdicts = small.classify(links)
    assert max(verdict.captures_used for verdict in verdicts) == 2
    again = small.classify([link[-2:] for link in links])
    np.testing.assert_allclose(
        [verdict.los_probability for verdict in verdicts], [v.los_probability for v in again], atol=2e-6
    )


def test_no_links_no_verdicts(classifier: Classifier) -> None:
    assert classifier.classify([]) == []


@pytest.mark.parametrize("module", ["torch", "sklearn"])
def test_service_does_not_load_training_libraries(module: str) -> None:
    code = (
        f"import sys; sys.modules[{module!r}] = None\n"
        "import numpy as np\n"
        "from groundstation.channel import ChannelCapture, load_classifier\n"
        "m = np.full(64, 0.01); m[8] = 1; m[9:20] = np.linspace(.5, .1, 11)\n"
        "print(load_classifier().classify([[ChannelCapture(m, 1.0)]])[0].status.value)\n"
    )
    root = Path(__file__).parents[2]
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=root
    )
    assert result.stdout.strip() == "classified", result.stderr


def test_bad_folders_are_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a folder"):
        load_classifier(tmp_path / "nowhere")
    with pytest.raises(InputError, match="cannot read"):
        load_classifier(tmp_path)
    (tmp_path / METADATA_FILE).write_text("{}")
    with pytest.raises(InputError, match="not a model's metadata"):
        load_classifier(tmp_path)
    shutil.copy(WEIGHTS_DIR / METADATA_FILE, tmp_path / METADATA_FILE)
    with pytest.raises(InputError, match="holds no model"):
        load_classifier(tmp_path)
    (tmp_path / MODEL_FILE).write_bytes(b"not a network")
    with pytest.raises(InputError, match="not a network"):
        load_classifier(tmp_path)


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("format", 99, "format 99"),
        ("preprocessing_version", 99, "train it again"),
        ("temperature", 0, "positive"),
    ],
)
def test_incompatible_metadata_is_refused(tmp_path: Path, key: str, value: float, reason: str) -> None:
    shutil.copytree(WEIGHTS_DIR, tmp_path / "model")
    path = tmp_path / "model" / METADATA_FILE
    tree = json.loads(path.read_text(encoding="utf-8"))
    tree[key] = value
    path.write_text(json.dumps(tree))
    with pytest.raises(InputError, match=reason):
        load_classifier(tmp_path / "model")


def test_the_shipped_model_names_no_file_of_the_machine_that_trained_it() -> None:
    """Exporters note the source of each node; that is nobody's business, and changes the bytes."""
    from groundstation.channel.classifier import MODEL_FILE, WEIGHTS_DIR

    data = (WEIGHTS_DIR / MODEL_FILE).read_bytes()
    assert b".py" not in data
    assert b"site-packages" not in data
