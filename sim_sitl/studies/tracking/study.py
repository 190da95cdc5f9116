"""``sim-sitl study tracking``: every case, every method, on processes or a cluster.

Rules: what is wrong is told before any work; the figures depend on trials and seed alone.
"""

from __future__ import annotations

import importlib.util
import time
from pathlib import Path
from typing import TYPE_CHECKING

from groundstation.domain.errors import ResourceError, UsageError
from sim_sitl.studies.executor import run_all
from sim_sitl.studies.results import Provenance
from sim_sitl.studies.tracking.cases import CASES
from sim_sitl.studies.tracking.methods import METHODS
from sim_sitl.studies.tracking.pieces import Piece, joined_by_case, pieces_of, run_piece
from sim_sitl.studies.tracking.report import Found, write_report
from sim_sitl.studies.tracking.scores import score_cases

if TYPE_CHECKING:
    from sim_sitl.studies.commands import ProgressReport, StudyOptions

_NEEDED = (("matplotlib", "pictures"), ("filterpy", "particle filter"))


def run(options: StudyOptions, progress: ProgressReport | None = None) -> list[Path]:
    """Compute and write; ``options.trials`` runs a case. Returns the files, the report first.

    Raises UsageError or ResourceError before any work.
    """
    from sim_sitl.studies import commands

    for what, asked, there in (
        ("--case", options.cases, CASES),
        ("--methods", options.methods, METHODS),
    ):
        for name in asked:
            if name not in there:
                raise UsageError(f"{what}: tracking has no {name!r}; it has: {', '.join(there)}")
    for module, what in _NEEDED:
        if importlib.util.find_spec(module) is None:
            raise ResourceError(
                f"the tracking study's {what} needs {module}: pip install 'groundstation[study]'"
            )
    pieces = pieces_of(options.cases or tuple(CASES), options.methods, options.trials, options.seed)
    if not pieces:
        raise UsageError("--methods: no case of the tracking study that was asked for has any of them")
    commands.make_folder(options.out)
    began = time.monotonic()
    total, done = sum(piece.count for piece in pieces), 0

    def on_done(piece: Piece | None) -> None:
        nonlocal done
        done += 0 if piece is None else piece.count
        if progress is not None:
            progress(done, total)

    on_done(None)
    with commands.open_executor(options) as (executor, workers):
        results = joined_by_case(pieces, run_all(executor, run_piece, pieces, on_done))
    scores = score_cases(results, {name: CASES[name].times_s for name in results}, options.seed)
    provenance = Provenance(
        options.command, options.trials, options.seed, workers, time.monotonic() - began, commands.versions()
    )
    return write_report(Found(results, scores, provenance), options.out)
