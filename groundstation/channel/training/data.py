"""Labelled responses from a file → inputs of the network, by link, split by geometry.

Why: what ``sim-sitl dataset`` writes and what a user measured are read alike
(:mod:`groundstation.channel.training.files`). Rules kept here: responses are checked and
prepared as the service prepares them, block by block; links are split by geometry, never by row.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.channel.features import FEATURE_NAMES, FIT_NAMES, features
from groundstation.channel.preprocess import INPUT_BINS, INPUT_CHANNELS, network_inputs
from groundstation.channel.settings import ChannelSettings
from groundstation.channel.training.files import CSV_FIELDS, Blocks, Table, open_file
from groundstation.channel.training.windows import windowed
from groundstation.domain.errors import InputError

__all__ = [
    "CSV_FIELDS",
    "LinkData",
    "joined",
    "read_links",
    "read_windows",
    "single_captures",
    "split_by_group",
]


@dataclass(frozen=True, slots=True, eq=False)
class LinkData:
    """Inputs of the network by link."""

    inputs: NDArray[np.float32]
    """(captures, channels, bins)"""
    first: NDArray[np.int64]
    """(links,) a link's first capture in ``inputs``."""
    packets: NDArray[np.int64]
    """(links,) its captures, oldest first."""
    is_los: NDArray[np.bool_]
    """(links,)"""
    group: NDArray[np.int64]
    """(links,)"""
    bandwidth_hz: NDArray[np.float64]
    """(links,)"""
    window_taps: NDArray[np.int64]
    """(links,)"""
    left_out: dict[str, int]
    """Captures that cannot be judged, by reason."""
    grouped: bool
    """Whether the file tells which rows are of one geometry."""
    features: NDArray[np.float64] | None = None
    """(captures, 8) FEATURE_NAMES and FIT_NAMES of the same captures, where asked for."""
    source: NDArray[np.int64] | None = None
    """(links,) which file a link is of, where there are several."""
    weight: NDArray[np.float64] | None = None
    """(links,) in losses and calibration, mean 1; None: all alike."""

    def __len__(self) -> int:
        return len(self.first)

    def batch(self, links: NDArray[np.int64], packets: int, skip: NDArray[np.int64]) -> NDArray[np.float32]:
        """(links, packets, channels, bins): ``packets`` captures of each link after its first ``skip``."""
        rows = (self.first[links] + skip)[:, None] + np.arange(packets)
        inputs: NDArray[np.float32] = self.inputs[rows]
        return inputs


def read_links(
    path: Path,
    progress: Callable[[int, int], None] | None = None,
    *,
    tap_spacing_ns: float | None = None,
    with_features: bool = False,
    keep_noise: bool = False,
) -> LinkData:
    """Read a NPZ or CSV of labelled responses. Raises InputError saying what is wrong.

    ``tap_spacing_ns`` holds where the file does not say; ``with_features`` adds the statistics
    that the classic classifiers work on; ``keep_noise`` keeps captures that look like noise
    alone, which the service does not judge. ``progress(rows done, rows)``.
    """
    table, blocks = open_file(path, tap_spacing_ns)
    settings = ChannelSettings(reject_noise=not keep_noise)
    links = _preprocess(path, table, blocks, progress, with_features, settings)
    usable, rows = len(links.inputs), len(table.is_los)
    reasons = ", ".join(f"{count} {reason}" for reason, count in links.left_out.items())
    if 2 * usable < rows:
        raise InputError(
            f"{path}: {rows - usable} of {rows} responses cannot be used ({reasons}); half are needed"
        )
    if np.all(links.is_los) or not np.any(links.is_los):
        raise InputError(
            f"{path}: of the usable responses all are of one class; left out: {reasons or 'none'}"
        )
    return links


def read_windows(
    path: Path, windows: tuple[int, ...], seed: int, *, tap_spacing_ns: float | None = None
) -> LinkData:
    """The links of a file whose responses are long enough, cut to one of these windows round the first path.

    Groups are those of :func:`read_links`, for :func:`joined`; ``seed`` draws window and lead. No links
    where none is long enough (:mod:`groundstation.channel.training.windows`).
    """
    table, blocks = open_file(path, tap_spacing_ns)
    return _preprocess(path, *windowed(table, blocks, windows, seed), None, False, ChannelSettings())


def single_captures(data: LinkData) -> LinkData:
    """Every capture a link and a group of its own: the paper's instances, and its split by row."""
    count = len(data.inputs)
    link_of = np.repeat(np.arange(len(data)), data.packets)
    # Captures of a link lie one after another, links in the order of their first ones.
    return replace(
        data,
        first=np.arange(count),
        packets=np.ones(count, np.int64),
        is_los=data.is_los[link_of],
        group=np.arange(count),
        bandwidth_hz=data.bandwidth_hz[link_of],
        window_taps=data.window_taps[link_of],
        grouped=False,
    )


def joined(parts: Sequence[LinkData]) -> LinkData:
    """The links of several readings of the same geometries (windows of one response), one after another."""
    lengths = [len(part.inputs) for part in parts]
    starts = np.cumsum([0, *lengths[:-1]])
    return LinkData(
        inputs=np.concatenate([part.inputs for part in parts]),
        first=np.concatenate([part.first + start for part, start in zip(parts, starts, strict=True)]),
        packets=np.concatenate([part.packets for part in parts]),
        is_los=np.concatenate([part.is_los for part in parts]),
        group=np.concatenate([part.group for part in parts]),
        bandwidth_hz=np.concatenate([part.bandwidth_hz for part in parts]),
        window_taps=np.concatenate([part.window_taps for part in parts]),
        left_out=dict(sum((Counter(part.left_out) for part in parts), Counter())),
        grouped=all(part.grouped for part in parts),
    )


def split_by_group(
    data: LinkData, shares: tuple[float, float, float], seed: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Links for training, validation and test: whole groups, both classes in each.

    Shuffles of the groups are tried in turn until each part has both classes. Raises
    InputError where a hundred do not.
    """
    groups = np.unique(data.group)
    if len(groups) < 3:
        raise InputError(f"the file has {len(groups)} group(s) (log_id); at least 3 are needed to split by")
    for attempt in range(100):
        order = np.random.default_rng([seed, attempt]).permutation(groups)
        cut = np.clip(np.rint(np.cumsum(shares)[:2] * len(groups)).astype(int), 1, len(groups) - 1)
        parts = [np.flatnonzero(np.isin(data.group, part)) for part in np.split(order, cut)]
        if all(len(part) and 0 < np.count_nonzero(data.is_los[part]) < len(part) for part in parts):
            return parts[0], parts[1], parts[2]
    raise InputError(
        f"the {len(groups)} groups (log_id) cannot be split so that training, validation and test "
        "each have both classes; more groups with LOS and with NLOS are needed"
    )


def _preprocess(
    path: Path,
    table: Table,
    blocks: Blocks,
    progress: Callable[[int, int], None] | None,
    with_features: bool,
    settings: ChannelSettings,
) -> LinkData:
    rows = len(table.is_los)
    inputs = np.empty((rows, INPUT_CHANNELS, INPUT_BINS), np.float32)
    statistics = np.zeros((rows if with_features else 0, len(FEATURE_NAMES) + len(FIT_NAMES)))
    kept: list[int] = []
    left_out: Counter[str] = Counter()
    row = 0
    for block in blocks:
        if not np.all(np.isfinite(block)):
            bad = row + int(np.argmax(~np.isfinite(block).all(axis=1)))
            raise InputError(
                f"{path}: cir_magnitude has NaN or infinity, first in row {bad}; finite magnitudes are needed"
            )
        if np.any(block < 0):
            bad = row + int(np.argmax((block < 0).any(axis=1)))
            raise InputError(f"{path}: cir_magnitude is negative, first in row {bad}; magnitudes are needed")
        before = len(kept)
        here = slice(row, row + len(block))
        prepared = np.empty((len(block), INPUT_CHANNELS, INPUT_BINS), np.float32)
        usable_here = np.zeros(len(block), bool)
        for taps in np.unique(table.window_taps[here]):
            members = np.flatnonzero(table.window_taps[here] == taps)
            prepared[members], reasons = network_inputs(
                block[members, :taps],
                table.tap_spacing_ns[here][members],
                table.first_path_index[here][members],
                settings,
            )
            usable_here[members] = [not reason for reason in reasons]
            left_out.update(reason.split(":")[0] for reason in reasons if reason)
        found = np.flatnonzero(usable_here)
        inputs[before : before + len(found)] = prepared[found]
        kept.extend((row + found).tolist())
        row += len(block)
        if with_features:
            windows = table.window_taps[here][found]
            for taps in np.unique(windows):
                members = np.flatnonzero(windows == taps)
                chosen = block[found[members], :taps]
                statistics[before + members] = features(chosen, goodness_of_fit=True)
        if progress is not None:
            progress(row, rows)
    usable = np.array(kept, dtype=np.int64)
    _, first, packets = np.unique(table.link[usable], return_index=True, return_counts=True)
    rows_of_links = usable[first]
    is_los = table.is_los[rows_of_links]
    return LinkData(
        inputs=inputs[: len(usable)],
        first=first.astype(np.int64),
        packets=packets.astype(np.int64),
        is_los=is_los,
        group=table.group[rows_of_links],
        bandwidth_hz=table.bandwidth_hz[rows_of_links],
        window_taps=table.window_taps[rows_of_links],
        left_out=dict(sorted(left_out.items())),
        grouped=table.grouped,
        features=statistics[: len(usable)] if with_features else None,
    )
