"""Labels of moving points against the truth, over everything and over strata."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from slammot_graph.core.errors import InputError
from slammot_graph.core.results import GridMap
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.evaluation.stats import ratio

STANDING_SPEED_M_S = 0.1
"""A person slower than this stands."""


@dataclass(frozen=True, kw_only=True)
class PointScores:
    """Confusion counts of moving points and the scores made from them; a share of nothing is NaN.

    In a set without any static point (a stratum by the speed of what was hit) only `recall` is meaningful:
    precision could not be other than 1, so `precision`, `f1` and `iou` are NaN there.

    Attributes
    ----------
    n_true_positive : int
        Moving points labelled as moving.
    n_false_positive : int
        Static points labelled as moving.
    n_false_negative : int
        Moving points labelled as static.
    n_true_negative : int
        Static points labelled as static.
    """

    n_true_positive: int
    n_false_positive: int
    n_false_negative: int
    n_true_negative: int

    @property
    def n(self) -> int:
        """Number of points."""
        return self.n_moving + self.n_static

    @property
    def n_moving(self) -> int:
        """Number of points that truly move."""
        return self.n_true_positive + self.n_false_negative

    @property
    def n_static(self) -> int:
        """Number of points that truly do not move."""
        return self.n_false_positive + self.n_true_negative

    @property
    def precision(self) -> float:
        """Share of the points labelled as moving that move; NaN if none was labelled."""
        if self.n_static == 0:
            return float("nan")
        return ratio(self.n_true_positive, self.n_true_positive + self.n_false_positive)

    @property
    def recall(self) -> float:
        """Share of the moving points that were labelled; NaN if none moves."""
        return ratio(self.n_true_positive, self.n_moving)

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; NaN if nothing moves and nothing was labelled."""
        if self.n_static == 0:
            return float("nan")
        return ratio(2 * self.n_true_positive, self.n_moving + self.n_true_positive + self.n_false_positive)

    @property
    def iou(self) -> float:
        """Intersection over union of the moving points; NaN if nothing moves and nothing was labelled."""
        if self.n_static == 0:
            return float("nan")
        return ratio(self.n_true_positive, self.n_moving + self.n_false_positive)

    @property
    def static_kept(self) -> float:
        """Share of the static points that were kept as static; NaN if there is none."""
        return ratio(self.n_true_negative, self.n_static)


def evaluate_points(
    is_moving: BoolArray, is_moving_true: BoolArray, is_valid: BoolArray | None = None
) -> PointScores:
    """Count how labels agree with the truth.

    Parameters
    ----------
    is_moving, is_moving_true : bool arrays of one shape, (n, beams) or any other
        Labels and truth.
    is_valid : bool array of that shape, optional
        Beams that are points; others are not counted.

    Raises
    ------
    InputError
        The shapes differ.
    """
    is_valid = _valid(is_moving, is_moving_true, is_valid)
    return PointScores(
        n_true_positive=int(np.count_nonzero(is_moving & is_moving_true & is_valid)),
        n_false_positive=int(np.count_nonzero(is_moving & ~is_moving_true & is_valid)),
        n_false_negative=int(np.count_nonzero(~is_moving & is_moving_true & is_valid)),
        n_true_negative=int(np.count_nonzero(~is_moving & ~is_moving_true & is_valid)),
    )


def evaluate_strata(
    is_moving: BoolArray,
    is_moving_true: BoolArray,
    masks: Mapping[str, BoolArray],
    is_valid: BoolArray | None = None,
) -> dict[str, PointScores]:
    """Evaluate each stratum by itself: a table from its name to its scores, in the order of `masks`.

    Parameters
    ----------
    is_moving, is_moving_true, is_valid
        As for `evaluate_points`.
    masks : mapping of str to bool arrays of the labels' shape
        As made by `strata` or `motion_strata`; they may overlap.

    Raises
    ------
    InputError
        The shapes differ.
    """
    is_valid = _valid(is_moving, is_moving_true, is_valid)
    return {name: evaluate_points(is_moving, is_moving_true, is_valid & mask) for name, mask in masks.items()}


def strata(values: FloatArray, edges: Sequence[float], *, unit: str = "m") -> dict[str, BoolArray]:
    """Divide points by a value of theirs (range, speed, distance to a wall) into half-open intervals.

    Parameters
    ----------
    values : array of any shape
        NaN belongs to no stratum.
    edges : increasing numbers
        k edges make k - 1 strata ``[edge, next edge)``; the last may be infinity.
    unit : str
        For the names: "2 to 5 m", "from 10 m".

    Raises
    ------
    InputError
        Fewer than two edges, or they do not increase.
    """
    if len(edges) < 2 or not np.all(np.diff(edges) > 0):
        raise InputError(f"strata need at least two increasing edges, not {list(edges)}")
    masks = {}
    for low, high in pairwise(edges):
        name = f"from {low:g} {unit}" if np.isinf(high) else f"{low:g} to {high:g} {unit}"
        with np.errstate(invalid="ignore"):
            masks[name] = (values >= low) & (values < high)
    return masks


def motion_strata(speeds: FloatArray, standing_below_m_s: float = STANDING_SPEED_M_S) -> dict[str, BoolArray]:
    """Divide the points on objects into those on persons who stand and on those who walk.

    Parameters
    ----------
    speeds : array of any shape
        Speed of what the beam hit [m/s], see `beam_speeds`; NaN (no object) belongs to neither.
    standing_below_m_s : float
    """
    with np.errstate(invalid="ignore"):
        return {"standing": speeds < standing_below_m_s, "walking": speeds >= standing_below_m_s}


def beam_speeds(object_id: IntArray, object_speeds: FloatArray) -> FloatArray:
    """Look up the speed of what each beam hit.

    Parameters
    ----------
    object_id : (n, beams) int array
        Which object; -1 for none.
    object_speeds : (n, k) array
        Speed of each object at each scan [m/s].

    Returns
    -------
    (n, beams) array [m/s], NaN where no object was hit.

    Raises
    ------
    InputError
        An object without a speed.
    """
    n_objects = object_speeds.shape[1]
    if object_id.max(initial=-1) >= n_objects:
        raise InputError(f"object {object_id.max()} has no speed: there are speeds of {n_objects} objects")
    if n_objects == 0:
        return np.full(object_id.shape, np.nan)
    speeds = np.take_along_axis(object_speeds, np.maximum(object_id, 0), axis=1)
    return np.where(object_id >= 0, speeds, np.nan)


def distance_to_wall(points: FloatArray, grid: GridMap, *, occupied_above: float = 0.8) -> FloatArray:
    """Distance from each point to the centre of the nearest occupied cell.

    Parameters
    ----------
    points : (..., 2) array
        In the grid's frame [m]; points that are not finite give NaN.
    grid : GridMap
        A map without people.
    occupied_above : float
        Probability above which a cell is a wall.

    Returns
    -------
    (...) array [m]; infinity if the map has no wall.
    """
    rows, cols = np.nonzero(np.nan_to_num(grid.p_occupied, nan=0.0) > occupied_above)
    distance = np.full(points.shape[:-1], np.nan)
    is_finite = np.isfinite(points).all(axis=-1)
    if len(rows) == 0:
        distance[is_finite] = np.inf
        return distance
    walls = grid.origin + grid.resolution_m * (np.column_stack([cols, rows]) + 0.5)
    distance[is_finite] = cKDTree(walls).query(points[is_finite])[0]
    return distance


def _valid(is_moving: BoolArray, is_moving_true: BoolArray, is_valid: BoolArray | None) -> BoolArray:
    if is_valid is None:
        is_valid = np.ones(is_moving.shape, dtype=np.bool_)
    if not is_moving.shape == is_moving_true.shape == is_valid.shape:
        raise InputError(
            f"labels, truth and validity need one shape, not {is_moving.shape},"
            f" {is_moving_true.shape} and {is_valid.shape}"
        )
    return is_valid
