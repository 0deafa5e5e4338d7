"""Relations between poses as ground truth.

After Kuemmerle et al., "On measuring the accuracy of SLAM algorithms", Autonomous Robots, 2009.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.number_rows import read_number_rows
from slammot_graph.core.stamps import STAMP_TOLERANCE_S, nearest_stamps
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation.stats import ErrorStats, summarize
from slammot_graph.evaluation.trajectories import error_sizes


@dataclass(frozen=True, kw_only=True, eq=False)
class Relations:
    """True relative poses.

    Attributes
    ----------
    stamps_from, stamps_to : (n,) arrays [s]
        Some relations run backward in time.
    T_from_to : (n, 3) array
        The pose at `stamps_to` in the frame of the pose at `stamps_from` [m, m, rad].
    """

    stamps_from: FloatArray
    stamps_to: FloatArray
    T_from_to: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class RelationScores:
    """How well a trajectory keeps the relations.

    Attributes
    ----------
    translation_m, rotation_deg : ErrorStats
        Of the error's length [m] and absolute angle [degrees]; `n` relations were used.
    n_relations : int
        Relations within the duration asked for, used or not.
    n_unmatched : int
        Those of them with an end whose time is not in the trajectory.
    """

    translation_m: ErrorStats
    rotation_deg: ErrorStats
    n_relations: int
    n_unmatched: int


def read_relations(path: str | Path) -> Relations:
    """Read a ``.relations`` file: lines ``t1 t2 x y z roll pitch yaw``, of which the planar part is kept.

    Raises
    ------
    InputError
        The file is missing or empty, or a line in it is not eight finite numbers.
    """
    path = Path(path)
    rows = read_number_rows(path, 8)
    if len(rows) == 0:
        raise InputError(f"{path}: holds no relations; expected lines 't1 t2 x y z roll pitch yaw'")
    return Relations(stamps_from=rows[:, 0], stamps_to=rows[:, 1], T_from_to=rows[:, [2, 3, 7]])


def evaluate_relations(
    stamps: FloatArray,
    T_map_base: FloatArray,
    relations: Relations,
    *,
    max_duration_s: float | None = None,
) -> RelationScores:
    """Compare a trajectory with true relations: per relation ``inv(relation) * (inv(p1) * p2)``.

    Parameters
    ----------
    stamps : (n,) array
        Times of the poses [s], in any order; of equal ones the first pose counts. A relation's time belongs to a
        pose if their stamps differ by at most `STAMP_TOLERANCE_S`.
    T_map_base : (n, 3) array
        The trajectory [m, m, rad].
    relations : Relations
    max_duration_s : float, optional
        Use only relations whose ends lie within this time of each other, ``|t2 - t1| <= max_duration_s``.

    Returns
    -------
    RelationScores
        Over no relation all figures are NaN.

    Raises
    ------
    InputError
        Stamps and poses differ in number.
    """
    if T_map_base.shape != (len(stamps), 3):
        raise InputError(f"{len(stamps)} stamps do not fit poses of shape {T_map_base.shape}")
    chosen = np.ones(len(relations.stamps_from), dtype=np.bool_)
    if max_duration_s is not None:
        chosen = np.abs(relations.stamps_to - relations.stamps_from) <= max_duration_s
    i = nearest_stamps(stamps, relations.stamps_from[chosen], STAMP_TOLERANCE_S)
    j = nearest_stamps(stamps, relations.stamps_to[chosen], STAMP_TOLERANCE_S)
    is_matched = (i >= 0) & (j >= 0)
    T_from_to = relations.T_from_to[chosen][is_matched]
    estimated = se2.between(T_map_base[i[is_matched]], T_map_base[j[is_matched]])
    translation, rotation = error_sizes(se2.between(T_from_to, estimated))
    return RelationScores(
        translation_m=summarize(translation),
        rotation_deg=summarize(rotation),
        n_relations=int(chosen.sum()),
        n_unmatched=int((~is_matched).sum()),
    )
