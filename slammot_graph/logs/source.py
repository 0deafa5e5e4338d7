"""What a log is: a re-iterable stream of scans with odometry."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from slammot_graph.core.scan import Scan


@dataclass(frozen=True, kw_only=True)
class SkippedScan:
    """A scan that could not be used.

    Attributes
    ----------
    place : str
        Where it stands: "line 12" or "message 12 of /scan", counted from 1, or "row 12" of arrays, from 0.
    reason : str
    """

    place: str
    reason: str


class LaserLog(Protocol):
    """A re-iterable stream of scans with odometry, in the file's order.

    Each iteration starts anew and reads from the file as it goes; a bad scan is left out. `skipped` and
    `warnings` belong to the iteration that was started last, and begin anew with it.

    Attributes
    ----------
    path : Path
    skipped : list of SkippedScan
        The scans left out so far.
    warnings : list of str
        What a person should know about the log: a mounting that had to be assumed, stamps that jump (noted
        when the iteration ends).

    A log may also have a mapping `source`, see `source_of`.
    """

    path: Path
    skipped: list[SkippedScan]
    warnings: list[str]

    @property
    def n_scans(self) -> int:
        """Scan records in the file, usable or not; known without a full decode."""

    def __iter__(self) -> Iterator[Scan]: ...


def source_of(log: LaserLog) -> dict[str, str]:
    """Tell what of its file a log uses, as plain text.

    Returns
    -------
    dict of str
        ``scan_topic`` and ``odom_topic`` of a bag; ``laser_pose``, the laser in the base as "x y yaw" [m, m, rad],
        and ``laser_pose_from``, which says where that comes from; ``poses`` where the log's true poses are only
        estimates. Empty where the log does not tell.
    """
    return dict(getattr(log, "source", {}))
