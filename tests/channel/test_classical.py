"""One interface for all classifiers; the same captures for all."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from groundstation.channel.training.data import LinkData, read_links, single_captures, split_by_group
from groundstation.channel.training.metrics import figures
from groundstation.domain.errors import InternalError, ResourceError

pytest.importorskip("sklearn")

from groundstation.channel.training.classical import (
    FeatureClassifier,
    captures_of,
    gaussian_process,
    random_forest,
    support_vectors,
)

BUILDERS: dict[str, Callable[[int], FeatureClassifier]] = {
    "RF": random_forest,
    "GPC": gaussian_process,
    "SVM": support_vectors,
}


@pytest.fixture(scope="module")
def data(tiny_npz: Path) -> LinkData:
    return read_links(tiny_npz, with_features=True)


@pytest.mark.parametrize("name", BUILDERS)
def test_learns_what_the_statistics_show(name: str, data: LinkData) -> None:
    training, more, test = split_by_group(data, (0.5, 0.2, 0.3), 0)
    training = np.concatenate([training, more])
    classifier = BUILDERS[name](0)
    assert classifier.name == name
    classifier.fit(data, training)
    probability = classifier.predict_proba(data, test)
    assert probability.shape == (len(test),)
    assert np.all((probability >= 0) & (probability <= 1))
    assert figures(probability, data.is_los[test]).auc > 0.9
    again = BUILDERS[name](0)
    again.fit(data, training)
    np.testing.assert_array_equal(probability, again.predict_proba(data, test))


def test_a_link_is_the_mean_of_its_captures(data: LinkData) -> None:
    forest = random_forest(1)
    forest.fit(data, np.arange(60))
    links = np.array([70, 61, 79])
    rows = captures_of(data, links)[0]
    single = forest.predict_captures(data, rows).reshape(3, 3)
    np.testing.assert_allclose(forest.predict_proba(data, links), single.mean(axis=1))
    np.testing.assert_allclose(forest.predict_proba(data, links, 1), single[:, 0])
    np.testing.assert_allclose(forest.predict_proba(single_captures(data), rows), single.ravel())


def test_goodness_of_fit_is_an_option(data: LinkData) -> None:
    inputs = []
    for chosen in (False, True):
        forest = random_forest(0, goodness_of_fit=chosen)
        forest.fit(data, np.arange(60))
        inputs.append(forest._model.n_features_in_)
    assert inputs == [6, 8]


def test_the_gaussian_process_learns_from_as_many_of_either_class(data: LinkData) -> None:
    process = gaussian_process(0, captures_max=40)
    process.fit(data, np.arange(80))
    assert len(process._model[-1].base_estimator_.X_train_) == 40
    assert process._model[-1].base_estimator_.y_train_.sum() == 20


def test_unscaled_features_let_the_largest_rule(data: LinkData) -> None:
    """A feature of no meaning and a great range drowns the rest in a kernel unless it is standardised."""
    assert data.features is not None
    noisy = data.features.copy()
    noisy[:, 3] = 1e6 * np.random.default_rng(0).standard_normal(len(noisy))
    data = dataclasses.replace(data, features=noisy)
    training, more, test = split_by_group(data, (0.5, 0.2, 0.3), 0)
    reached = []
    for scaled in (True, False):
        vectors = support_vectors(0, scaled=scaled)
        vectors.fit(data, np.concatenate([training, more]))
        reached.append(figures(vectors.predict_proba(data, test), data.is_los[test]).auc)
    assert reached[0] > 0.9
    assert reached[1] < 0.75


def test_single_captures_keep_their_labels(data: LinkData) -> None:
    single = single_captures(data)
    assert len(single) == len(data.inputs)
    np.testing.assert_array_equal(single.is_los, captures_of(data, np.arange(len(data)))[1])
    assert not single.grouped


def test_misuse_is_told(data: LinkData, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InternalError, match="was not fitted"):
        random_forest(0).predict_proba(data, np.arange(2))
    with pytest.raises(InternalError, match="with_features"):
        random_forest(0).fit(dataclasses.replace(data, features=None), np.arange(4))
    monkeypatch.setitem(sys.modules, "sklearn", None)
    with pytest.raises(ResourceError, match=r"groundstation\[train\]"):
        random_forest(0)
