"""Wall-clock time of the stages of a step."""

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stopwatch:
    """Sums up the time of named stages, in milliseconds, since the last `read`."""

    def __init__(self) -> None:
        self._ms: dict[str, float] = {}
        self._start = time.perf_counter()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage; the same name adds up."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._ms[name] = self._ms.get(name, 0.0) + 1e3 * (time.perf_counter() - start)

    def restart(self) -> None:
        """Begin a step."""
        self._ms = {}
        self._start = time.perf_counter()

    def read(self) -> dict[str, float]:
        """Stages so far, and the whole step under "step" [ms]."""
        return {**self._ms, "step": 1e3 * (time.perf_counter() - self._start)}
