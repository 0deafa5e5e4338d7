"""Wall-clock time of the stages of a step."""

import time


class _Stage:
    """A stage being timed."""

    __slots__ = ("_ms", "_name", "_start")

    def __init__(self, ms: dict[str, float], name: str) -> None:
        self._ms = ms
        self._name = name
        self._start = 0.0

    def __enter__(self) -> None:
        self._start = time.perf_counter()

    def __exit__(self, *error: object) -> None:
        took_ms = 1e3 * (time.perf_counter() - self._start)
        self._ms[self._name] = self._ms.get(self._name, 0.0) + took_ms


class Stopwatch:
    """Sums up the time of named stages, in milliseconds, since the last `read`."""

    def __init__(self) -> None:
        self._ms: dict[str, float] = {}
        self._start = time.perf_counter()

    def stage(self, name: str) -> _Stage:
        """Time a stage, as a context; the same name adds up."""
        return _Stage(self._ms, name)

    def restart(self) -> None:
        """Begin a step."""
        self._ms = {}
        self._start = time.perf_counter()

    def read(self) -> dict[str, float]:
        """Stages so far, and the whole step under "step" [ms]."""
        return {**self._ms, "step": 1e3 * (time.perf_counter() - self._start)}
