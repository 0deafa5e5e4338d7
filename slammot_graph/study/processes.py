"""Workers on this machine: the processes of loky, joblib's pool, or this one process itself."""

import os
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from slammot_graph.study.cells import Outcome, Task, run_task
from slammot_graph.study.data_files import DataFile
from slammot_graph.study.runner import Answer, PoolBrokenError

THREAD_VARIABLES = (
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "TBB_NUM_THREADS",
)
"""Each process gets one thread: several processes that each take all cores are slower than one."""
MOST_GROWTH_BYTES = "4e9"
"""A process is only taken for leaking, and started anew, if it grew by so much: packages and a log alone are 0.5 GB."""


def local_workers(jobs: int) -> "Here | Processes":
    """So many processes; for one this process itself, where a debugger sees what it does."""
    return Here() if jobs == 1 else Processes(jobs)


class Here:
    """Compute in this process."""

    n = 1

    def submit(self, task: Task, done: Callable[[Answer], None]) -> None:
        """See `Workers`."""
        done(run_task(task, check_code=False))

    def is_alive(self) -> bool:
        """See `Workers`."""
        return True

    def restart(self) -> None:
        """There is nothing that could break."""

    def provide(self, file: DataFile) -> None:
        """The file is where it was when the study was planned, or nowhere."""

    def close(self) -> None:
        """There is nothing to stop."""


class Processes:
    """Compute in processes of their own.

    Parameters
    ----------
    jobs : int
    """

    def __init__(self, jobs: int) -> None:
        self.n = jobs
        self._pool: Any = None

    def submit(self, task: Task, done: Callable[[Answer], None]) -> None:
        """See `Workers`."""
        if self._pool is None:
            self._pool = self._made()

        def answered(future: "Future[list[Outcome]]") -> None:
            try:
                done(future.result())
            except (BrokenProcessPool, CancelledError, OSError) as error:
                done(PoolBrokenError(str(error)))

        try:
            self._pool.submit(run_task, task, check_code=False).add_done_callback(answered)
        except (BrokenProcessPool, RuntimeError) as error:  # it broke since the last answer
            done(PoolBrokenError(str(error)))

    def is_alive(self) -> bool:
        """See `Workers`; a pool that breaks answers by itself."""
        return True

    def restart(self) -> None:
        """See `Workers`."""
        self.close()

    def provide(self, file: DataFile) -> None:
        """The file is where it was when the study was planned, or nowhere."""

    def close(self) -> None:
        """See `Workers`."""
        if self._pool is not None:
            pool, self._pool = self._pool, None
            pool.shutdown(wait=True, kill_workers=True)

    def _made(self) -> Any:
        from loky import ProcessPoolExecutor

        own = {**dict.fromkeys(THREAD_VARIABLES, "1"), "LOKY_MAX_MEMORY_LEAK_SIZE": MOST_GROWTH_BYTES}
        return ProcessPoolExecutor(
            max_workers=self.n, env={name: value for name, value in own.items() if name not in os.environ}
        )
