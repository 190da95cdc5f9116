"""Figures of merit by hand."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.channel.training.metrics import auc, figures


def test_by_hand() -> None:
    probability = np.array([0.9, 0.6, 0.4, 0.6, 0.2, 0.8])
    is_los = np.array([True, True, True, False, False, False])
    result = figures(probability, is_los)
    assert result.accuracy == pytest.approx(3 / 6)
    assert result.nlos_called_los == pytest.approx(2 / 3)
    assert result.los_called_nlos == pytest.approx(1 / 3)
    assert result.balanced_accuracy == pytest.approx(0.5)
    # Pairs won: 0.9 three, 0.6 one and a tie, 0.4 one.
    assert result.auc == pytest.approx(5.5 / 9)
    cautious = figures(probability, is_los, threshold=0.75)
    assert cautious.nlos_called_los == pytest.approx(1 / 3)


def test_one_class_has_no_auc() -> None:
    assert np.isnan(auc(np.array([0.1, 0.2]), np.array([True, True])))
