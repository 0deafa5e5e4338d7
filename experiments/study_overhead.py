"""What a study costs beside its cells: 2,000 small cells on two processes and on a Dask cluster, and planning 10^5."""

import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from experiments.common import Options, Scores, environment_of_checkout, main, say, version_of
from experiments.tables import Table, number, write_tables
from slammot_graph.core.errors import InputError
from slammot_graph.methods import METHODS
from slammot_graph.study.cells import Cell
from slammot_graph.study.dask_workers import DaskWorkers
from slammot_graph.study.plan import plan
from slammot_graph.study.processes import THREAD_VARIABLES, local_workers
from slammot_graph.study.runner import Workers
from slammot_graph.study.store import CellStore
from slammot_graph.study.study_file import ScenarioSpec, Study
from slammot_graph.study.study_run import finish_cells

N_CELLS, QUICK_CELLS = 2000, 40
N_PLANNED, QUICK_PLANNED = 100_000, 1000
SECONDS = 0.05
N_WORKERS = 2
FUNCTION = "experiments.study_overhead:sleep"


def sleep(number: int) -> Scores:
    """Take a while without a core, so that what else the machine does changes little."""
    time.sleep(SECONDS)
    return {"number": number}


def experiment(options: Options) -> None:
    """Overhead of the loop with small cells, memory of the scheduler, time to plan."""
    n_cells = QUICK_CELLS if options.quick else N_CELLS
    rows = [["two processes", *_overhead(local_workers(N_WORKERS), n_cells, None)]]
    with cluster() as (address, scheduler):
        workers = DaskWorkers(address)
        rows.append(["Dask, two workers", *_overhead(workers, n_cells, scheduler)])
    n_planned = QUICK_PLANNED if options.quick else N_PLANNED
    start = time.perf_counter()
    seeds = -(-n_planned // len(METHODS))
    planned = plan(
        Study(methods=tuple(METHODS), seeds=seeds, scenario=(ScenarioSpec(name="one-walker"),)), Path()
    )
    seconds = time.perf_counter() - start
    say(f"study_overhead: {len(planned)} cells planned in {seconds:.1f} s")
    tables = [
        Table(
            heading=f"{n_cells} cells of {SECONDS:g} s",
            columns=[
                "where",
                "wall time [s]",
                "sum of the cells / 2 [s]",
                "overhead",
                "scheduler's peak memory [MB]",
            ],
            rows=rows,
        ),
        Table(
            heading="Planning",
            columns=["cells", "wall time [s]", "peak memory of this process [MB]"],
            rows=[[str(len(planned)), number(seconds, 1), number(_peak_mb("self"), 0)]],
        ),
    ]
    notes = [
        "Cells that sleep. Overhead: wall time, from the first cell submitted to the last one written, over the sum"
        " of the times that the cells took by their own clock, divided among the workers. Processes start before."
    ]
    write_tables("study_overhead", "What a study costs beside its cells", notes, tables, options)


def _overhead(workers: Workers, n_cells: int, scheduler: int | None) -> list[str]:
    code = version_of(FUNCTION)
    cells = [
        Cell(key=f"{k}", function=FUNCTION, code=code, arguments={"number": k}, kind="sleep")
        for k in range(-8, n_cells)
    ]
    with TemporaryDirectory() as folder:
        finish_cells(cells[:8], CellStore(Path(folder), "first"), lambda: _Kept(workers))
        start = time.perf_counter()
        records, errors = finish_cells(cells[8:], CellStore(Path(folder)), lambda: _Kept(workers))
        seconds = time.perf_counter() - start
    assert not errors
    total = sum(records[cell.digest]["seconds"] for cell in cells[8:]) / N_WORKERS
    memory = "-" if scheduler is None else number(_peak_mb(str(scheduler)), 0)
    workers.close()
    say(f"study_overhead: {seconds:.1f} s for {total:.1f} s")
    return [number(seconds, 1), number(total, 1), f"{100 * (seconds / total - 1):.1f}%", memory]


class _Kept:
    """Workers that stay open after the first cells."""

    def __init__(self, workers: Workers) -> None:
        self._workers = workers

    def __getattr__(self, name: str):  # type: ignore[no-untyped-def]
        return getattr(self._workers, name)

    def close(self) -> None:
        """Nothing: they are needed again."""


@contextmanager
def cluster() -> Iterator[tuple[str, int]]:
    """A scheduler and its workers, one thread each: the scheduler's address and process."""
    code = "from dask.__main__ import main; main()"
    environment = {**dict.fromkeys(THREAD_VARIABLES, "1"), **environment_of_checkout()}

    def start(*words: str) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", code, *words, "--no-dashboard"],
            env=environment,
            stderr=subprocess.DEVNULL,
        )

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = f"{free.getsockname()[1]}"
    address = f"tcp://127.0.0.1:{port}"
    processes = [start("scheduler", "--host", "127.0.0.1", "--port", port)]
    try:
        processes += [start("worker", address, "--nthreads", "1", "--no-nanny") for _ in range(N_WORKERS)]
        with closing(_connected(address)) as workers:
            while workers.n < N_WORKERS:
                time.sleep(2.1)
        yield address, processes[0].pid
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait()


def _connected(address: str) -> DaskWorkers:
    """Wait for a scheduler that is just starting."""
    end = time.monotonic() + 60.0
    while True:
        try:
            return DaskWorkers(address)
        except InputError:
            if time.monotonic() > end:
                raise


def _peak_mb(process: str) -> float:
    """Peak resident memory of a process."""
    status = Path(f"/proc/{process}/status")
    match = re.search(r"VmHWM:\s+(\d+) kB", status.read_text(encoding="ascii")) if status.exists() else None
    return float(match[1]) / 1024.0 if match else float("nan")


if __name__ == "__main__":
    sys.exit(main(experiment))
