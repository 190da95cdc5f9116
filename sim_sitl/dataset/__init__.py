"""Labelled channel data: rows in the paper's format, one file others can read.

Why: the classifier is trained on what this project can make anew from a seed. Rules kept
here: the same seed gives the same bytes; rows are written as they are made, so that memory
does not grow with their number; a geometry (``log_id``) is a link of consecutive captures, and
data are split by it, never by row.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from groundstation.domain.errors import InputError
from sim_sitl.dataset.options import DatasetOptions, dataset_sounder
from sim_sitl.dataset.rows import link_rows
from sim_sitl.dataset.writers import PAPER_FIELDS, open_writer

__all__ = ["PAPER_FIELDS", "DatasetOptions", "dataset_sounder", "write_dataset"]


def write_dataset(
    rows: int,
    seed: int,
    out: Path,
    progress: Callable[[int, int], None] | None = None,
    options: DatasetOptions | None = None,
) -> None:
    """Write ``rows`` labelled captures to ``out``. ``progress(done, rows)`` is called as it goes.

    ``.npz``: ``cir_magnitude`` (N, taps) float32, zero beyond ``window_taps`` (N,), in √mW
    (plain); ``label`` (N,) ``LOS``/``NLOS``; ``log_id`` and ``packet`` (N,); the columns of
    :data:`sim_sitl.dataset.rows.COLUMNS` with units in their names (``first_path_index`` NaN =
    not told); scalars ``seed``, ``format_version``. ``.csv``: the paper's columns and order
    (metres, degrees, dBm, dB; LOS 1 or 0). Raises InputError for rows < 1 or a missing folder,
    UsageError for another suffix.
    """
    options = options or DatasetOptions()
    if rows < 1:
        raise InputError(f"--rows is {rows}; at least 1 is needed")
    if not out.parent.is_dir():
        raise InputError(f"the folder {out.parent} of --out does not exist; create it first")
    with open_writer(out, rows, options.sounder.taps) as writer:
        for row in range(0, rows, options.packets_per_link):
            log_id = row // options.packets_per_link
            # One stream of numbers per geometry: more rows leave the earlier ones as they were.
            link = link_rows(np.random.default_rng([seed, log_id]), log_id, options)
            count = min(options.packets_per_link, rows - row)
            writer.write(
                link.cir_magnitude[:count], {name: values[:count] for name, values in link.columns.items()}
            )
            if progress is not None:
                progress(row + count, rows)
        writer.finish(seed)
