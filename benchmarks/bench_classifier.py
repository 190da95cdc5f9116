"""ONNX Runtime on one thread against PyTorch eager, and preparation together against one by one, in one run.

Claims: the service classifies a link faster without torch; preparing the captures of many links
in one call is several times as fast as one by one. Prints JSON: medians in
milliseconds per batch and their ratio, with the environment. Needs the ``train`` extra.

    python benchmarks/bench_classifier.py [--repeats N] [--packets P]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from reporting import environment, give

from groundstation.channel import ChannelCapture, ChannelSettings, load_classifier
from groundstation.channel.preprocess import INPUT_BINS, INPUT_CHANNELS, network_input, network_inputs
from groundstation.channel.training.model import CnnLstm

WARM_UP = 20
FloatArray = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


def interleaved_ms(repeats: int, *functions: Callable[[], object]) -> tuple[list[float], list[float]]:
    """Median wall time and least processor time of each, called in turn: a busy machine is busy for all."""
    wall, processor = np.empty((2, len(functions), repeats))
    for repeat in range(-WARM_UP, repeats):
        for index, function in enumerate(functions):
            start, start_cpu = time.perf_counter_ns(), time.process_time_ns()
            function()
            if repeat >= 0:
                processor[index, repeat] = 1e-6 * (time.process_time_ns() - start_cpu)
                wall[index, repeat] = 1e-6 * (time.perf_counter_ns() - start)
    return np.median(wall, axis=1).tolist(), np.min(processor, axis=1).tolist()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--packets", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    classifier = load_classifier()
    model = CnnLstm().eval()
    rng = np.random.default_rng(0)
    result: dict[str, object] = {
        "claim": "onnx one thread against torch eager one thread",
        "environment": {**environment("onnxruntime", "torch"), "model": classifier.version},
        "packets": arguments.packets,
        "repeats": arguments.repeats,
    }
    settings = ChannelSettings()
    for links in (1, 64):
        tensor = rng.random((links, arguments.packets, INPUT_CHANNELS, INPUT_BINS)).astype(np.float32)
        magnitude = rng.random((links, 64)) * 0.1
        magnitude[:, 8] = 1.0
        captures = [[ChannelCapture(row, 1.0, 8.0)] * arguments.packets for row in magnitude]
        tensor_torch = torch.from_numpy(tensor)

        def eager(tensor_torch: torch.Tensor = tensor_torch) -> object:
            with torch.inference_mode():
                return model(tensor_torch)

        repeated = np.repeat(magnitude, arguments.packets, axis=0)
        ones = np.ones(len(repeated))

        def together(repeated: FloatArray = repeated, ones: FloatArray = ones) -> object:
            return network_inputs(repeated, ones, 8 * ones, settings)

        def apart(captures: list[list[ChannelCapture]] = captures) -> object:
            return [network_input(capture, settings) for link in captures for capture in link]

        wall, processor = interleaved_ms(
            arguments.repeats,
            partial(classifier.logits, tensor),
            eager,
            partial(classifier.classify, captures),
            together,
            apart,
        )
        onnx_ms, torch_ms, service_ms, together_ms, apart_ms = wall
        result[f"batch_{links}"] = {
            "onnx_ms": onnx_ms,
            "torch_eager_ms": torch_ms,
            "ratio": torch_ms / onnx_ms,
            "ratio_of_least_processor_time": processor[1] / processor[0],
            "classify_with_preprocessing_ms": service_ms,
            "prepare_together_ms": together_ms,
            "prepare_one_by_one_ms": apart_ms,
            "prepare_ratio": apart_ms / together_ms,
            "prepare_ratio_of_least_processor_time": processor[4] / processor[3],
        }
    give(result)


if __name__ == "__main__":
    main()
