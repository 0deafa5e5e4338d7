"""A real scheduler and two workers, started by the tests, and what happens when they are killed."""

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from slammot_graph.cli import main
from slammot_graph.core.errors import InputError
from slammot_graph.study.cells import Cell
from slammot_graph.study.code_version import version_of
from slammot_graph.study.dask_workers import DaskWorkers
from slammot_graph.study.data_files import DataFile, data_file
from slammot_graph.study.runner import compute
from tests.study.work import calls, cell

pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("default")  # of other packages, in threads of theirs


class Cluster:
    """A scheduler and two workers in processes of their own."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self.folder = folder
        self.environment = {**environment, "SLAMMOT_CACHE": str(folder / "cache")}
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port: int = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", f"{self.port}")
        self.workers = [self._start_worker() for _ in range(2)]

    def _start(self, *words: str) -> "subprocess.Popen[bytes]":
        code = "from dask.__main__ import main; main()"
        return subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", code, *words, "--no-dashboard"],
            env=self.environment,
            cwd=self.folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def _start_worker(self) -> "subprocess.Popen[bytes]":
        return self._start("worker", self.address, "--nthreads", "1", "--no-nanny", "--death-timeout", "60")

    def kill_worker(self) -> None:
        self.workers[0].send_signal(signal.SIGKILL)
        self.workers[0].wait()

    def restart_scheduler(self) -> None:
        self.scheduler.send_signal(signal.SIGKILL)
        self.scheduler.wait()
        for worker in self.workers:
            worker.kill()
            worker.wait()
        time.sleep(1.0)
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", f"{self.port}")
        self.workers = [self._start_worker() for _ in range(2)]

    def connected(self, n_workers: int = 2) -> DaskWorkers:
        deadline = time.monotonic() + 60.0
        while True:
            try:
                found = DaskWorkers(self.address, wait_s=60.0)
                break
            except InputError:
                assert time.monotonic() < deadline
        while found.n < n_workers and time.monotonic() < deadline:
            time.sleep(0.1)
            found._cores = (0.0, 1)
        return found

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path: Path, environment: dict[str, str]) -> Iterator[Cluster]:
    (tmp_path / "cluster").mkdir()
    made = Cluster(tmp_path / "cluster", environment)
    try:
        yield made
    finally:
        made.close()


def slow_cells(n: int, folder: Path) -> list[Cell]:
    code = version_of("tests.study.work:double")
    return [cell(code=code, x=float(k), folder=str(folder), seconds=0.15) for k in range(n)]


def test_a_worker_that_is_killed_loses_no_cell(cluster: Cluster, tmp_path: Path) -> None:
    workers = cluster.connected()
    outcomes = []
    for outcome in compute(slow_cells(24, tmp_path), workers):
        outcomes.append(outcome)
        if len(outcomes) == 5:
            cluster.kill_worker()
    assert sorted(outcome.cell.arguments["x"] for outcome in outcomes) == list(range(24))
    assert [outcome.error for outcome in outcomes if outcome.scores is None] == []


def test_a_scheduler_that_is_restarted_goes_on(cluster: Cluster, tmp_path: Path) -> None:
    workers = cluster.connected()
    outcomes = []
    for outcome in compute(slow_cells(24, tmp_path), workers):
        outcomes.append(outcome)
        if len(outcomes) == 5:
            cluster.restart_scheduler()
    assert sorted(outcome.cell.arguments["x"] for outcome in outcomes) == list(range(24))
    assert [outcome.error for outcome in outcomes if outcome.scores is None] == []
    assert len(calls(tmp_path)) < 24 + 8  # what was finished stays finished


def test_a_file_that_a_worker_has_not_got_is_brought(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "planner").mkdir()
    monkeypatch.chdir(tmp_path / "planner")  # the workers are in another folder: this path is nothing there
    Path("log").write_text("content", encoding="utf-8")
    file = DataFile(path="log", digest=data_file(Path("log")).digest)
    code = version_of("tests.study.work:content")
    (outcome,) = compute([cell("content", code=code, files={"log": file})], cluster.connected())
    assert outcome.scores == {"text": "content"}
    assert (tmp_path / "cluster" / "cache" / file.digest / "log").is_file()


def test_the_same_table_as_on_this_machine(cluster: Cluster, tiny: Path, tmp_path: Path) -> None:
    cluster.connected().close()
    assert main(["study", str(tiny), "--output", str(tmp_path / "dask"), "--scheduler", cluster.address]) == 0
    assert main(["study", str(tiny), "--output", str(tmp_path / "here"), "--jobs", "1"]) == 0
    for name in ("results.csv", "results.parquet"):
        assert (tmp_path / "dask" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()


def test_no_scheduler_is_one_line(tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["study", str(tiny), "--output", str(tmp_path / "out"), "--scheduler", "tcp://127.0.0.1:9"]
    assert main(words) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert "tcp://127.0.0.1:9: no Dask scheduler answers" in line
