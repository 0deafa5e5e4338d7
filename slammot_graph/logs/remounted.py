"""A recorded log whose lasers are mounted otherwise than it says, or whose scans are mended."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from slammot_graph.core.log_info import SourceInfo
from slammot_graph.core.scan import LaserModel, Scan
from slammot_graph.logs.source import LaserLog, SkippedScan, source_of


class RemountedLog:
    """A `LaserLog` as another one, with other mountings or with mended scans.

    Parameters
    ----------
    log : LaserLog
    remount : callable, optional
        Gives the laser to use in place of one of the log.
    mend : callable, optional
        Gives a scan as it is to be used: without some returns, or with other beam times.
    warnings : sequence of str
        Come before those of the log.
    source : SourceInfo, optional
        In place of the same keys of the log's.
    replaces : str, optional
        The log's warnings that have these words are left out.
    """

    def __init__(
        self,
        log: LaserLog,
        remount: Callable[[LaserModel], LaserModel] | None = None,
        *,
        mend: Callable[[Scan], Scan] | None = None,
        warnings: Sequence[str] = (),
        source: SourceInfo | None = None,
        replaces: str | None = None,
    ) -> None:
        self.path: Path = log.path
        self.source: SourceInfo = source_of(log)
        self.source.update(source or {})
        self._log = log
        self._remount = remount
        self._mend = mend
        self._own_warnings = list(warnings)
        self._replaces = replaces
        self.skipped: list[SkippedScan] = log.skipped
        self.warnings: list[str] = self._all_warnings()
        self._lasers: dict[LaserModel, LaserModel] = {}

    @property
    def n_scans(self) -> int:
        """See `LaserLog`."""
        return self._log.n_scans

    def _all_warnings(self) -> list[str]:
        """Its own, and the log's without those that they take the place of."""
        kept = [x for x in self._log.warnings if self._replaces is None or self._replaces not in x]
        return [*self._own_warnings, *kept]

    def __iter__(self) -> Iterator[Scan]:
        """Give the log's scans, mounted otherwise."""
        scans = iter(self._log)
        self.skipped = self._log.skipped
        self.warnings = self._all_warnings()
        return self._remounted(scans, self.warnings)

    def _remounted(self, scans: Iterator[Scan], warnings: list[str]) -> Iterator[Scan]:
        last = now = None
        try:
            for scan in scans:
                if self._remount is None:
                    yield scan if self._mend is None else self._mend(scan)
                    continue
                if now is None or scan.laser is not last:
                    last = scan.laser
                    if last not in self._lasers:
                        self._lasers[last] = self._remount(last)
                    now = self._lasers[last]
                yield replace(scan, laser=now)
        finally:
            close = getattr(scans, "close", None)
            if close is not None:
                close()
            warnings[:] = self._all_warnings()


def upside_down(laser: LaserModel) -> LaserModel:
    """The same laser turned over: its beams run the other way round, seen from above."""
    return replace(laser, angle_min=-laser.angle_min, angle_increment=-laser.angle_increment)
