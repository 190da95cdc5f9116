"""``sim-sitl study`` as a user runs it: files, the same figures anywhere, one line for what is wrong."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from groundstation.domain.errors import InputError, ResourceError, UsageError
from sim_sitl.cli import main
from sim_sitl.studies import commands, plots
from sim_sitl.studies.commands import NAMES, STUDIES, StudyOptions, run_study

CHEAP = "wls-taylor,lsre-socp,lsre-socp-iterative,posterior,centre"


Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def sim_sitl(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """Runs the console script's function: exit code, stdout, stderr."""

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["sim-sitl", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        out, error = capfd.readouterr()
        return int(ended.value.code or 0), out, error

    return run


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in this process, whose tables other tests have filled; small pictures."""

    @contextmanager
    def one_thread(options: StudyOptions) -> Iterator[tuple[Executor, str]]:
        with ThreadPoolExecutor(1) as pool:
            yield pool, "this process"

    monkeypatch.setattr(commands, "open_executor", one_thread)
    monkeypatch.setattr(plots, "_DPI", 40)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.usefixtures("here")
def test_table4_with_every_method(tmp_path: Path, sim_sitl: Run) -> None:
    out = tmp_path / "new" / "folder"
    code, printed, told = sim_sitl("study", "table4", "--trials", "4", "--out", str(out))
    assert code == 0, told
    assert printed.splitlines()[0] == str(out / "table4.md")
    assert {Path(line) for line in printed.splitlines()} == set(out.iterdir())
    rows = rows_of(out / "table4.csv")
    wanted = [(section.key, name) for section in STUDIES["table4"].sections for name in section.methods]
    assert [(row["section"], row["method"]) for row in rows if row["method"] != "limit"] == wanted
    assert {row["section"] for row in rows if row["method"] == "limit"} == {row["section"] for row in rows}
    assert "28 of 28 trials" in told
    report = (out / "table4.md").read_text()
    for section in STUDIES["table4"].sections:
        assert f"## {section.title}" in report


@pytest.mark.usefixtures("here")
def test_every_figure_and_the_hard_table_in_one_run(tmp_path: Path, sim_sitl: Run) -> None:
    asked = ("study", "all", "--trials", "2", "--out", str(tmp_path), "--methods", CHEAP)
    code, _, told = sim_sitl(*asked, "--quiet")
    assert code == 0, told
    assert told == ""
    for name, study in STUDIES.items():
        rows = rows_of(tmp_path / f"{name}.csv")
        cases = [case for section in study.sections for case in section.cases]
        assert [row["case"] for row in rows if row["method"] == "posterior"] == cases
        assert (tmp_path / f"{name}.md").read_text().startswith(f"# {study.title}\n")
        for section in study.sections:
            assert (tmp_path / f"{name}-{section.key}.png").stat().st_size > 1000
    same = {(row["case"], row["method"]): row["rmse_m"] for row in rows_of(tmp_path / "fig3.csv")}
    for row in rows_of(tmp_path / "table4.csv"):
        if row["case"] == "los-k4":
            assert same[row["case"], row["method"]] == row["rmse_m"]


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, protocol="tcp", dashboard_address=":0"
    ) as cluster:
        yield cluster.scheduler_address


def test_the_figures_do_not_depend_on_where_they_are_computed(tmp_path: Path, scheduler: str) -> None:
    # 260 trials are two chunks of each case.
    def figures(name: str, jobs: int | None, url: str | None = None) -> bytes:
        out = tmp_path / name
        run_study(StudyOptions("fig3", 260, 3, out, jobs, url, ("wls-taylor", "centre")))
        return (out / "fig3.csv").read_bytes()

    one = figures("one", 1)
    assert figures("two", 2) == one
    assert figures("dask", None, scheduler) == one


@pytest.mark.parametrize(
    ("arguments", "code", "parts"),
    [
        (("table5", "--out", "o"), 2, ("unknown study 'table5'", "table4, fig3", "hard")),
        (("table4", "--out", "o", "--methods", "wls-tailor"), 2, ("no 'wls-tailor'", "wls-taylor")),
        (("fig3", "--out", "o", "--methods", "lsre-ccp"), 2, ("fig3 has no 'lsre-ccp'",)),
        (("fig3", "--out", "o", "--jobs", "2", "--scheduler", "tcp://x:1"), 2, ("--jobs does not go",)),
        (("fig3", "--out", "there"), 1, ("--out there is a file; a folder is needed",)),
        (("fig3", "--out", "there/below"), 1, ("there/below: cannot be written to",)),
        (("fig3", "--out", "o", "--trials", "0"), 2, ("--trials",)),
        (("fig3",), 2, ("--out",)),
    ],
)
def test_what_is_wrong_is_told_before_any_work(
    arguments: tuple[str, ...], code: int, parts: tuple[str, ...], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, sim_sitl: Run,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there").write_text("")
    monkeypatch.setattr(commands, "compute", lambda *_: pytest.fail("work was begun"))
    found, printed, told = sim_sitl("study", *arguments)
    assert found == code
    assert printed == ""
    assert "Traceback" not in told
    for part in parts:
        assert part in told


@pytest.mark.parametrize(("change", "value"), [("trials", 0), ("jobs", 0)])
def test_numbers_out_of_range_are_refused_without_the_command_line_too(
    change: str, value: int, tmp_path: Path
) -> None:
    asked = {"name": "fig3", "trials": 5, "seed": 1, "out": tmp_path, change: value}
    with pytest.raises(UsageError, match=f"--{change} {value}; needed: 1 or more"):
        run_study(StudyOptions(**asked))  # type: ignore[arg-type]


def test_no_matplotlib_is_told_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ResourceError, match=r"need matplotlib: pip install 'groundstation\[study\]'"):
        run_study(StudyOptions("fig3", 5, 1, tmp_path))


def test_table3_is_its_own_modules_affair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "table3" in NAMES
    monkeypatch.setattr(commands.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"table3 .* is not in this version"):
        run_study(StudyOptions("table3", 5, 1, tmp_path))
    given: list[StudyOptions] = []

    class Module:
        @staticmethod
        def run(options: StudyOptions, progress: object) -> list[Path]:
            given.append(options)
            return [Path("table3.md")]

    monkeypatch.setattr(commands.importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(commands.importlib, "import_module", lambda name: Module)
    options = StudyOptions("table3", 5, 1, tmp_path)
    assert run_study(options) == [Path("table3.md")]
    assert given == [options]


def test_the_command_in_the_report_can_be_typed(tmp_path: Path) -> None:
    options = StudyOptions("fig3", 50, 2, Path("a b"), jobs=4, methods=("x", "y"))
    assert options.command == "sim-sitl study fig3 --trials 50 --seed 2 --out 'a b' --methods x,y"


def test_ctrl_c_ends_at_once_and_leaves_no_process(tmp_path: Path) -> None:
    arguments = [sys.executable, "-m", "sim_sitl.cli", "study", "fig9", "--trials", "5000", "--jobs", "2"]
    with subprocess.Popen(
        [*arguments, "--out", str(tmp_path)], stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stderr is not None
        assert "0 of 20000 trials" in process.stderr.readline()
        # As a terminal does: to every process of the group.
        os.killpg(process.pid, signal.SIGINT)
        told = process.stderr.read()
        assert process.wait(60) != 0
    assert "Traceback" not in told
    until = time.monotonic() + 60.0
    while _group_lives(process.pid) and time.monotonic() < until:
        time.sleep(0.05)
    assert not _group_lives(process.pid)
    assert list(tmp_path.iterdir()) == []


def _group_lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
