"""Wall-clock time of the stages of a step."""

import time


class Stopwatch:
    """Sums up the time of named stages, in milliseconds, since the last `restart`."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin a step."""
        self._laps: list[tuple[str, float]] = []
        self._start = time.perf_counter()

    def lap(self, name: str) -> None:
        """End a stage, which began with the last call; the same name adds up."""
        self._laps.append((name, time.perf_counter()))

    def read(self) -> dict[str, float]:
        """Stages so far, and the whole step under "step" [ms]."""
        ms: dict[str, float] = {}
        before = self._start
        for name, now in self._laps:
            ms[name] = ms.get(name, 0.0) + 1e3 * (now - before)
            before = now
        ms["step"] = 1e3 * (time.perf_counter() - self._start)
        return ms
