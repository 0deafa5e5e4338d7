"""Several runs over one log compared: in one frame, with the errors of each."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.saved_run import RunFolder
from slammot_graph.core.stamps import have_same_times
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation.relations import Relations, RelationScores, evaluate_relations
from slammot_graph.evaluation.trajectories import absolute_error
from slammot_graph.evaluation.truth import TruePath, true_poses_of


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedRun:
    """One of several runs, n scans of which it shares the first m with the first run.

    Attributes
    ----------
    name : str
        Unique among the runs: its method, else its folder.
    folder : RunFolder
    T_ref_map : (3,) array
        The run's own map in the map of the first run: both start at the same place.
    T_ref_base : (n, 3) array
        Its trajectory in the map of the first run.
    distance_m : (m,) array
        From the first run's trajectory, scan by scan.
    turn_deg : (m,) array
        Absolute angle between the two.
    relations : RelationScores or None
    ate_rmse_m : float
        Root mean square of the absolute trajectory error, aligned; NaN without truth.
    truth_error_m, truth_error_deg : (n,) arrays or None
        Distance and angle to the truth, which is aligned with the start of the first run.
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
        """Root mean square of the distance to the truth, aligned at the start; NaN without truth."""
        return math.nan if self.truth_error_m is None else math.sqrt(float(np.mean(self.truth_error_m**2)))


def compare(
    folders: Sequence[RunFolder], *, relations: Relations | None = None, truth: TruePath | None = None
) -> list[ComparedRun]:
    """Transform several runs over one log into the map of the first, and compute their errors.

    Parameters
    ----------
    folders : sequence of RunFolder
        At least one; an interrupted run is compared over its own length.
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
            T_world_base = true_poses_of(folder, truth)
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
    """Give the true poses (n, 3) in the map of the first run, aligned at its start."""
    return se2.compose(_start_to_start(runs[0].folder.T_map_base, truth.T_world_base), truth.T_world_base)


def _names(folders: Sequence[RunFolder]) -> list[str]:
    """Name the runs by their methods, or where those are not unique by their folders."""
    paths = [folder.path.resolve() for folder in folders]
    twice = [folder.path for folder, path in zip(folders, paths, strict=True) if paths.count(path) > 1]
    if twice:
        raise InputError(f"{twice[0]}: is named twice; name each run folder once")
    for names in ([folder.method for folder in folders], [path.name for path in paths]):
        if max(Counter(names).values()) == 1:
            return names
    return [str(folder.path) for folder in folders]


def _start_to_start(T_ref_base: FloatArray, T_own_base: FloatArray) -> FloatArray:
    """Give the (3,) transform that carries the first of the poses `T_own_base` (n, 3) onto that of `T_ref_base`."""
    return se2.compose(T_ref_base[0], se2.inverse(T_own_base[0]))


def _apart(T_a: FloatArray, T_b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances [m] and absolute angles [degrees] between poses (n, 3)."""
    between = se2.between(T_a, T_b)
    return np.hypot(between[:, 0], between[:, 1]), np.degrees(np.abs(between[:, 2]))
