"""The paper's CNN–LSTM: a convolutional network per packet, an LSTM over packets (III-B).

Rule kept here: about 72,000 parameters and 1 to 3 MFLOP a packet, as the paper says; any number of
links and packets. Eqs. (21) to (28); the sigmoid of (28) is left to calibration.
"""

from __future__ import annotations

import torch
from torch import nn

from groundstation.channel.preprocess import INPUT_CHANNELS


class CnnLstm(nn.Module):
    """(links, packets, channels, bins) → (links,) logits of line of sight."""

    def __init__(self, dropout: float = 0.1) -> None:
        super().__init__()
        self.cnn = nn.Sequential(
            nn.Conv1d(INPUT_CHANNELS, 24, 7, padding=3, bias=False),
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
            nn.Linear(48 * 8, 66),
            nn.ReLU(),
            nn.Dropout(dropout),
        )
        self.lstm = nn.LSTM(66, 64, batch_first=True)
        self.output = nn.Linear(64, 1)

    def forward(self, packets: torch.Tensor) -> torch.Tensor:
        """See the class."""
        links, count = packets.shape[0], packets.shape[1]
        embedding = self.cnn(packets.flatten(0, 1)).reshape(links, count, 66)
        hidden, _ = self.lstm(embedding)
        logit: torch.Tensor = self.output(hidden[:, -1]).squeeze(1)
        return logit


def parameter_count(model: nn.Module) -> int:
    """Trainable parameters."""
    return sum(parameter.numel() for parameter in model.parameters() if parameter.requires_grad)
