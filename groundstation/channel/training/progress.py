"""Progress of a training: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

from typing import TextIO

from groundstation.channel.training.options import TrainingProgress

_BAR_CELLS = 30


class ConsoleProgress:
    """Call it with each TrainingProgress."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._terminal = stream.isatty()
        self._last = ("", -1)

    def __call__(self, progress: TrainingProgress) -> None:
        """Draw the bar anew, or write a line per tenth (per epoch while training)."""
        share = progress.done / max(progress.total, 1)
        text = f"{progress.stage} {progress.done}/{progress.total} {progress.detail}".rstrip()
        if self._terminal:
            filled = round(_BAR_CELLS * share)
            end = "\n" if progress.done >= progress.total else ""
            self._stream.write(f"\r\x1b[K[{'#' * filled}{'.' * (_BAR_CELLS - filled)}] {text}{end}")
        else:
            mark = (progress.stage, progress.done if progress.stage == "training" else int(10 * share))
            if mark == self._last:
                return
            self._last = mark
            self._stream.write(text + "\n")
        self._stream.flush()
