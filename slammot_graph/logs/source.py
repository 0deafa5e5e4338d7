"""What gives scans: a source, perhaps live, and a recorded log, which can be read again."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, cast, runtime_checkable

from slammot_graph.core.log_info import LogInfo, SourceInfo
from slammot_graph.core.scan import Scan


@dataclass(frozen=True, kw_only=True)
class SkippedScan:
    """A scan that could not be used.

    Attributes
    ----------
    place : str
        Where it is: "line 12" or "message 12 of /scan", counted from 1, or "row 12" of arrays, from 0.
    reason : str
    """

    place: str
    reason: str


class Source(Protocol):
    """A stream of scans, with odometry or without; it may be live: its length is unknown, and it cannot be read twice.

    Attributes
    ----------
    skipped : list of SkippedScan
        The scans left out so far.
    warnings : list of str
        What the user should know: an assumed laser pose, stamps that jump (noted when the iteration ends).

    A source may also have a mapping `source`, see `source_of`.
    """

    skipped: list[SkippedScan]
    warnings: list[str]

    def __iter__(self) -> Iterator[Scan]: ...


@runtime_checkable
class LaserLog(Source, Protocol):
    """A recorded source: re-iterable, in the file's order.

    Each iteration starts at the beginning and streams from the file; a bad scan is left out. `skipped` and
    `warnings` belong to the iteration that was started last, and are reset by it.

    Attributes
    ----------
    path : Path
    """

    path: Path

    @property
    def n_scans(self) -> int:
        """Scan records in the file, usable or not; known without a full decode."""


@contextmanager
def beginning_of(log: Iterable[Scan]) -> Iterator[Iterator[Scan]]:
    """Give a log's scans from its beginning; what reads them is closed at the end of the block."""
    scans = iter(log)
    try:
        yield scans
    finally:
        close = getattr(scans, "close", None)
        if close is not None:
            close()


def source_of(log: Iterable[Scan]) -> SourceInfo:
    """Give what of its file a log uses; empty where the log does not say."""
    return cast(SourceInfo, dict(getattr(log, "source", {})))


def describe(log: Iterable[Scan]) -> LogInfo:
    """Describe a source, or scans alone, for a result; call it after the iteration, which may add warnings."""
    recorded = log if isinstance(log, LaserLog) else None
    return LogInfo(
        path=None if recorded is None else recorded.path,
        source=source_of(log),
        warnings=tuple(getattr(log, "warnings", ())),
        n_scans=None if recorded is None else recorded.n_scans,
    )
