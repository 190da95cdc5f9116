"""The service's classifier: an ONNX network and what belongs to it.

Why: P(line of sight) of every link that sent a response, in batches across links. Rules
kept here: ONNX Runtime on one thread, never torch; batches are decided by the data (links in
their order, grouped by number of captures), and probabilities are rounded to six decimals,
so that a link's answer does not depend on its company.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, cast

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from groundstation.channel.calibration import Calibration
from groundstation.channel.capture import (
    ChannelCapture,
    UnusableCaptureError,
    Verdict,
    VerdictStatus,
    as_magnitude,
)
from groundstation.channel.preprocess import (
    INPUT_BINS,
    INPUT_CHANNELS,
    PREPROCESSING_VERSION,
    network_inputs,
)
from groundstation.channel.settings import ChannelSettings
from groundstation.domain.errors import InputError

WEIGHTS_DIR = Path(__file__).parent / "weights"
MODEL_FILE = "model.onnx"
METADATA_FILE = "metadata.json"
METADATA_FORMAT = 1


class Named(Protocol):
    """An output of a network."""

    name: str


class Session(Protocol):
    """The one call of ONNX Runtime that is used (it ships no types)."""

    def run(
        self, output_names: list[str], input_feed: dict[str, NDArray[np.float32]]
    ) -> list[NDArray[np.float32]]:
        """Outputs by name."""

    def get_outputs(self) -> Sequence[Named]:
        """What the network gives."""


@dataclass(frozen=True, slots=True)
class ModelMetadata:
    """What belongs to a network beside its weights (``metadata.json``)."""

    version: str
    """Names the trained model: goes into logs and cards."""
    temperature: float
    preprocessing_version: int
    los_threshold: float
    """Operating threshold on P(line of sight) that the card's confusion is given at."""
    bias: float = 0.0
    """Of the calibration, with the temperature."""
    novelty_max: float = math.inf
    """Links more unlike the training data than this are ``unknown``; infinite where it was not set."""

    @classmethod
    def read(cls, path: Path) -> ModelMetadata:
        """From a file. Raises InputError on a missing, foreign or incompatible one."""
        try:
            tree = json.loads(path.read_text(encoding="utf-8"))
            found = tree["format"]
            metadata = cls(
                version=str(tree["version"]),
                temperature=float(tree["temperature"]),
                preprocessing_version=int(tree["preprocessing_version"]),
                los_threshold=float(tree["los_threshold"]),
                bias=float(tree.get("bias", 0.0)),
                novelty_max=float(tree.get("novelty_max", math.inf)),
            )
        except OSError as error:
            raise InputError(f"cannot read {path}: {error.strerror}; a model's folder holds it") from error
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path} is not a model's metadata ({error!r})") from error
        if found != METADATA_FORMAT:
            raise InputError(f"{path} has format {found}; this program reads {METADATA_FORMAT}")
        if metadata.preprocessing_version != PREPROCESSING_VERSION:
            raise InputError(
                f"the model in {path.parent} needs preprocessing {metadata.preprocessing_version}; "
                f"this program has {PREPROCESSING_VERSION}: train it again"
            )
        if not (np.isfinite(metadata.temperature) and metadata.temperature > 0):
            raise InputError(f"{path}: temperature is {metadata.temperature}; it must be positive")
        if not np.isfinite(metadata.bias) or not metadata.novelty_max > 0:
            raise InputError(f"{path}: bias {metadata.bias} must be finite, novelty_max positive")
        return metadata


class Classifier:
    """Line of sight or not, per link. Build it with :func:`load_classifier`."""

    def __init__(self, session: Session, metadata: ModelMetadata, settings: ChannelSettings) -> None:
        self._session = session
        self._settings = settings
        self._outputs = [output.name for output in session.get_outputs()]
        self._calibration = Calibration(metadata.temperature, metadata.bias)
        self.metadata = metadata
        self.version = metadata.version
        """Names the trained model."""

    def classify(
        self, links: Sequence[Sequence[ChannelCapture]], *, prior: float | None = None
    ) -> list[Verdict]:
        """One verdict a link, in order; each link is its captures, oldest first.

        A capture that cannot be judged is left out (the verdict's reason says so); a link of
        which none is left, or which is unlike anything the network was trained on, is
        ``unknown`` and gets ``prior`` (the settings' where None).
        """
        prior = self._settings.prior_los_probability if prior is None else prior
        inputs, reasons = self._link_inputs(links)

        probability = np.full(len(inputs), prior)
        known = [stacked is not None for stacked in inputs]
        by_packets: dict[int, list[int]] = {}
        for index, stacked in enumerate(inputs):
            if stacked is not None:
                by_packets.setdefault(len(stacked), []).append(index)
        for packets in sorted(by_packets):
            members = by_packets[packets]
            for start in range(0, len(members), self._settings.batch_max):
                batch = members[start : start + self._settings.batch_max]
                tensor = np.stack([cast("NDArray[np.float32]", inputs[index]) for index in batch])
                logit, novelty = self.judge(tensor)
                answers = np.round(self._calibration.probability(logit), 6)
                for index, answer, distance in zip(batch, answers, novelty, strict=True):
                    if distance <= self.metadata.novelty_max:
                        probability[index] = answer
                    else:
                        known[index] = False
                        reasons[index] = (
                            f"unlike anything seen in training: novelty {distance:.2f}, "
                            f"at most {self.metadata.novelty_max:.2f}"
                        )
        return [
            Verdict(
                los_probability=float(probability[index]),
                status=VerdictStatus.CLASSIFIED if known[index] else VerdictStatus.UNKNOWN,
                reason=reasons[index],
                captures_used=len(stacked) if stacked is not None and known[index] else 0,
            )
            for index, stacked in enumerate(inputs)
        ]

    def logits(self, tensor: NDArray[np.float32]) -> NDArray[np.float64]:
        """(links, packets, channels, bins) → (links,) uncalibrated logits."""
        return self.judge(tensor)[0]

    def judge(self, tensor: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(links, packets, channels, bins) → (links,) logits and (links,) novelty (0 where not given)."""
        outputs = self._session.run(self._outputs, {"packets": tensor})
        found = dict(zip(self._outputs, outputs, strict=True))
        logit = found["logit"].astype(np.float64).reshape(-1)
        if "novelty" not in found:
            return logit, np.zeros(len(logit))
        return logit, found["novelty"].astype(np.float64).reshape(-1)

    def _link_inputs(
        self, links: Sequence[Sequence[ChannelCapture]]
    ) -> tuple[list[NDArray[np.float32] | None], list[str]]:
        """Of each link the stacked inputs of its usable captures (None: it has none), and a reason."""
        newest = [link[-self._settings.packets_max :] for link in links]
        flat = [capture for link in newest for capture in link]
        inputs: list[NDArray[np.float32] | None] = [None] * len(flat)
        reasons = [""] * len(flat)
        by_taps: dict[int, list[tuple[int, NDArray[np.float64]]]] = {}
        for index, capture in enumerate(flat):
            try:
                magnitude = as_magnitude(capture)
            except UnusableCaptureError as error:
                reasons[index] = str(error)
            else:
                by_taps.setdefault(len(magnitude), []).append((index, magnitude))
        for members in by_taps.values():
            captures = [flat[index] for index, _ in members]
            tensor, why = network_inputs(
                np.stack([magnitude for _, magnitude in members]),
                np.array([capture.tap_spacing_ns for capture in captures], np.float64),
                np.array(
                    [np.nan if c.first_path_index is None else c.first_path_index for c in captures],
                    np.float64,
                ),
                self._settings,
            )
            for place, (index, _) in enumerate(members):
                inputs[index], reasons[index] = None if why[place] else tensor[place], why[place]

        stacked: list[NDArray[np.float32] | None] = []
        told: list[str] = []
        end = 0
        for link in newest:
            start, end = end, end + len(link)
            usable = [found for found in inputs[start:end] if found is not None]
            last_reason = next((reason for reason in reversed(reasons[start:end]) if reason), "no capture")
            left_out = len(link) - len(usable)
            stacked.append(np.stack(usable) if usable else None)
            if not usable:
                told.append(last_reason)
            else:
                told.append(f"{left_out} of {len(link)} captures left out: {last_reason}" if left_out else "")
        return stacked, told


def load_classifier(path: Path | str | None = None, *, settings: ChannelSettings | None = None) -> Classifier:
    """The shipped classifier, or the one in folder ``path`` (what ``groundstation train`` wrote).

    Raises InputError where the folder holds no model of this program's.
    """
    folder = WEIGHTS_DIR if path is None else Path(path)
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; a model's folder holds {MODEL_FILE} and {METADATA_FILE}")
    metadata = ModelMetadata.read(folder / METADATA_FILE)
    model = folder / MODEL_FILE
    if not model.is_file():
        raise InputError(f"{folder} holds no {MODEL_FILE}")
    session = open_session(model)
    shape = session.get_inputs()[0].shape if session.get_inputs() else []
    if list(shape[2:]) != [INPUT_CHANNELS, INPUT_BINS]:
        raise InputError(f"{model} takes {shape}; (links, packets, {INPUT_CHANNELS}, {INPUT_BINS}) is needed")
    if "logit" not in {output.name for output in session.get_outputs()}:
        raise InputError(f"{model} gives no output named logit")
    return Classifier(cast("Session", session), metadata, settings or ChannelSettings())


def open_session(model: Path) -> onnxruntime.InferenceSession:
    """An ONNX Runtime session on one thread. Raises InputError on a file that is no network."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(model.read_bytes(), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime's exceptions share no public root
        first_line = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{model} is not a network that ONNX Runtime can load: {first_line}") from error
