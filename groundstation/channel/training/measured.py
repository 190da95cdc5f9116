"""From few measured logs to a classifier: statistics of the direct path, their signs given by physics.

Why: a measuring campaign yields thousands of responses of a few dozen places, and all responses of
one log are one channel: two dozen examples, not thousands. What a network learns from them are
places (measured, docs/studies.md): adapted to them it ranks the logs that it has not seen worse than one
number does, the share of the energy that comes with the first pulse. So few logs only weigh what is known:
four statistics that say how much of a response is its direct path, each more likely obstructed
as it falls, in a logistic regression with a ridge; and the network's own logit as a fifth where logs
left out say that it helps. Rules kept here: a log counts once, however often it was sounded,
and both classes alike; no weight below zero; the statistics are part of the exported graph.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from torch import nn

from groundstation.channel.preprocess import DYNAMIC_RANGE_DB, LEAD_TAPS
from groundstation.channel.training.data import LinkData
from groundstation.channel.training.fit import logits
from groundstation.channel.training.model import CnnLstm

STATISTICS = ("first_pulse_share", "kurtosis", "peak_delay", "rise_time")
NETWORK = "network_logit"
RIDGE = 1.0
"""Precision of a standardised statistic's weight: a prior of a factor e of the odds a standard deviation."""
INNER_FOLDS = 5
"""Folds over the training logs for the decision whether the network's logit is taken in."""
_BEFORE, _PULSE = 2, 4
"""Taps before the leading edge and from it on that hold the first pulse: a pulse lasts about two over its
bandwidth, sensors sample once or twice over it, and the edge is found before the pulse's top."""
_LATEST = 52
"""Taps from the leading edge on that are looked at: what a window of 64 taps holds with up to 12 before it,
so that the statistics of the full response and of such a window are the same."""
_BLOCK = 512


class DirectPath(nn.Module):
    """(n, channels, bins) → (n, len(STATISTICS)): each falls where the direct path is weak.

    Of the taps from two before the leading edge to 52 behind it: the first pulse's share of their energy
    (log; Decawave's first-path against total power, APS006), kurtosis of their magnitudes (log; Güvenç
    et al., 2007), the delay of the strongest (−log(1 + t/ns)) and of the first with half its
    magnitude (likewise; rise time, Maranò et al., 2010). Delay spreads are left out: they say more of the
    room than of the direct path.
    """

    def forward(self, flat: torch.Tensor) -> torch.Tensor:
        """See the class."""
        window = flat[:, :, LEAD_TAPS - _BEFORE : LEAD_TAPS + _LATEST]
        known = window[:, 3]
        level = (window[:, 1] - 1) * (DYNAMIC_RANGE_DB / 10)
        power = torch.pow(10.0, level) * known
        share = power[:, : _BEFORE + _PULSE].sum(1) / power.sum(1).clamp_min(1e-9)
        taps = known.sum(1, keepdim=True).clamp_min(1.0)
        away = (window[:, 0] - (window[:, 0] * known).sum(1, keepdim=True) / taps) * known
        second = (away * away).sum(1) / taps[:, 0]
        fourth = (away * away * away * away).sum(1) / taps[:, 0]
        kurtosis = fourth / (second * second).clamp_min(1e-12)
        spacing_ns = torch.pow(10.0, 4 * flat[:, 2, LEAD_TAPS + 1]) - 1
        top = power.amax(1, keepdim=True)
        taps_to_peak = (torch.cumsum((power >= top).to(power.dtype), 1) == 0).to(power.dtype).sum(1)
        taps_to_half = (torch.cumsum((power >= top / 4).to(power.dtype), 1) == 0).to(power.dtype).sum(1)

        def promptness(count: torch.Tensor) -> torch.Tensor:
            return -torch.log1p((count - _BEFORE).clamp_min(0.0) * spacing_ns)

        return torch.stack(
            [
                torch.log(share.clamp_min(1e-6)),
                torch.log(kurtosis.clamp_min(1e-6)),
                promptness(taps_to_peak),
                promptness(taps_to_half),
            ],
            1,
        )


class MeasuredModel(nn.Module):
    """(links, packets, channels, bins) → (links,) logits: statistics, and the network, weighed by a head."""

    def __init__(self, head: Head, network: CnnLstm) -> None:
        super().__init__()
        self.statistics = DirectPath()
        self.weight = nn.Parameter(torch.tensor(head.weight, dtype=torch.float32))
        self.offset = nn.Parameter(torch.tensor(head.offset, dtype=torch.float32))
        self.network = network if len(head.weight) > len(STATISTICS) else None

    def forward(self, packets: torch.Tensor) -> torch.Tensor:
        """See the class."""
        links, count = packets.shape[0], packets.shape[1]
        inputs = self.statistics(packets.flatten(0, 1)).reshape(links, count, len(STATISTICS)).mean(1)
        if self.network is not None:
            inputs = torch.cat([inputs, self.network(packets)[:, None]], 1)
        logit: torch.Tensor = inputs @ self.weight + self.offset
        return logit


@dataclass(frozen=True, slots=True)
class Head:
    """logit = weight · statistics + offset, of statistics as they come."""

    weight: tuple[float, ...]
    """Of STATISTICS and, where it was taken in, NETWORK; none is negative."""
    offset: float

    def logit(self, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, columns) → (n,); columns beyond the weights are not looked at."""
        result: NDArray[np.float64] = inputs[:, : len(self.weight)] @ np.array(self.weight) + self.offset
        return result


def inputs_of(data: LinkData, network: CnnLstm) -> NDArray[np.float64]:
    """(links, len(STATISTICS) + 1): each statistic's mean over a link's captures, and the network's logit."""
    statistics = DirectPath()
    with torch.no_grad():
        parts = [
            statistics(torch.from_numpy(data.inputs[start : start + _BLOCK])).double().numpy()
            for start in range(0, len(data.inputs), _BLOCK)
        ]
    ends = np.cumsum(np.concatenate([[np.zeros(len(STATISTICS))], np.concatenate(parts)]), axis=0)
    mean = (ends[data.first + data.packets] - ends[data.first]) / data.packets[:, None]
    return np.column_stack([mean, logits(network, data, np.arange(len(data)))])


def log_weights(group: NDArray[np.int64], is_los: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(links,) every log of a class alike, both classes alike; they sum to the number of logs."""
    _, index, count = np.unique(group, return_inverse=True, return_counts=True)
    weight = 1 / count[index]
    for state in (True, False):
        part = is_los == state
        if np.any(part):
            weight[part] *= 0.5 * len(count) / weight[part].sum()
    return np.asarray(weight, np.float64)


def deal_groups(
    group: NDArray[np.int64], is_los: NDArray[np.bool_], folds: int, seed: int
) -> NDArray[np.int64]:
    """(links,) fold of each link: whole groups, dealt round by their class (of most links)."""
    rng = np.random.default_rng([seed, 17])
    groups, index = np.unique(group, return_inverse=True)
    los = np.bincount(index, weights=is_los) / np.bincount(index) > 0.5
    fold = np.empty(len(groups), np.int64)
    dealt = 0
    for members in (np.flatnonzero(los), np.flatnonzero(~los)):
        fold[rng.permutation(members)] = (dealt + np.arange(len(members))) % folds
        dealt += len(members)
    return fold[index]


def fit_head(
    inputs: NDArray[np.float64], is_los: NDArray[np.bool_], group: NDArray[np.int64], ridge: float = RIDGE
) -> Head:
    """Weights ≥ 0 of (n, columns) that minimise cross-entropy, a log counting once, plus ridge · |w|² / 2.

    Of standardised columns; one that does not vary gets no weight.
    """
    importance = log_weights(group, is_los)
    share = importance / importance.sum()
    mean = share @ inputs
    deviation = np.sqrt(share @ (inputs - mean) ** 2)
    scale = np.where(deviation > 1e-9, deviation, np.inf)
    design = np.column_stack([(inputs - mean) / scale, np.ones(len(inputs))])
    sign = np.where(is_los, 1.0, -1.0)
    columns = inputs.shape[1]
    penalty = np.append(np.full(columns, ridge), 0.0)

    def loss(parameters: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        margin = sign * (design @ parameters)
        value = importance @ np.logaddexp(0, -margin) + 0.5 * penalty @ parameters**2
        pull = importance * sign * 0.5 * (1 - np.tanh(0.5 * margin))
        return float(value), penalty * parameters - pull @ design

    bounds = [(0.0, None)] * columns + [(None, None)]
    found = minimize(loss, np.zeros(columns + 1), jac=True, method="L-BFGS-B", bounds=bounds).x
    weight = found[:-1] / scale
    return Head(tuple(map(float, weight)), float(found[-1] - weight @ mean))


def choose_head(
    inputs: NDArray[np.float64], is_los: NDArray[np.bool_], group: NDArray[np.int64], seed: int
) -> Head:
    """The statistics' head; with the network's logit where that helps on logs left out.

    It is taken in where the cross-entropy of the logs left out falls by more than one standard error
    (over logs) of the difference: two dozen logs cannot tell less. With one log of a class
    nothing can be left out.
    """
    folds = _inner_folds(group, is_los)
    if folds < 2:
        return fit_head(inputs[:, : len(STATISTICS)], is_los, group)
    importance = log_weights(group, is_los)
    fold = deal_groups(group, is_los, folds, seed)
    gain = np.zeros(len(inputs))
    sign = np.where(is_los, 1.0, -1.0)
    for number in np.unique(fold):
        rest, held_out = fold != number, fold == number
        for columns, direction in ((len(STATISTICS), 1.0), (len(STATISTICS) + 1, -1.0)):
            head = fit_head(inputs[rest, :columns], is_los[rest], group[rest])
            gain[held_out] += direction * np.logaddexp(0, -sign[held_out] * head.logit(inputs[held_out]))
    _, index = np.unique(group, return_inverse=True)
    of_log = np.bincount(index, weights=importance * gain)
    error = math.sqrt(len(of_log) * float(np.var(of_log, ddof=1)))
    columns = len(STATISTICS) + (1 if float(of_log.sum()) > error else 0)
    return fit_head(inputs[:, :columns], is_los, group)


def _inner_folds(group: NDArray[np.int64], is_los: NDArray[np.bool_]) -> int:
    """At most INNER_FOLDS, and so few that no fold takes all logs of a class."""
    scarce = min(len(np.unique(group[is_los == state])) for state in (True, False))
    return min(INNER_FOLDS, scarce)
