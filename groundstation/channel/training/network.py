"""The CNN–LSTM, newly trained or as shipped, as one of the classifiers that studies compare.

Why: it must be given what the classic ones are given. Rule kept here: early stopping and calibration use
a part of the training links, split off by geometry; the test links are never looked at.
"""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.channel.calibration import Calibration, fit_calibration
from groundstation.channel.classifier import Classifier
from groundstation.channel.training.data import LinkData
from groundstation.domain.errors import InternalError, ResourceError

VALIDATION_SHARE = 0.12
"""Of the training groups: early stopping and calibration."""
_BATCH_LINKS = 512


@dataclass(slots=True)
class NetworkClassifier:
    """The paper's network (III-B), trained on the responses themselves."""

    seed: int = 0
    epochs: int = 40
    patience: int = 10
    crop_probability: float = 0.0
    """Chance that a training batch is cropped to a window; 0 where the test has none."""
    on_epoch: Callable[[int, float, float], None] = lambda epoch, training, validation: None
    """Told each epoch's losses."""
    name: str = "CNN–LSTM"
    _network: Any = field(default=None, init=False)
    _calibration: Calibration = field(default_factory=Calibration, init=False)

    def fit(self, data: LinkData, links: NDArray[np.int64]) -> None:
        """See LinkClassifier. Raises ResourceError without torch."""
        if importlib.util.find_spec("torch") is None:
            raise ResourceError("training the CNN–LSTM needs torch: pip install 'groundstation[train]'")
        from groundstation.channel.training.fit import FitOptions, fit, logits

        training, validation = self._split(data, links)
        options = FitOptions(
            seed=self.seed,
            epochs=self.epochs,
            patience=self.patience,
            batch_links=128,
            learning_rate=2e-3,
            weight_decay=1e-3,
            crop_probability=self.crop_probability,
        )
        with tempfile.TemporaryDirectory() as folder:
            checkpoint = Path(folder) / "checkpoint.npz"
            self._network = fit(data, training, validation, options, checkpoint, "", self.on_epoch)
        # Calibrated over the numbers of captures that it will be asked about.
        counts = [None, 1] if int(data.packets.max()) > 1 else [None]
        judged = np.concatenate([logits(self._network, data, validation, count) for count in counts])
        self._calibration = fit_calibration(judged, np.tile(data.is_los[validation], len(counts)))

    def predict_proba(
        self, data: LinkData, links: NDArray[np.int64], packets: int | None = None
    ) -> NDArray[np.float64]:
        """See LinkClassifier."""
        if self._network is None:
            raise InternalError(f"{self.name} was not fitted")
        from groundstation.channel.training.fit import logits

        return self._calibration.probability(logits(self._network, data, links, packets))

    def _split(self, data: LinkData, links: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        groups = np.unique(data.group[links])
        for attempt in range(100):
            order = np.random.default_rng([self.seed, 2, attempt]).permutation(groups)
            aside = np.isin(data.group[links], order[: max(round(VALIDATION_SHARE * len(groups)), 1)])
            training, validation = links[~aside], links[aside]
            if all(0 < np.count_nonzero(data.is_los[part]) < len(part) for part in (training, validation)):
                return training, validation
        raise InternalError("no split of the training links leaves both classes on either side")


@dataclass(frozen=True, slots=True)
class ShippedClassifier:
    """The service's classifier as it is: learns nothing from the study's data."""

    classifier: Classifier
    name: str = "shipped CNN–LSTM, as it is"

    def fit(self, data: LinkData, links: NDArray[np.int64]) -> None:
        """Nothing to do: it comes trained."""

    def predict_proba(
        self, data: LinkData, links: NDArray[np.int64], packets: int | None = None
    ) -> NDArray[np.float64]:
        """See LinkClassifier."""
        count = data.packets[links] if packets is None else np.minimum(data.packets[links], packets)
        logit = np.empty(len(links))
        for here in np.unique(count):
            members = np.flatnonzero(count == here)
            for start in range(0, len(members), _BATCH_LINKS):
                part = members[start : start + _BATCH_LINKS]
                batch = data.batch(links[part], int(here), np.zeros(len(part), np.int64))
                logit[part] = self.classifier.logits(batch)
        metadata = self.classifier.metadata
        return Calibration(metadata.temperature, metadata.bias).probability(logit)
