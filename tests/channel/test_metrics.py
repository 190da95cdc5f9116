"""Figures of merit by hand."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.channel.training.metrics import Confusion, auc, confusion, figures, reliability, roc

PROBABILITY = np.array([0.9, 0.6, 0.4, 0.6, 0.2, 0.8])
IS_LOS = np.array([True, True, True, False, False, False])


def test_by_hand() -> None:
    result = figures(PROBABILITY, IS_LOS)
    assert result.accuracy == pytest.approx(3 / 6)
    assert result.nlos_called_los == pytest.approx(2 / 3)
    assert result.los_called_nlos == pytest.approx(1 / 3)
    assert result.balanced_accuracy == pytest.approx(0.5)
    assert result.precision == pytest.approx(2 / 4)
    assert result.recall == pytest.approx(2 / 3)
    assert result.f1 == pytest.approx(2 * (1 / 2) * (2 / 3) / (1 / 2 + 2 / 3))
    # Pairs won: 0.9 three, 0.6 one and a tie, 0.4 one.
    assert result.auc == pytest.approx(5.5 / 9)
    cautious = figures(PROBABILITY, IS_LOS, threshold=0.75)
    assert cautious.nlos_called_los == pytest.approx(1 / 3)


def test_confusion_at_a_threshold() -> None:
    assert confusion(PROBABILITY, IS_LOS) == Confusion(2, 1, 2, 1)
    assert confusion(PROBABILITY, IS_LOS, 0.85) == Confusion(1, 2, 0, 3)


def test_auc_of_hard_labels_is_the_balanced_accuracy() -> None:
    """And lies under the AUC of the scores they came from, as the paper's do."""
    rng = np.random.default_rng(1)
    is_los = rng.random(2000) < 0.4
    score = 1 / (1 + np.exp(-(rng.standard_normal(2000) + 1.5 * is_los - 0.7)))
    result = figures(score, is_los)
    assert result.auc_hard == pytest.approx(result.balanced_accuracy)
    assert result.auc > result.auc_hard + 0.05


def test_roc_encloses_the_auc() -> None:
    false_los, true_los = roc(PROBABILITY, IS_LOS)
    assert (false_los[0], true_los[0], false_los[-1], true_los[-1]) == (0, 0, 1, 1)
    area = np.sum(np.diff(false_los) * (true_los[1:] + true_los[:-1]) / 2)
    assert area == pytest.approx(auc(PROBABILITY, IS_LOS))


def test_reliability_bins() -> None:
    mean, share, count = reliability(
        np.array([0.1, 0.15, 0.9, 1.0]), np.array([False, True, True, True]), bins=5
    )
    np.testing.assert_allclose(mean, [0.125, 0.95])
    np.testing.assert_allclose(share, [0.5, 1.0])
    assert list(count) == [2, 2]


def test_one_class_has_no_auc() -> None:
    assert np.isnan(auc(np.array([0.1, 0.2]), np.array([True, True])))
    nobody = figures(np.array([0.1, 0.2]), np.array([True, False]))
    assert np.isnan(nobody.precision)
    assert nobody.f1 == 0
