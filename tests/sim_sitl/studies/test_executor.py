"""Local processes and a real Dask scheduler: the same answers in order, failures by name."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor

import pytest

from groundstation.domain.errors import InputError, InternalError, PeerError, ResourceError
from sim_sitl.studies import executor as module
from sim_sitl.studies.executor import dask_cluster, local_processes, run_all


@pytest.fixture
def threads() -> Iterator[Executor]:
    with ThreadPoolExecutor(2) as pool:
        yield pool


def test_results_come_in_the_tasks_order_and_each_is_told(threads: Executor) -> None:
    told: list[int] = []
    assert run_all(threads, lambda n: n * n, list(range(20)), told.append) == [n * n for n in range(20)]
    assert sorted(told) == list(range(20))


def test_a_failure_names_its_task(threads: Executor) -> None:
    with pytest.raises(InternalError, match="task x: ValueError: invalid literal"):
        run_all(threads, int, ["1", "task x"])


def test_an_error_of_the_projects_own_keeps_its_kind(threads: Executor) -> None:
    def refuse(task: str) -> None:
        raise InputError("no such thing")

    with pytest.raises(InputError, match="chunk 7: no such thing"):
        run_all(threads, refuse, ["chunk 7"])


def test_local_workers_have_one_blas_thread_and_this_process_keeps_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with local_processes(1) as pool:
        assert run_all(pool, os.getenv, ["OMP_NUM_THREADS", "MKL_NUM_THREADS"]) == ["1", "1"]
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


def test_a_worker_that_is_killed_is_told() -> None:
    with pytest.raises(ResourceError, match=r"9: a worker process was ended"), local_processes(1) as pool:
        run_all(pool, os._exit, [9])


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, protocol="tcp", dashboard_address=":0"
    ) as cluster:
        yield cluster.scheduler_address


def test_a_dask_cluster_works_alike(scheduler: str) -> None:
    with dask_cluster(scheduler) as pool:
        assert run_all(pool, abs, [-3, 2, -1]) == [3, 2, 1]


def test_a_failure_on_a_dask_cluster_names_its_task(scheduler: str) -> None:
    with pytest.raises(InternalError, match="y: ValueError"), dask_cluster(scheduler) as pool:
        run_all(pool, int, ["1", "y"])


def test_no_scheduler_there_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SCHEDULER_TIMEOUT_S", 0.3)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(PeerError, match=f"{url}: no Dask scheduler answered.*needed: "), dask_cluster(url):
        pass


def test_a_url_that_is_none_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SCHEDULER_TIMEOUT_S", 0.3)
    with pytest.raises(PeerError, match=r"--scheduler gopher://x: .*needed: "), dask_cluster("gopher://x"):
        pass


def test_a_scheduler_without_workers_is_told() -> None:
    from distributed import LocalCluster

    with (
        LocalCluster(n_workers=0, processes=False, protocol="tcp", dashboard_address=":0") as cluster,
        pytest.raises(PeerError, match="it has no worker; needed: one or more 'dask worker"),
        dask_cluster(cluster.scheduler_address),
    ):
        pass


def test_without_dask_the_error_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module.importlib.util, "find_spec", lambda name: None)
    with (
        pytest.raises(ResourceError, match=r"pip install 'groundstation\[study\]'"),
        dask_cluster("tcp://x:1"),
    ):
        pass
