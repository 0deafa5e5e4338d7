"""What a log is, and the one door to all formats."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from slammot_graph.errors import InputError
from slammot_graph.scan import Scan


@dataclass(frozen=True, kw_only=True)
class SkippedScan:
    """A scan that could not be used: where it stands in the log (line, message or row) and why."""

    place: str
    reason: str


class LaserLog(Protocol):
    """A re-iterable stream of scans with odometry, in the file's order.

    Each iteration starts anew and reads from the file as it goes; a bad scan is left out, and `skipped`
    lists those met by the latest iteration so far.

    Attributes
    ----------
    path : Path
    n_scans : int
        Scan records in the file, usable or not; known without a full decode.
    skipped : list of SkippedScan
    """

    path: Path
    n_scans: int
    skipped: list[SkippedScan]

    def __iter__(self) -> Iterator[Scan]: ...


def open_log(path: str | Path, *, scan_topic: str | None = None, odom_topic: str | None = None) -> LaserLog:
    """Open a log of any known format, told by its name and its first bytes.

    Parameters
    ----------
    path : str or Path
        CARMEN (``.log .clf``, also ``.gz .bz2``), ROS 1 ``.bag``, a ROS 2 bag folder, ``.db3`` or ``.mcap``, ``.npz``.
    scan_topic, odom_topic : str, optional
        Which topics of a bag to use where several would do.

    Raises
    ------
    InputError
        No such file, an unknown format, a file without laser or odometry, a topic that is not there.
    """
    raise InputError(f"{path}: not yet")
