"""Windows round the first path, cut from longer responses as a station asks sensors for them.

Why: what the service sees is mostly 64 taps in one frame, what data sets hold is mostly the full
response; a classifier that was trained on the latter alone loses on the former. Rule kept here:
a window is cut from the response itself, before any preparation, so that noise estimate and
alignment see no more than a sensor's window has; both views of a link are of its group.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from groundstation.channel.preprocess import leading_edges
from groundstation.channel.training.files import Blocks, Table

LEAD_TAPS = (4, 12)
"""Least and most taps before the first path; sensors of ours send 8."""


def windowed(table: Table, blocks: Blocks, windows: tuple[int, ...], seed: int) -> tuple[Table, Blocks]:
    """The rows at least twice as long as the shortest window, each cut to one that is half as long or less.

    ``blocks`` must be those of ``table``. Window and lead are drawn by link from ``seed``.
    """
    allowed = np.sort(np.array(windows))
    kept = np.flatnonzero(table.window_taps >= 2 * allowed[0])
    rng = np.random.default_rng([seed, 37])
    links, link_of = np.unique(table.link[kept], return_inverse=True)
    length = np.zeros(len(links), np.int64)
    length[link_of] = table.window_taps[kept]
    choices = np.searchsorted(2 * allowed, length, side="right")
    taps = allowed[(rng.random(len(links)) * choices).astype(np.int64)][link_of]
    lead = rng.integers(LEAD_TAPS[0], LEAD_TAPS[1] + 1, len(links))[link_of]
    # Where the file tells the first path, the sensor that would have cut there tells it too.
    told = table.first_path_index[kept]
    start = np.where(np.isfinite(told), np.rint(np.nan_to_num(told)).astype(np.int64) - lead, -1)
    start = np.where(np.isfinite(told), np.clip(start, 0, table.window_taps[kept] - taps), -1)
    view = Table(
        is_los=table.is_los[kept],
        group=table.group[kept],
        link=table.link[kept],
        tap_spacing_ns=table.tap_spacing_ns[kept],
        window_taps=taps,
        first_path_index=told - start,
        bandwidth_hz=table.bandwidth_hz[kept],
        grouped=table.grouped,
    )
    return view, _cut(blocks, kept, table.window_taps[kept], taps, lead, start)


def _cut(
    blocks: Blocks,
    kept: NDArray[np.int64],
    length: NDArray[np.int64],
    taps: NDArray[np.int64],
    lead: NDArray[np.int64],
    start: NDArray[np.int64],
) -> Iterator[NDArray[np.float64]]:
    """The cut rows of each block, zero beyond their window; ``start`` −1: before the leading edge."""
    widest = int(taps.max(initial=1))
    row = done = 0
    for block in blocks:
        here = slice(done, int(np.searchsorted(kept, row + len(block))))
        rows = block[kept[here] - row]
        first = start[here].copy()
        for whole in np.unique(length[here][first < 0]):
            members = np.flatnonzero((first < 0) & (length[here] == whole))
            edge = leading_edges(rows[members, :whole], np.full(len(members), np.nan))
            first[members] = np.clip(edge - lead[here][members], 0, whole - taps[here][members])
        place = np.minimum(first[:, None] + np.arange(widest), rows.shape[1] - 1)
        inside = np.arange(widest) < taps[here][:, None]
        row, done = row + len(block), here.stop
        yield np.where(inside, np.take_along_axis(rows, place, axis=1), 0.0)
