"""The classifiers that the paper sets beside its network, and the network, behind one interface.

Why: a fair comparison gives each the same links, the same split and the same captures. Rules
kept here: random forest, Gaussian process and SVM work on statistics of the responses (III-A), every
capture an instance; a link's probability is the mean over its captures. All probabilities
are of line of sight. scikit-learn is imported on use: it belongs to the ``train`` extra.
"""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from groundstation.channel.features import FEATURE_NAMES
from groundstation.channel.training.data import LinkData
from groundstation.domain.errors import InternalError, ResourceError

GPC_CAPTURES = 1000
"""Training captures of the Gaussian process: its cost grows with their cube."""
SVM_CAPTURES = 12_000
"""Training captures of the SVM at most: its cost grows with their square."""
FOREST_TREES = 100
_BLOCK = 4096


class LinkClassifier(Protocol):
    """What Table III compares."""

    @property
    def name(self) -> str:
        """As in the paper's table."""
        ...

    def fit(self, data: LinkData, links: NDArray[np.int64]) -> None:
        """Learn from these links of ``data``."""
        ...

    def predict_proba(
        self, data: LinkData, links: NDArray[np.int64], packets: int | None = None
    ) -> NDArray[np.float64]:
        """(links,) P(line of sight), each from all its captures or from its first ``packets``."""
        ...


@dataclass(slots=True)
class FeatureClassifier:
    """A scikit-learn pipeline on the statistics of single captures."""

    name: str
    build: Callable[[int], Any]
    """Seed → an unfitted pipeline with ``predict_proba`` or ``decision_function``."""
    seed: int = 0
    goodness_of_fit: bool = False
    """Whether it also gets the distances to Rayleigh and Rician fits."""
    captures_max: int | None = None
    """Training captures at most, drawn in equal parts of both classes; None: all."""
    _model: Any = field(default=None, init=False)
    _platt: Any = field(default=None, init=False)

    def fit(self, data: LinkData, links: NDArray[np.int64]) -> None:
        """See LinkClassifier. Bare scores are calibrated (Platt) on a tenth of the groups."""
        rows, is_los, group = captures_of(data, links)
        if not hasattr(self.build(self.seed), "predict_proba"):
            rng = np.random.default_rng([self.seed, 1])
            groups = rng.permutation(np.unique(group))
            aside = np.isin(group, groups[: max(len(groups) // 10, 2)])
            if len(np.unique(is_los[aside])) < 2 or len(np.unique(is_los[~aside])) < 2:
                aside = rng.random(len(rows)) < 0.1
            self._fit_model(data, rows[~aside], is_los[~aside])
            self._platt = _logistic(
                self._model.decision_function(self._inputs(data, rows[aside])), is_los[aside]
            )
        else:
            self._fit_model(data, rows, is_los)

    def predict_proba(
        self, data: LinkData, links: NDArray[np.int64], packets: int | None = None
    ) -> NDArray[np.float64]:
        """See LinkClassifier."""
        count = data.packets[links] if packets is None else np.minimum(data.packets[links], packets)
        rows = np.repeat(data.first[links], count) + _within(count)
        probability = self.predict_captures(data, rows)
        return np.add.reduceat(probability, np.cumsum(count) - count) / count

    def predict_captures(self, data: LinkData, rows: NDArray[np.int64]) -> NDArray[np.float64]:
        """(rows,) P(line of sight) of single captures."""
        if self._model is None:
            raise InternalError(f"{self.name} was not fitted")
        parts = []
        for start in range(0, len(rows), _BLOCK):
            inputs = self._inputs(data, rows[start : start + _BLOCK])
            if self._platt is None:
                parts.append(self._model.predict_proba(inputs)[:, 1])
            else:
                slope, offset = self._platt
                logit = slope * self._model.decision_function(inputs) + offset
                parts.append(0.5 * (1 + np.tanh(0.5 * logit)))
        return np.concatenate(parts)

    def _fit_model(self, data: LinkData, rows: NDArray[np.int64], is_los: NDArray[np.bool_]) -> None:
        rng = np.random.default_rng([self.seed, 0])
        if self.captures_max is not None and len(rows) > self.captures_max:
            half = self.captures_max // 2
            chosen = np.concatenate(
                [rng.permutation(np.flatnonzero(is_los == which))[:half] for which in (True, False)]
            )
            rows, is_los = rows[chosen], is_los[chosen]
        from sklearn.exceptions import ConvergenceWarning

        self._model = self.build(self.seed)
        with warnings.catch_warnings():
            # Remarks on hyperparameters at the end of their range; the figures say how good they are.
            warnings.simplefilter("ignore", ConvergenceWarning)
            self._model.fit(self._inputs(data, rows), is_los)

    def _inputs(self, data: LinkData, rows: NDArray[np.int64]) -> NDArray[np.float64]:
        if data.features is None:
            raise InternalError("read the data with_features=True")
        chosen = data.features[rows]
        return chosen if self.goodness_of_fit else chosen[:, : len(FEATURE_NAMES)]


def random_forest(seed: int, *, goodness_of_fit: bool = False) -> FeatureClassifier:
    """RF, eqs. (19) and (20): Gini, majority vote (scikit-learn averages the trees' probabilities)."""

    def build(seed: int) -> Any:
        from sklearn.ensemble import RandomForestClassifier

        return RandomForestClassifier(FOREST_TREES, criterion="gini", random_state=seed, n_jobs=1)

    return FeatureClassifier("RF", _needing_sklearn(build), seed, goodness_of_fit)


def gaussian_process(
    seed: int, *, goodness_of_fit: bool = False, scaled: bool = True, captures_max: int = GPC_CAPTURES
) -> FeatureClassifier:
    """GPC with the composite kernel (18): κ_rbf² RBF(ℓ) + κ_lin² pᵀp', hyperparameters by evidence.

    scikit-learn has a logistic link where the paper has a probit; both with Laplace's approximation.
    ``scaled``: features are standardised first.
    """

    def build(seed: int) -> Any:
        from sklearn.gaussian_process import GaussianProcessClassifier
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct

        kernel = ConstantKernel(1.0, (1e-3, 1e4)) * RBF(1.0, (1e-2, 1e3)) + ConstantKernel(
            1.0, (1e-5, 1e3)
        ) * DotProduct(0.0, "fixed")
        return _pipeline(GaussianProcessClassifier(kernel, random_state=seed), scaled)

    return FeatureClassifier("GPC", _needing_sklearn(build), seed, goodness_of_fit, captures_max)


def support_vectors(
    seed: int, *, goodness_of_fit: bool = False, scaled: bool = True, captures_max: int = SVM_CAPTURES
) -> FeatureClassifier:
    """SVM with the RBF kernel (13), γ = 1 / (features · variance), C = 1; ``scaled`` as above."""

    def build(seed: int) -> Any:
        from sklearn.svm import SVC

        return _pipeline(SVC(kernel="rbf", C=1.0, gamma="scale", cache_size=500, random_state=seed), scaled)

    return FeatureClassifier("SVM", _needing_sklearn(build), seed, goodness_of_fit, captures_max)


def captures_of(
    data: LinkData, links: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64]]:
    """(rows in ``data.inputs``, labels, groups) of every capture of ``links``."""
    count = data.packets[links]
    rows = np.repeat(data.first[links], count) + _within(count)
    return rows, np.repeat(data.is_los[links], count), np.repeat(data.group[links], count)


def _needing_sklearn(build: Callable[[int], Any]) -> Callable[[int], Any]:
    if importlib.util.find_spec("sklearn") is None:
        raise ResourceError("the classic classifiers need scikit-learn: pip install 'groundstation[train]'")
    return build


def _pipeline(classifier: Any, scaled: bool) -> Any:
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    return make_pipeline(StandardScaler(), classifier) if scaled else make_pipeline(classifier)


def _logistic(score: NDArray[np.float64], is_los: NDArray[np.bool_]) -> tuple[float, float]:
    """(slope, offset) of P(LOS) = σ(slope · score + offset), by maximum likelihood (Platt)."""
    from sklearn.linear_model import LogisticRegression

    fitted = LogisticRegression(C=1e4).fit(score[:, None], is_los)
    return float(fitted.coef_[0, 0]), float(fitted.intercept_[0])


def _within(count: NDArray[np.int64]) -> NDArray[np.int64]:
    """0, 1, … n − 1 for each n of ``count``, one after another."""
    ends = np.cumsum(count)
    return np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - count, count)
