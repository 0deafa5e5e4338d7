"""Wall-clock time of the stages of a step."""

import time


class Stopwatch:
    """Sums up the time of named stages, in milliseconds, since the last `restart`."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin a step."""
        self._ms: dict[str, float] = {}
        self._start = self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """End a stage, which began with the last call; the same name adds up."""
        now = time.perf_counter()
        self._ms[name] = self._ms.get(name, 0.0) + 1e3 * (now - self._last)
        self._last = now

    def read(self) -> dict[str, float]:
        """Stages so far, and the whole step under "step" [ms]."""
        return {**self._ms, "step": 1e3 * (time.perf_counter() - self._start)}
