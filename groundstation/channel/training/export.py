"""A trained network → the folder that ``load_classifier`` reads, and back.

Rule kept here: one ``model.onnx`` with its weights inside, any number of links and packets,
and ``metadata.json`` without which it is refused. ``weights.npz`` is what a later training
may start from.
"""

from __future__ import annotations

import contextlib
import io
import json
import logging
import math
import warnings
import zipfile
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import nn

from groundstation.channel.classifier import METADATA_FILE, METADATA_FORMAT, MODEL_FILE, open_session
from groundstation.channel.preprocess import INPUT_BINS, INPUT_CHANNELS, PREPROCESSING_VERSION
from groundstation.channel.training.model import CnnLstm, WithNovelty
from groundstation.domain.errors import InputError, InternalError

WEIGHTS_FILE = "weights.npz"


def export_onnx(model: nn.Module, folder: Path) -> Path:
    """Write ``model.onnx``: input ``packets`` (links, packets, channels, bins), output ``logit`` (links,).

    A :class:`~groundstation.channel.training.model.WithNovelty` gives ``novelty`` (links,) too.
    """
    path = folder / MODEL_FILE
    names = ["logit", "novelty"] if isinstance(model, WithNovelty) else ["logit"]
    example = torch.zeros(2, 3, INPUT_CHANNELS, INPUT_BINS)
    dynamic = {"packets": {0: torch.export.Dim("links"), 1: torch.export.Dim("packets")}}
    # A second export in one process would find the LSTM as the first one left it in torch's
    # dispatch cache, decomposed for a fixed number of packets (torch 2.13).
    torch.ops.aten.lstm.input._dispatch_cache.clear()
    exporter_log = logging.getLogger("torch.onnx")
    level = exporter_log.level
    exporter_log.setLevel(logging.ERROR)
    try:
        # The exporter talks to stdout and warns about its own dependencies.
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            program = torch.onnx.export(
                model.eval(),
                (example,),
                input_names=["packets"],
                output_names=names,
                dynamic_shapes=dynamic,
                dynamo=True,
                external_data=False,
                verbose=False,
            )
            if program is None:
                raise InternalError("torch.onnx.export returned nothing")
            program.save(path, external_data=False)
        strip_provenance(path)
    finally:
        exporter_log.setLevel(level)
    shape = open_session(path).get_inputs()[0].shape
    if any(isinstance(size, int) for size in shape[:2]):
        raise InternalError(f"the exported network takes {shape} only; links and packets must be free")
    return path


def strip_provenance(path: Path) -> None:
    """Take out the exporter's notes on each node: they name files of the machine that trained it.

    Without them the same weights give the same bytes, and so the same version, anywhere.
    """
    model = onnx.load(path)
    graph = model.graph
    parts = [model, graph, *graph.node, *graph.input, *graph.output, *graph.value_info, *graph.initializer]
    for function in model.functions:
        parts += [function, *function.node, *function.value_info]
    for part in parts:
        part.ClearField("doc_string")
        part.ClearField("metadata_props")
    onnx.save(model, path)


def write_metadata(
    folder: Path,
    *,
    version: str,
    temperature: float,
    los_threshold: float,
    seed: int,
    bias: float = 0.0,
    novelty_max: float = math.inf,
) -> None:
    """Write ``metadata.json``; an infinite ``novelty_max`` is left out."""
    tree: dict[str, object] = {
        "format": METADATA_FORMAT,
        "version": version,
        "temperature": temperature,
        "bias": bias,
        "los_threshold": los_threshold,
        "preprocessing_version": PREPROCESSING_VERSION,
        "input": {"channels": INPUT_CHANNELS, "bins": INPUT_BINS},
        "seed": seed,
    }
    if math.isfinite(novelty_max):
        tree["novelty_max"] = novelty_max
    (folder / METADATA_FILE).write_text(json.dumps(tree, indent=2) + "\n", encoding="utf-8")


def save_weights(model: CnnLstm, folder: Path) -> None:
    """Write ``weights.npz``: each tensor of the network by its name, as single precision."""
    arrays = {name: value.numpy() for name, value in model.state_dict().items()}
    with (folder / WEIGHTS_FILE).open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def load_weights(folder: Path) -> dict[str, torch.Tensor]:
    """What ``save_weights`` wrote into ``folder``. Raises InputError where it is not this network's."""
    path = folder / WEIGHTS_FILE
    try:
        with np.load(path, allow_pickle=False) as archive:
            state = {name: torch.from_numpy(np.array(archive[name])) for name in archive.files}
        CnnLstm().load_state_dict(state)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error}; a folder that training wrote is needed") from error
    except (ValueError, RuntimeError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} does not hold this network's weights; train it again") from error
    return state
