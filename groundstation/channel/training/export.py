"""A trained network → the folder that ``load_classifier`` reads.

Rule kept here: one ``model.onnx`` with its weights inside, any number of links and packets,
and ``metadata.json`` without which it is refused.
"""

from __future__ import annotations

import contextlib
import io
import json
import logging
import warnings
from pathlib import Path

import onnx
import torch
from torch import nn

from groundstation.channel.classifier import METADATA_FILE, METADATA_FORMAT, MODEL_FILE, open_session
from groundstation.channel.preprocess import INPUT_BINS, INPUT_CHANNELS, PREPROCESSING_VERSION
from groundstation.domain.errors import InternalError


def export_onnx(model: nn.Module, folder: Path) -> Path:
    """Write ``model.onnx``: input ``packets`` (links, packets, channels, bins), output ``logit`` (links,)."""
    path = folder / MODEL_FILE
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
                output_names=["logit"],
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
    folder: Path, *, version: str, temperature: float, los_threshold: float, seed: int
) -> None:
    """Write ``metadata.json``."""
    tree = {
        "format": METADATA_FORMAT,
        "version": version,
        "temperature": temperature,
        "los_threshold": los_threshold,
        "preprocessing_version": PREPROCESSING_VERSION,
        "input": {"channels": INPUT_CHANNELS, "bins": INPUT_BINS},
        "seed": seed,
    }
    (folder / METADATA_FILE).write_text(json.dumps(tree, indent=2) + "\n", encoding="utf-8")
