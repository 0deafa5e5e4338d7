"""The gate on the innovations of the matches: one improbable match is taken, a series of them is not."""


class InnovationGate:
    """Watches the normalised innovation squared (NIS) of the matches; a scan may be matched more than once.

    Attributes
    ----------
    max_nis : float
        A match is improbable if its own NIS and the running mean are above this.
    max_counted_nis : float
        A single NIS counts for no more than this in the mean ...
    gain : float
        ... and with this weight.
    mean_nis : float
        Running mean, the latest match included.
    """

    def __init__(self, max_nis: float, max_counted_nis: float, gain: float) -> None:
        self.max_nis = max_nis
        self.max_counted_nis = max_counted_nis
        self.gain = gain
        self.mean_nis = 0.0
        self._mean_before = 0.0

    def start_scan(self) -> None:
        """Move on to the next scan: what was matched last counts from now on."""
        self._mean_before = self.mean_nis

    def is_improbable(self, nis: float) -> bool:
        """Take in the NIS of a match of this scan, in place of an earlier one of the same scan."""
        self.mean_nis = self._mean_before + self.gain * (min(nis, self.max_counted_nis) - self._mean_before)
        return nis > self.max_nis and self.mean_nis > self.max_nis
