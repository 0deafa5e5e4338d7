"""The time of a tracker, whose scans' stamps may run backward."""


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
        """Time until a stamp [s]; one that runs backward counts as no time passed."""
        return 0.0 if self._stamp_s is None else max(stamp_s - self._stamp_s, 0.0)

    def advance(self, stamp_s: float) -> float:
        """Move on to a stamp [s]; gives the time passed."""
        dt = self.elapsed_s(stamp_s)
        latest = stamp_s if self._stamp_s is None else max(stamp_s, self._stamp_s)
        self._stamp_s = stamp_s if stamp_s < latest - self.max_backward_s else latest
        return dt
