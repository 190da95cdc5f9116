"""Where the pieces of a study are worked on: processes here, or a Dask cluster.

Exists so that a study knows only ``concurrent.futures``. Rules: nothing of our own beyond it;
one BLAS thread a process, for the cores are shared by processes; a piece that fails is named;
Ctrl-C ends at once.
"""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from typing import Any, TypeVar

from groundstation.domain.errors import GroundstationError, InternalError, PeerError, ResourceError

Task = TypeVar("Task")
Result = TypeVar("Result")

SCHEDULER_TIMEOUT_S = 5.0
_ONE_THREAD = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS", "RAYON_NUM_THREADS",
)  # fmt: skip


@contextmanager
def local_processes(jobs: int) -> Iterator[Executor]:
    """``jobs`` fresh processes of one BLAS thread each; ended at once when the block is left by an error."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    others = set(multiprocessing.active_children())
    # A BLAS reads its thread count when it is loaded: the workers must inherit it.
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    executor = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"))
    try:
        yield executor
    except BaseException:
        executor.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        raise
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
    executor.shutdown()


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Ctrl-C waits until the block is left, and never reaches a process that is started in it.

    It goes to every process of a terminal; the parent alone ends the work.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    # A library's thread may take the signal although this one blocks it; the handler runs here all the same.
    handler = signal.signal(signal.SIGINT, lambda number, _: held.append(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        signal.signal(signal.SIGINT, handler)
    if held:
        raise KeyboardInterrupt


@contextmanager
def dask_cluster(url: str) -> Iterator[Executor]:
    """The workers of the Dask scheduler at ``url``; raises ResourceError or PeerError when there are none."""
    if importlib.util.find_spec("distributed") is None:
        raise ResourceError("--scheduler needs Dask: pip install 'groundstation[study]'")
    from distributed import Client

    try:
        # distributed has no types.
        client: Any = Client(url, timeout=SCHEDULER_TIMEOUT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TimeoutError, ImportError) as error:
        raise PeerError(
            f"--scheduler {url}: no Dask scheduler answered within {SCHEDULER_TIMEOUT_S:.0f} s ({error});"
            " needed: the URL that 'dask scheduler' prints, such as tcp://HOST:8786"
        ) from error
    with client:
        if not client.scheduler_info(n_workers=-1)["workers"]:
            raise PeerError(f"--scheduler {url}: it has no worker; needed: one or more 'dask worker {url}'")
        executor: Executor = client.get_executor(pure=False)
        try:
            yield executor
        except BaseException:
            executor.shutdown(wait=False)
            raise


def run_all(
    executor: Executor,
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    on_done: Callable[[Task], None] = lambda _: None,
) -> list[Result]:
    """``work`` of each task, in their order; raises the first failure, with the task's name in it."""
    # A pool starts its processes while it is given work.
    with _interrupts_held():
        futures = {executor.submit(work, task): number for number, task in enumerate(tasks)}
    results: dict[int, Result] = {}
    for future in as_completed(futures):
        number = futures[future]
        try:
            results[number] = future.result()
        except BrokenExecutor as error:
            raise ResourceError(
                f"{tasks[number]}: a worker process was ended from outside (no memory left?)"
            ) from error
        except GroundstationError as error:
            raise type(error)(f"{tasks[number]}: {error}") from error
        except Exception as error:
            raise InternalError(f"{tasks[number]}: {type(error).__name__}: {error}") from error
        on_done(tasks[number])
    return [results[number] for number in range(len(tasks))]
