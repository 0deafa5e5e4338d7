"""Several runs over one log side by side: in one frame, with the figures that tell them apart."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import Relations, RelationScores, absolute_error, evaluate_relations
from slammot_graph.logs import LaserLog
from slammot_graph.run_folder.reader import RunFolder, end_points, have_same_times, scans_of


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedRun:
    """One of several runs, n scans of which it shares the first m with the first run.

    Attributes
    ----------
    name : str
        Tells it from the others: its method, else its folder.
    folder : RunFolder
    T_ref_map : (3,) array
        The run's own map in the map of the first run: both start at the same place.
    T_ref_base : (n, 3) array
        Its trajectory in the map of the first run.
    distance_m : (m,) array
        From the first run's trajectory, scan by scan.
    turn_deg : (m,) array
        The angle between the two, without its sign.
    relations : RelationScores or None
    ate_rmse_m : float
        Root mean square of the absolute trajectory error, aligned; NaN without truth.
    truth_error_m, truth_error_deg : (n,) arrays or None
        Distance and angle to the truth, which is laid onto the start of the first run.
    """

    name: str
    folder: RunFolder
    T_ref_map: FloatArray
    T_ref_base: FloatArray
    distance_m: FloatArray
    turn_deg: FloatArray
    relations: RelationScores | None
    ate_rmse_m: float
    truth_error_m: FloatArray | None
    truth_error_deg: FloatArray | None

    @property
    def distance_rms_m(self) -> float:
        """Root mean square of the distance from the first run's trajectory."""
        return math.sqrt(float(np.mean(self.distance_m**2)))

    @property
    def truth_rms_m(self) -> float:
        """Root mean square of the distance to the truth, both started at the same place; NaN without truth."""
        return math.nan if self.truth_error_m is None else math.sqrt(float(np.mean(self.truth_error_m**2)))


@dataclass(frozen=True, kw_only=True, eq=False)
class TruePath:
    """Where the robot was, scan by scan.

    Attributes
    ----------
    path : Path
        The log that says so.
    stamps : (n,) array [s]
    T_world_base : (n, 3) array
    """

    path: Path
    stamps: FloatArray
    T_world_base: FloatArray


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


def compare(
    folders: Sequence[RunFolder], *, relations: Relations | None = None, truth: TruePath | None = None
) -> list[ComparedRun]:
    """Lay several runs over one log into the map of the first, and judge them.

    Parameters
    ----------
    folders : sequence of RunFolder
        At least one; a run that was cut short is compared as far as it goes.
    relations : Relations, optional
    truth : TruePath, optional

    Raises
    ------
    InputError
        A folder is named twice, or the scans of two runs, or of a run and the truth, have different times.
    """
    reference = folders[0]
    names = _names(folders)
    runs = []
    for name, folder in zip(names, folders, strict=True):
        if not have_same_times(reference.stamps, folder.stamps):
            raise InputError(
                f"{reference.path} and {folder.path}: their scans have different times; name runs of one log"
            )
        T_ref_map = _start_to_start(reference.T_map_base, folder.T_map_base)
        T_ref_base = se2.compose(T_ref_map, folder.T_map_base)
        n = min(len(reference.stamps), len(folder.stamps))
        distance_m, turn_deg = _apart(reference.T_map_base[:n], T_ref_base[:n])
        error_m = error_deg = None
        ate_rmse_m = math.nan
        if truth is not None:
            T_world_base = _truth_of(folder, truth)
            ate_rmse_m = absolute_error(folder.T_map_base, T_world_base).translation_m.rmse
            T_ref_world = _start_to_start(reference.T_map_base, T_world_base)
            error_m, error_deg = _apart(se2.compose(T_ref_world, T_world_base), T_ref_base)
        runs.append(
            ComparedRun(
                name=name,
                folder=folder,
                T_ref_map=T_ref_map,
                T_ref_base=T_ref_base,
                distance_m=distance_m,
                turn_deg=turn_deg,
                relations=None
                if relations is None
                else evaluate_relations(folder.stamps, folder.T_map_base, relations),
                ate_rmse_m=ate_rmse_m,
                truth_error_m=error_m,
                truth_error_deg=error_deg,
            )
        )
    return runs


def true_path(runs: Sequence[ComparedRun], truth: TruePath) -> FloatArray:
    """Give the true poses (n, 3) in the map of the first run, started where that run does."""
    return se2.compose(_start_to_start(runs[0].folder.T_map_base, truth.T_world_base), truth.T_world_base)


def moving_points(folder: RunFolder, log: LaserLog) -> list[FloatArray]:
    """Give the points (k, 2) [m] of each scan of a run that move by its final labels, in its own map.

    Raises
    ------
    InputError
        The log is not that of the run.
    """
    points = (end_points(folder, row, scan) for row, scan in enumerate(scans_of(folder, log)))
    return [of_scan[is_moving] for of_scan, is_moving in points]


def _names(folders: Sequence[RunFolder]) -> list[str]:
    """Call the runs by their methods, or where those are not different by their folders."""
    paths = [folder.path.resolve() for folder in folders]
    twice = [folder.path for folder, path in zip(folders, paths, strict=True) if paths.count(path) > 1]
    if twice:
        raise InputError(f"{twice[0]}: is named twice; name each run folder once")
    for names in ([folder.method for folder in folders], [path.name for path in paths]):
        if max(Counter(names).values()) == 1:
            return names
    return [str(folder.path) for folder in folders]


def _start_to_start(T_ref_base: FloatArray, T_own_base: FloatArray) -> FloatArray:
    """Give the (3,) transform that lays the first of the poses `T_own_base` (n, 3) onto that of `T_ref_base`."""
    return se2.compose(T_ref_base[0], se2.inverse(T_own_base[0]))


def _apart(T_a: FloatArray, T_b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances [m] and absolute angles [degrees] between poses (n, 3)."""
    between = se2.between(T_a, T_b)
    return np.hypot(between[:, 0], between[:, 1]), np.degrees(np.abs(between[:, 2]))


def _truth_of(folder: RunFolder, truth: TruePath) -> FloatArray:
    n = len(folder.stamps)
    if n > len(truth.stamps) or not have_same_times(folder.stamps, truth.stamps):
        raise InputError(
            f"{truth.path}: its scans have other times than those of {folder.path}; name the log of these runs"
        )
    return truth.T_world_base[:n]
