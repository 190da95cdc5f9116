"""The paper's CNN–LSTM: a convolutional network per packet, an LSTM over packets (III-B).

Rule kept here: about 72,000 parameters and 1 to 3 MFLOP a packet, as the paper says; any number of
links and packets. Eqs. (21) to (28); the sigmoid of (28) is left to calibration.

Beside the four channels of the input the network sees a fifth that it makes of them: the
share of the energy that has arrived by each delay. On measured responses the share of the
first few nanoseconds is the best single statistic there is (AUC 0.91 by itself), and
convolutions find a ratio of sums hard to learn from few channels. Making it here
and not in the preprocessing keeps it true to a window that training cropped or faded.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from groundstation.channel.preprocess import (
    DYNAMIC_RANGE_DB,
    FINE_TAPS,
    INPUT_CHANNELS,
    LEAD_TAPS,
    TAIL_TAPS,
)

EMBEDDING = 66
"""What the convolutional part says of a packet."""


class CnnLstm(nn.Module):
    """(links, packets, channels, bins) → (links,) logits of line of sight."""

    bin_taps: torch.Tensor

    def __init__(self, dropout: float = 0.1) -> None:
        super().__init__()
        taps = np.concatenate([np.ones(LEAD_TAPS + FINE_TAPS), TAIL_TAPS]).astype(np.float32)
        self.register_buffer("bin_taps", torch.from_numpy(taps), persistent=False)
        self.cnn = nn.Sequential(
            nn.Conv1d(INPUT_CHANNELS + 1, 24, 7, padding=3, bias=False),
            nn.BatchNorm1d(24),
            nn.ReLU(),
            nn.MaxPool1d(2),
            nn.Conv1d(24, 32, 5, padding=2, bias=False),
            nn.BatchNorm1d(32),
            nn.ReLU(),
            nn.MaxPool1d(2),
            nn.Conv1d(32, 48, 5, padding=2, bias=False),
            nn.BatchNorm1d(48),
            nn.ReLU(),
            nn.MaxPool1d(4),
            nn.Flatten(),
            nn.Linear(48 * 8, EMBEDDING),
            nn.ReLU(),
            nn.Dropout(dropout),
        )
        self.lstm = nn.LSTM(EMBEDDING, 64, batch_first=True)
        self.output = nn.Linear(64, 1)

    def embed(self, packets: torch.Tensor) -> torch.Tensor:
        """(links, packets, channels, bins) → (links · packets, EMBEDDING)."""
        flat = packets.flatten(0, 1)
        embedded: torch.Tensor = self.cnn(torch.cat([flat, self.arrived(flat)], 1))
        return embedded

    def arrived(self, flat: torch.Tensor) -> torch.Tensor:
        """(n, channels, bins) → (n, 1, bins) energy up to each bin over that up to the last fine tap.

        Of the magnitudes in dB (channel 1) where there are data (channel 3); a tail bin counts its taps.
        At most 2: a misaligned response has nearly all of its energy in the tail, and such a ratio
        would rule the batch's statistics.
        """
        power = torch.pow(10.0, (flat[:, 1:2] - 1) * (DYNAMIC_RANGE_DB / 10)) * flat[:, 3:4] * self.bin_taps
        energy = torch.cumsum(power, 2)
        last_fine = LEAD_TAPS + FINE_TAPS - 1
        share = energy / energy[:, :, last_fine : last_fine + 1].clamp_min(1e-9)
        return share.clamp_max(2.0)

    def decide(self, embedding: torch.Tensor, links: int, count: int) -> torch.Tensor:
        """(links · packets, EMBEDDING) → (links,) logits."""
        hidden, _ = self.lstm(embedding.reshape(links, count, EMBEDDING))
        logit: torch.Tensor = self.output(hidden[:, -1]).squeeze(1)
        return logit

    def forward(self, packets: torch.Tensor) -> torch.Tensor:
        """See the class."""
        return self.decide(self.embed(packets), packets.shape[0], packets.shape[1])


class WithNovelty(nn.Module):
    """The network as it is exported: (links,) logits and (links,) how unlike the training data a link is.

    Novelty is the Mahalanobis distance of a packet's embedding from those of the training
    packets (Lee et al., NeurIPS 2018), over √EMBEDDING; of a link the least of its packets',
    so that one broken packet does not silence a link.
    """

    mean: torch.Tensor
    whitening: torch.Tensor

    def __init__(self, network: CnnLstm, mean: torch.Tensor, whitening: torch.Tensor) -> None:
        super().__init__()
        self.network = network
        self.register_buffer("mean", mean)
        self.register_buffer("whitening", whitening)

    def forward(self, packets: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See the class."""
        links, count = packets.shape[0], packets.shape[1]
        embedding = self.network.embed(packets)
        away = (embedding - self.mean) @ self.whitening
        distance = torch.sqrt((away * away).mean(1)).reshape(links, count)
        return self.network.decide(embedding, links, count), distance.amin(1)


def novelty_statistics(embedding: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(n, EMBEDDING) of training packets → their mean and a whitening matrix (with a 1 % ridge)."""
    wide = embedding.double()
    mean = wide.mean(0)
    covariance = (wide - mean).T @ (wide - mean) / max(len(wide) - 1, 1)
    ridge = 0.01 * covariance.diagonal().mean().clamp_min(1e-6)
    precision = torch.linalg.inv(covariance + ridge * torch.eye(wide.shape[1], dtype=torch.float64))
    return mean.float(), torch.linalg.cholesky(precision).float()


def parameter_count(model: nn.Module) -> int:
    """Trainable parameters."""
    return sum(parameter.numel() for parameter in model.parameters() if parameter.requires_grad)
