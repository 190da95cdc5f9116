"""Who says line of sight: classifier, sensor or prior, and why.

Exists to keep that order in one place. Rules: a link's own failure costs that link only, and
one prior serves all: it is what the classifier starts from and what an unjudged link gets.
"""

from __future__ import annotations

from collections import Counter as Tally
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from groundstation.channel import ChannelCapture
from groundstation.domain.errors import GroundstationError
from groundstation.domain.events import Event, Severity
from groundstation.domain.radio import LinkWindow
from groundstation.domain.target import LinkVerdict, LosSource

SOLVER_FAULTS = (GroundstationError, ValueError, ArithmeticError, IndexError, np.linalg.LinAlgError)
"""What an impossible problem or a solver may raise; anything else is a fault to be seen."""


class LinkClassifier(Protocol):
    """What the estimator needs of ``groundstation.channel``'s classifier."""

    def classify(
        self, links: Sequence[Sequence[ChannelCapture]], *, prior: float | None = None
    ) -> Sequence[Any]:
        """One verdict a link: ``los_probability``, ``status``, ``reason``."""
        ...


def judge(
    window: LinkWindow, time_ns: int, classifier: LinkClassifier | None, prior: float, tally: Tally[str]
) -> tuple[LinkVerdict, list[Event]]:
    """The verdict on a window's link, and what went wrong on the way."""
    probability, source, reason = prior, LosSource.PRIOR, "no capture"
    events: list[Event] = []
    if window.captures and classifier is None:
        reason = "no classifier loaded"
    elif window.captures and classifier is not None:
        captures = [
            ChannelCapture(capture.magnitude, capture.tap_spacing_ns, capture.first_path_index)
            for capture in window.captures
        ]
        try:
            answer = classifier.classify([captures], prior=prior)[0]
            reason = str(answer.reason)
            if str(answer.status) == "classified":
                probability, source = float(answer.los_probability), LosSource.CLASSIFIER
        except SOLVER_FAULTS as error:
            tally["classifier_failures"] += 1
            reason = f"classifier failed: {error}"
            events.append(
                Event(
                    time_ns, "link.classifier_failed", Severity.ERROR, reason,
                    window.vehicle_id, window.beacon_id,
                )
            )  # fmt: skip
    if source is LosSource.PRIOR and window.sensor_los_probability is not None:
        probability, source = float(window.sensor_los_probability), LosSource.SENSOR
        reason = ""
    tally[f"links_by_{source.value}"] += 1
    verdict = LinkVerdict(
        window.vehicle_id, window.beacon_id, window.end_ns, round(probability, 6), source, reason,
        window.rss_dbm, window.azimuth_rad, window.elevation_rad, len(window.captures),
    )  # fmt: skip
    return verdict, events
