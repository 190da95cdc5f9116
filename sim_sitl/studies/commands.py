"""``sim-sitl study``: checks what was asked, computes the cases, writes the reports.

Rules: what is wrong is told before any work; a case that several studies show is computed
once; a study's figures depend on its trials and seed alone, not on where it runs.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import platform
import shlex
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Protocol

from groundstation import __version__
from groundstation.domain.errors import InputError, ResourceError, UsageError
from sim_sitl.studies.chunks import joined_by_case, run_chunk, schedule
from sim_sitl.studies.executor import dask_cluster, local_processes, run_all
from sim_sitl.studies.figures import FIGURES
from sim_sitl.studies.hard import HARD
from sim_sitl.studies.report import write_report
from sim_sitl.studies.results import Provenance, Results
from sim_sitl.studies.study import Study, runs_of
from sim_sitl.studies.table4 import TABLE4

STUDIES: dict[str, Study] = {study.name: study for study in (TABLE4, *FIGURES, HARD)}
"""Studies of the localisation methods, by name."""
OWN_KIND: dict[str, str] = {
    "table3": "the channel classifiers",
    "bandwidth": "how much of a channel response is worth sending",
    "measured": "what a file of few measured logs teaches, beside trees",
    "tracking": "the tracker over flights, beside the exact Bayes filter",
}
"""Studies of other kinds: each a module or package here of that name with ``run(options, progress)``."""
ROWS = ("table3", "bandwidth")
"""Those whose trials are rows of data."""
TRIALS = 5000
"""Unless told otherwise, as the paper …"""
TRIALS_OF: dict[str, int] = {"measured": 10, "tracking": 300}
"""… but of these."""
WITH_CASES = "tracking"
"""The study whose cases can be chosen."""
ALL = "all"
"""Every study of ``STUDIES``; the cases that they share are computed once."""
NAMES = (*OWN_KIND, *STUDIES, ALL)
"""What ``sim-sitl study`` takes."""
_PROGRAMS = ("numpy", "scipy", "onnxruntime")


@dataclass(frozen=True, slots=True)
class StudyOptions:
    """What was asked for."""

    name: str
    """One of ``NAMES``."""
    trials: int
    """Of each case; rows of data for ``table3`` and ``bandwidth``, runs of each case for ``tracking``,
    ways to deal the folds for ``measured``."""
    seed: int
    """Of everything that is drawn."""
    out: Path
    """Folder of the files; made where it is not there."""
    jobs: int | None = None
    """Processes on this machine; None: one a core."""
    scheduler: str | None = None
    """URL of a Dask scheduler instead of local processes."""
    methods: tuple[str, ...] = ()
    """Only these; none: all of the study."""
    cases: tuple[str, ...] = ()
    """Only these (``tracking``); none: all of the study."""
    data: Path | None = None
    """The file that ``measured`` is of."""

    @property
    def command(self) -> str:
        """The command line that gives the same figures."""
        only = ["--methods", ",".join(self.methods)] if self.methods else []
        only += ["--case", ",".join(self.cases)] if self.cases else []
        only += ["--data", self.data.name] if self.data else []
        asked = ["--trials", str(self.trials), "--seed", str(self.seed), "--out", str(self.out), *only]
        return shlex.join(["sim-sitl", "study", self.name, *asked])


class ProgressReport(Protocol):
    """Told how much is done."""

    def __call__(self, done: int, total: int) -> None:
        """``done`` of ``total`` units."""
        ...


def run_study(options: StudyOptions, progress: ProgressReport | None = None) -> list[Path]:
    """Compute and write what ``options`` asks for; returns the files, the report first.

    Raises UsageError, InputError, ResourceError or PeerError before any work where something
    is wrong: an unknown study or method, no matplotlib, a folder that cannot be written, a
    scheduler that does not answer.
    """
    if options.name not in NAMES:
        raise UsageError(f"unknown study {options.name!r}; there are: {', '.join(NAMES)}")
    if options.trials < 1:
        raise UsageError(f"--trials {options.trials}; needed: 1 or more")
    if options.jobs is not None and options.jobs < 1:
        raise UsageError(f"--jobs {options.jobs}; needed: 1 or more")
    if options.jobs is not None and options.scheduler is not None:
        raise UsageError("--jobs does not go with --scheduler: the cluster's workers do the work")
    if options.cases and options.name != WITH_CASES:
        raise UsageError(f"--case goes with {WITH_CASES} only; {options.name} has sections of its own")
    if options.data is not None and options.name != "measured":
        raise UsageError(f"--data goes with measured only; {options.name} makes its own data")
    if options.name in OWN_KIND:
        return _own_kind(options.name)(options, progress)
    studies = _chosen(options)
    if importlib.util.find_spec("matplotlib") is None:
        raise ResourceError("the studies' plots need matplotlib: pip install 'groundstation[study]'")
    make_folder(options.out)
    with open_executor(options) as (executor, workers):
        results = compute(studies, options, executor, workers, progress)
    return [path for study in studies for path in write_report(study, results, options.out)]


@contextmanager
def open_executor(options: StudyOptions) -> Iterator[tuple[Executor, str]]:
    """Where the work is done, and what to call it in a report."""
    if options.scheduler is not None:
        with dask_cluster(options.scheduler) as executor:
            yield executor, "Dask cluster"
        return
    jobs = options.jobs or _cores()
    with local_processes(jobs) as executor:
        yield executor, f"{jobs} local process{'es' if jobs > 1 else ''} of one thread"


def _cores() -> int:
    """Those that this process may use, where the system tells."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def make_folder(out: Path) -> None:
    """Make ``out`` where it is not there, and see that it can be written to."""
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out} is a file; a folder is needed")
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise ResourceError(f"--out {out}: cannot be written to: {error.strerror or error}") from error


def _chosen(options: StudyOptions) -> list[Study]:
    studies = list(STUDIES.values()) if options.name == ALL else [STUDIES[options.name]]
    if not options.methods:
        return studies
    there = dict.fromkeys(name for study in studies for name in study.methods)
    for name in options.methods:
        if name not in there:
            raise UsageError(f"--methods: {options.name} has no {name!r}; it has: {', '.join(there)}")
    return [study for whole in studies if (study := whole.only(options.methods)).sections]


def compute(
    studies: Sequence[Study],
    options: StudyOptions,
    executor: Executor,
    workers: str,
    progress: ProgressReport | None = None,
) -> Results:
    """All cases of ``studies``, each once, on ``executor``; ``workers`` is what the report calls it."""
    began = time.monotonic()
    chunks = schedule(runs_of(studies), options.trials, options.seed)
    total, done = sum(chunk.count for chunk in chunks), 0

    def on_done(count: int) -> None:
        nonlocal done
        done += count
        if progress is not None:
            progress(done, total)

    if progress is not None:
        progress(0, total)
    parts = run_all(executor, run_chunk, chunks, lambda chunk: on_done(chunk.count))
    provenance = Provenance(
        options.command, options.trials, options.seed, workers, time.monotonic() - began, versions()
    )
    return Results.of(joined_by_case(chunks, parts), provenance)


def versions() -> dict[str, str]:
    """What the figures were made with."""
    return {
        "groundstation": __version__,
        "Python": platform.python_version(),
        **{name: version(name) for name in _PROGRAMS},
    }


def _own_kind(name: str) -> Callable[[StudyOptions, ProgressReport | None], list[Path]]:
    module = f"sim_sitl.studies.{name}"
    if importlib.util.find_spec(module) is None:
        raise InputError(f"{name} ({OWN_KIND[name]}) is not in this version of groundstation")
    run: Callable[[StudyOptions, ProgressReport | None], list[Path]] = importlib.import_module(module).run
    return run
