"""Responses to classify, made without the simulator: pulses, exponential tails, noise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from groundstation.channel import ChannelCapture

MakeCapture = Callable[..., ChannelCapture]


def synthetic_magnitude(
    rng: np.random.Generator, taps: int, first_path: int, los: bool, noise: float = 0.01
) -> NDArray[np.float64]:
    """A strong first tap and a short tail (LOS), or a slow rise and a long tail (NLOS)."""
    delay = np.arange(taps) - first_path
    tail = np.where(delay >= 0, np.exp(-np.maximum(delay, 0) / (16 if los else 60)), 0)
    field = (rng.standard_normal(taps) + 1j * rng.standard_normal(taps)) * np.sqrt(0.5)
    response = field * np.sqrt(tail) * (0.3 if los else 1.0)
    if los:
        response[first_path] += 1.0
    field = (rng.standard_normal(taps) + 1j * rng.standard_normal(taps)) * np.sqrt(0.5)
    magnitude: NDArray[np.float64] = np.abs(response + noise * field)
    return magnitude


@pytest.fixture
def make_capture() -> MakeCapture:
    def make(
        *,
        seed: int = 0,
        taps: int = 256,
        first_path: int = 30,
        los: bool = True,
        told: bool = False,
        tap_spacing_ns: float = 1.0,
    ) -> ChannelCapture:
        magnitude = synthetic_magnitude(np.random.default_rng(seed), taps, first_path, los)
        return ChannelCapture(magnitude, tap_spacing_ns, float(first_path) if told else None)

    return make


@pytest.fixture(scope="session")
def tiny_npz(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """240 captures of 80 links in 40 geometries, as sim-sitl would write them."""
    rng = np.random.default_rng(11)
    path = tmp_path_factory.mktemp("data") / "tiny.npz"
    rows, label, log_id, packet = [], [], [], []
    for link in range(80):
        for number in range(3):
            rows.append(synthetic_magnitude(rng, 128, 20, los=link % 2 == 0))
            label.append("LOS" if link % 2 == 0 else "NLOS")
            log_id.append(link // 2)
            packet.append(number)
    np.savez(
        path,
        cir_magnitude=np.array(rows, np.float32),
        label=np.array(label),
        log_id=np.array(log_id),
        packet=np.array(packet),
        tap_spacing_ns=np.array(1.0),
    )
    return path
