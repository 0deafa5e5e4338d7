"""The time of a tracker, whose scans' stamps may run backward or leap."""

import numpy as np

from slammot_graph.core.types import FloatArray

LONGEST_STEP_S = 600.0
"""After a longer one no object is known by where it was, and covariances are still numbers."""


def rising_times(stamps: FloatArray, max_backward_s: float) -> FloatArray:
    """(n,) times [s] of scans for what goes over a whole log, which never fall; see `TrackerClock`."""
    clock = TrackerClock(max_backward_s)
    return np.cumsum([clock.advance(stamp) for stamp in stamps.tolist()])


class TrackerClock:
    """Time since the latest scan.

    Attributes
    ----------
    max_backward_s : float
        A stamp farther back than this is that of a clock which was set back for good.
    """

    def __init__(self, max_backward_s: float) -> None:
        self.max_backward_s = max_backward_s
        self._stamp_s: float | None = None

    def elapsed_s(self, stamp_s: float) -> float:
        """Time until a stamp [s]; one that runs backward counts as no time passed, and a leap as `LONGEST_STEP_S`."""
        return 0.0 if self._stamp_s is None else min(max(stamp_s - self._stamp_s, 0.0), LONGEST_STEP_S)

    def advance(self, stamp_s: float) -> float:
        """Move on to a stamp [s]; gives the time passed."""
        dt = self.elapsed_s(stamp_s)
        latest = stamp_s if self._stamp_s is None else max(stamp_s, self._stamp_s)
        self._stamp_s = stamp_s if stamp_s < latest - self.max_backward_s else latest
        return dt
