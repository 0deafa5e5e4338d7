"""True poses: read from a log, associated with a run by time, and the error against them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.saved_run import RunFolder
from slammot_graph.core.stamps import have_same_times, nearest_stamps
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.evaluation.trajectories import AbsoluteError, absolute_error
from slammot_graph.logs import LaserLog, open_log, source_of

MAX_DIFFERENCE_S = 0.01
"""Poses whose stamps differ by more than this do not belong together [s]; evo's default."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TruePath:
    """Where the robot was, scan by scan.

    Attributes
    ----------
    path : Path
        The file that the poses are from.
    stamps : (n,) array [s]
    T_world_base : (n, 3) array
    """

    path: Path
    stamps: FloatArray
    T_world_base: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class TruthScores:
    """A trajectory against true poses.

    Attributes
    ----------
    error : AbsoluteError
        Of the poses that have a true one, aligned.
    n_unmatched : int
        Poses without a true one.
    """

    error: AbsoluteError
    n_unmatched: int


def read_truth(log: LaserLog) -> TruePath:
    """Collect the true poses of a log.

    Raises
    ------
    InputError
        A scan of it has none.
    """
    stamps, poses = [], []
    for scan in log:
        if scan.truth is None or scan.truth.T_world_base is None:
            raise InputError(f"{log.path}: has no true poses; name an .npz log that has the key `poses`")
        stamps.append(scan.stamp)
        poses.append(scan.truth.T_world_base)
    return TruePath(path=log.path, stamps=np.array(stamps), T_world_base=np.array(poses).reshape(-1, 3))


def find_truth(runs: Sequence[RunFolder]) -> TruePath | None:
    """Read the true poses of the log that all runs name; None where it is gone, has none, or has estimates only."""
    paths = {run.log for run in runs if run.log is not None}
    path = paths.pop() if len(paths) == 1 else None
    if path is None or path.suffix != ".npz":
        return None
    try:
        log = open_log(path)
        truth = read_truth(log)
    except InputError:
        return None
    is_exact = source_of(log).get("poses") != "estimates"  # of another run, as in an injected log
    return truth if is_exact and all(_covers(truth, run) for run in runs) else None


def true_poses_of(run: RunFolder, truth: TruePath) -> FloatArray:
    """Give the true poses (n, 3) of the n scans of a run.

    Raises
    ------
    InputError
        The scans of run and truth have different times.
    """
    if not _covers(truth, run):
        raise InputError(
            f"{truth.path}: its scans have other times than those of {run.path}; name the log of these runs"
        )
    return truth.T_world_base[: len(run.stamps)]


def associate(
    stamps: FloatArray, true_stamps: FloatArray, *, max_difference_s: float = MAX_DIFFERENCE_S
) -> tuple[IntArray, IntArray]:
    """Find the true pose of each pose by their times, as evo does.

    Parameters
    ----------
    stamps, true_stamps : (n,), (m,) arrays [s]
        In any order: stamps of recorded logs may run backward.
    max_difference_s : float
        A pose whose nearest true one is farther away is left out.

    Returns
    -------
    i, j : (k,) int arrays
        Pose ``i`` has the true pose ``j``; a true pose may belong to several.
    """
    of = nearest_stamps(true_stamps, stamps, max_difference_s)
    i = np.flatnonzero(of >= 0)
    return i, of[i]


def evaluate_truth(
    stamps: FloatArray,
    T_map_base: FloatArray,
    true_stamps: FloatArray,
    T_world_base: FloatArray,
    *,
    max_difference_s: float = MAX_DIFFERENCE_S,
) -> TruthScores:
    """Compute the absolute trajectory error (ATE) of the poses that have a true one, after alignment.

    Parameters
    ----------
    stamps, T_map_base : (n,) array [s], (n, 3) array
        The trajectory.
    true_stamps, T_world_base : (m,) array [s], (m, 3) array
    max_difference_s : float
        As for `associate`.

    Returns
    -------
    TruthScores
        Over no pose all figures are NaN.
    """
    i, j = associate(stamps, true_stamps, max_difference_s=max_difference_s)
    error = absolute_error(T_map_base[i], T_world_base[j])
    return TruthScores(error=error, n_unmatched=len(stamps) - len(i))


def _covers(truth: TruePath, run: RunFolder) -> bool:
    return len(run.stamps) <= len(truth.stamps) and have_same_times(run.stamps, truth.stamps)
