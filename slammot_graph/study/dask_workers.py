"""Workers on other machines: those of a scheduler of dask.distributed."""

import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from slammot_graph.core.errors import InputError
from slammot_graph.study.cells import Task, run_task
from slammot_graph.study.data_files import DataFile, cache_folder, content_of, keep
from slammot_graph.study.runner import Answer, ConnectionLostError, WorkerDiedError

WAIT_S = 300.0
"""So long a scheduler that is gone may take to come back."""
_TRY_S = 5.0


class DaskWorkers:
    """Compute on the workers of a scheduler.

    Parameters
    ----------
    address : str
        Of the scheduler, as tcp://host:8786.
    wait_s : float
        So long it may be away in the middle of a study.

    Raises
    ------
    InputError
        dask.distributed is not installed, or there is no scheduler.
    """

    def __init__(self, address: str, wait_s: float = WAIT_S) -> None:
        self.address = address
        self.wait_s = wait_s
        self._client = self._connected(0.0)
        self._futures: set[Any] = set()
        self._cores = (0.0, 1)

    @property
    def n(self) -> int:
        """Threads of all workers that are there now."""
        asked, n = self._cores
        if time.monotonic() - asked > 2.0:  # workers come and go
            try:
                n = sum(
                    one["nthreads"] for one in self._client.scheduler_info(n_workers=-1)["workers"].values()
                )
            except Exception:  # the connection is going: `is_alive` will tell
                n = 1
            self._cores = (time.monotonic(), n)
        return max(n, 1)

    def submit(self, task: Task, done: Callable[[Answer], None]) -> None:
        """See `Workers`."""
        try:
            future = self._client.submit(run_task, task, pure=False)
        except Exception as error:
            done(ConnectionLostError(str(error)))
            return
        self._futures.add(future)

        def answered(future: Any) -> None:
            self._futures.discard(future)
            if future.status == "finished":
                try:
                    done(future.result())
                except Exception as error:  # the worker is gone with the result that it had told of
                    done(ConnectionLostError(str(error)))
            elif future.status == "error":
                done(WorkerDiedError(str(future.exception())))
            else:
                done(ConnectionLostError(f"{self.address}: {future.status}"))

        future.add_done_callback(answered)

    def is_alive(self) -> bool:
        """See `Workers`."""
        return bool(self._client.status == "running")

    def restart(self) -> None:
        """See `Workers`."""
        self.close()
        self._client = self._connected(self.wait_s)

    def provide(self, file: DataFile) -> None:
        """Send a file to the workers that have not got it, into their caches."""
        content = content_of(Path(file.path))
        has = self._client.run(_has, file.digest)
        lacking = [worker for worker, is_there in has.items() if not is_there]
        if lacking:
            self._client.run(keep, file, content, workers=lacking)

    def close(self) -> None:
        """Give back what was submitted, and leave scheduler and workers running."""
        with contextlib.suppress(Exception):  # the scheduler may be gone
            if self._futures and self.is_alive():
                self._client.cancel(list(self._futures), force=True)
        self._futures.clear()
        with contextlib.suppress(Exception):
            self._client.close(timeout=2)

    def _connected(self, wait_s: float) -> Any:
        try:
            from distributed import Client
        except ImportError:
            raise InputError(
                "--scheduler needs dask.distributed: pip install 'slammot-graph[dask]'"
            ) from None
        end = time.monotonic() + wait_s
        while True:
            try:
                make: Any = Client
                return make(self.address, timeout=_TRY_S, set_as_default=False)
            except (OSError, TimeoutError, ValueError) as error:
                if time.monotonic() > end:
                    away = f" for {wait_s:g} s" if wait_s else ""
                    reason = " ".join(str(error).split())[:200]
                    raise InputError(
                        f"{self.address}: no Dask scheduler answers{away} ({reason}); start one with: dask scheduler."
                        " Finished cells are kept, the same command goes on"
                    ) from None
                time.sleep(1.0)


def _has(digest: str) -> bool:
    """Whether a file was brought to this machine."""
    return (cache_folder() / digest).exists()
