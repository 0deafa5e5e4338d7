"""How often maps, graphs and cells are recorded: all of them stay a share of the bytes of the scans."""

RENEWAL_SHARE = 0.1
"""Maps and graphs are logged when the run has grown by this share: all of them together cost a fixed time a scan."""


class Budget:
    """Says when something big is due, so that all of it stays a share of the scans' bytes.

    Parameters
    ----------
    share : float
        What all of it may add to the bytes of the scans.
    n_scans_between : int
        So many scans lie between two at least.
    renewal : float
        The run must have grown by this share since the last one.
    head_start : float
        How many bytes more, so that a run's beginning has its own before its first scans are sent.
    """

    def __init__(
        self,
        share: float,
        n_scans_between: int,
        *,
        renewal: float = RENEWAL_SHARE,
        head_start: float = 0.0,
    ) -> None:
        self._share = share
        self._n_scans_between = n_scans_between
        self._renewal = renewal
        self._head_start = head_start
        self._n_bytes = 0.0
        self._last_n_bytes = 0.0
        self._last_n_scans = -n_scans_between

    def is_due(self, n_scans: int, scan_bytes: int) -> bool:
        """Tell whether the next one is due after so many scans, of so many bytes."""
        if n_scans - self._last_n_scans < max(self._n_scans_between, self._renewal * n_scans):
            return False
        return self._n_bytes + self._last_n_bytes <= self._share * scan_bytes + self._head_start

    def spend(self, n_scans: int, n_bytes: float) -> None:
        """Say how many bytes one took that was logged after so many scans."""
        self._n_bytes += n_bytes
        self._last_n_bytes = n_bytes
        self._last_n_scans = n_scans
