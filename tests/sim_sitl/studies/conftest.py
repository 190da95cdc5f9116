"""Small real runs that several tests read: a study computed once, in threads of this process."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from sim_sitl.studies.commands import StudyOptions, compute
from sim_sitl.studies.results import Results
from sim_sitl.studies.study import Study


def compute_here(study: Study, trials: int, seed: int = 7) -> Results:
    options = StudyOptions(study.name, trials, seed, Path("out"))
    with ThreadPoolExecutor(1) as pool:
        return compute([study], options, pool, "this process")


@pytest.fixture(scope="session")
def computed() -> Callable[..., Results]:
    """``computed(study, trials, seed=7)``."""
    return compute_here
