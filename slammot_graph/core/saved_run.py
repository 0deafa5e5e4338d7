"""A run read back from its folder: plain arrays, and the scans and points that belong to them."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from slammot_graph.core.errors import InputError
from slammot_graph.core.results import GridMap
from slammot_graph.core.scan import Scan
from slammot_graph.core.stamps import have_same_times
from slammot_graph.core.types import BoolArray, FloatArray

_NAME_IT = "name the log of that run"


class _Scans(Protocol):
    path: Path

    def __iter__(self) -> Iterator[Scan]: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class PointLabels:
    """The labels of all beams of a run, n scans of at most `beams` beams.

    Attributes
    ----------
    stamps : (n,) array [s]
    is_valid, is_moving, is_moving_online : (n, beams) bool arrays
        `is_moving` are the final labels, `is_moving_online` those decided when the scan came.
    p_moving : (n, beams) float16 array
        Probability that the beam hit something moving; NaN where not valid.
    """

    stamps: FloatArray
    is_valid: BoolArray
    is_moving: BoolArray
    is_moving_online: BoolArray
    p_moving: npt.NDArray[np.float16]


@dataclass(frozen=True, kw_only=True, eq=False)
class RunFolder:
    """What a run folder holds, n scans in the log's order; only the trajectory must be there.

    Attributes
    ----------
    path : Path
    method : str
        As the summary says; without one, the folder's name.
    stamps : (n,) array [s]
    T_map_base : (n, 3) array
        The trajectory [m, m, rad].
    points : PointLabels or None
        Of the same n scans.
    tracks : (k, 9) array
        The columns of ``tracks.csv``, `core.results.TRACK_COLUMNS` but the last: stamp [s], id, x, y [m], vx,
        vy [m/s] and the covariance of (x, y) [m^2], map frame; NaN in columns that the file does not have.
    grid : GridMap
        Of three states: 0 free, 1 occupied, NaN unknown; without cells where there is no map.
    cov_map : (n, 3, 3) array or None
        Covariance of `T_map_base`, right perturbation (body frame), order (x, y, theta).
    summary : mapping
        ``summary.json``; empty without one.
    """

    path: Path
    method: str
    stamps: FloatArray
    T_map_base: FloatArray
    points: PointLabels | None
    tracks: FloatArray
    grid: GridMap
    cov_map: FloatArray | None
    summary: Mapping[str, Any]

    @property
    def log(self) -> Path | None:
        """The log that was run, where the summary names it."""
        name = self.summary.get("log")
        return Path(name) if isinstance(name, str) else None

    def figure(self, *keys: str) -> float:
        """Give a number of the summary, found by its keys from the outside in; NaN if it is not there."""
        value: Any = self.summary
        for key in keys:
            value = value.get(key) if isinstance(value, Mapping) else None
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return float(value) if is_number else math.nan


def scans_of(run: RunFolder, log: _Scans) -> Iterator[Scan]:
    """Iterate over the scans of a run: those of its log, up to the last one that was run.

    Raises
    ------
    InputError
        The log has other times, or fewer scans than the run.
    """
    n_scans = 0
    for scan in log:
        if n_scans == len(run.stamps):
            return
        if not have_same_times(run.stamps[n_scans : n_scans + 1], np.array([scan.stamp])):
            raise InputError(f"{log.path}: its scans have other times than those of {run.path}; {_NAME_IT}")
        n_scans += 1
        yield scan
    if n_scans < len(run.stamps):
        raise InputError(
            f"{log.path}: has {n_scans} usable scans, {run.path} has {len(run.stamps)}; {_NAME_IT}"
        )


def end_points(run: RunFolder, row: int, scan: Scan) -> tuple[FloatArray, BoolArray]:
    """Give the valid points of a scan at the run's pose, and which of them move by the run's final labels.

    Parameters
    ----------
    run : RunFolder
        Without labels, all points that the laser calls valid are static.
    row : int
        Of the scan in the run.
    scan : Scan

    Returns
    -------
    points : (k, 2) array [m], map frame
    is_moving : (k,) bool array

    Raises
    ------
    InputError
        The labels do not fit the scan's beams.
    """
    if run.points is None:
        is_valid, is_moving = scan.is_valid(), np.zeros(scan.laser.n_beams, dtype=np.bool_)
    else:
        n_beams = scan.laser.n_beams
        is_valid, is_moving = run.points.is_valid[row, :n_beams], run.points.is_moving[row, :n_beams]
        if len(is_valid) < n_beams:
            raise InputError(
                f"{run.path / 'points.npz'}: has labels for {len(is_valid)} beams, the log has {n_beams};"
                f" {_NAME_IT}"
            )
    points = scan.points(run.T_map_base[row])
    is_shown = is_valid & np.isfinite(points).all(axis=1)
    return points[is_shown], is_moving[is_shown]


def moving_points(run: RunFolder, log: _Scans) -> list[FloatArray]:
    """Give the points (k, 2) [m] of each scan of a run that move by its final labels, map frame.

    Raises
    ------
    InputError
        The log is not that of the run.
    """
    points = (end_points(run, row, scan) for row, scan in enumerate(scans_of(run, log)))
    return [of_scan[is_moving] for of_scan, is_moving in points]
