"""What has changed in a building since its map was made: what stands where nothing was, and what is there no more.

A cell has changed where one map saw it free and the other one occupied, and where the other one has nothing occupied
near it, as the two maps lie beside each other by a few centimetres. A few such cells must lie together; with them go
those beside them that lie nearer to what the other map shows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from slammot_graph.core.results import FREE_BELOW, OCCUPIED_ABOVE, GridMap
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.mapping.saved_grid import aligned

APART_M = 0.15
"""What stands no farther from where something stood has not moved."""

NEXT_M = 0.06
"""Nor has what stands no farther from it than this, even beside what has."""

LEAST_CELLS, TOGETHER_M = 3, 0.2
"""So many changed cells lie together at least, and how near to each other they do."""

BESIDE_M = 0.08
"""Points this near to a changed cell are of it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Changes:
    """Cells that have changed, in one window.

    Attributes
    ----------
    is_new, is_gone : (rows, cols) bool arrays
        Occupied now and free before, and the other way round; row 0 the lowest y.
    low : (2,) int array
        Column and row of the first cell, counted from the map frame's origin.
    resolution_m : float
    """

    is_new: BoolArray
    is_gone: BoolArray
    low: IntArray
    resolution_m: float

    @property
    def new_points(self) -> FloatArray:
        """(k, 2) middles of the cells that are occupied now and were free [m, map frame]."""
        return self._middles(self.is_new)

    @property
    def gone_points(self) -> FloatArray:
        """(k, 2) middles of the cells that were occupied and are free now [m, map frame]."""
        return self._middles(self.is_gone)

    def new_cells(self, points: FloatArray) -> IntArray:
        """(n,) number of the cell of what is new that each point (n, 2) [m, map frame] lies in or beside; -1: none."""
        numbers = np.full(len(points), -1, dtype=np.int64)
        is_new = self.are_new(points)
        cells = np.floor(points[is_new] / self.resolution_m).astype(np.int64) - self.low
        numbers[is_new] = cells[:, 1] * self.is_new.shape[1] + cells[:, 0]
        return numbers

    def are_new(self, points: FloatArray) -> BoolArray:
        """(n,) whether points (n, 2) [m, map frame] are of what is new."""
        return self._beside(self.is_new, points)

    def are_gone(self, points: FloatArray) -> BoolArray:
        """(n,) whether points (n, 2) [m, map frame] are of what is gone."""
        return self._beside(self.is_gone, points)

    def _middles(self, mask: BoolArray) -> FloatArray:
        rows, cols = np.nonzero(mask)
        return np.asarray(
            (np.column_stack([cols, rows]) + self.low + 0.5) * self.resolution_m, dtype=np.float64
        )

    def _beside(self, mask: BoolArray, points: FloatArray) -> BoolArray:
        beside = _grown(mask, BESIDE_M, self.resolution_m)
        found = np.zeros(len(points), dtype=np.bool_)
        finite = np.isfinite(points).all(axis=1)
        cells = np.floor(points[finite] / self.resolution_m).astype(np.int64) - self.low
        inside = ((cells >= 0) & (cells < np.array(mask.shape)[::-1])).all(axis=1)
        found[np.flatnonzero(finite)[inside]] = beside[cells[inside, 1], cells[inside, 0]]
        return found


def find_changes(before: GridMap, now: GridMap) -> Changes:
    """Compare two maps of one place and one resolution, in one frame."""
    (p_before, p_now), low = aligned(before, now)
    with np.errstate(invalid="ignore"):
        was_free, was_occupied = p_before < FREE_BELOW, p_before > OCCUPIED_ABOVE
        is_free, is_occupied = p_now < FREE_BELOW, p_now > OCCUPIED_ABOVE
    resolution_m = now.resolution_m
    return Changes(
        is_new=_apart(is_occupied & was_free, was_occupied, resolution_m),
        is_gone=_apart(was_occupied & is_free, is_occupied, resolution_m),
        low=low,
        resolution_m=resolution_m,
    )


def joint_map(before: GridMap, now: GridMap) -> GridMap:
    """Lay the map of now over one from before: where it knows nothing, the earlier one tells."""
    (p_before, p_now), low = aligned(before, now)
    with np.errstate(invalid="ignore"):
        is_known = (p_now < FREE_BELOW) | (p_now > OCCUPIED_ABOVE)
    p = np.where(is_known | np.isnan(p_before), p_now, p_before)
    return GridMap(
        p_occupied=p, resolution_m=now.resolution_m, origin=low.astype(np.float64) * now.resolution_m
    )


def covering_all(cells_of: Sequence[IntArray], is_taken: BoolArray) -> BoolArray:
    """(s,) which local maps to take, besides those that are, so that all cells are seen that any of them sees.

    Those that show the most cells that no other one has shown come first; a few cells are not worth a local map.
    """
    shown = [cells_of[k] for k in np.flatnonzero(is_taken).tolist()]
    covered = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *shown]))
    left = {k: np.setdiff1d(cells_of[k], covered) for k in np.flatnonzero(~is_taken).tolist()}
    chosen = np.zeros(len(is_taken), dtype=np.bool_)
    while left:
        best = max(left, key=lambda k: len(left[k]))
        taken = left.pop(best)
        if len(taken) < LEAST_CELLS:
            break
        chosen[best] = True
        left = {k: np.setdiff1d(cells, taken) for k, cells in left.items()}
    return chosen


def _apart(mask: BoolArray, other: BoolArray, resolution_m: float) -> BoolArray:
    """Keep the groups of cells of which enough are far from what the other map shows."""
    away_m = (
        ndimage.distance_transform_edt(~other) * resolution_m if other.any() else np.full(mask.shape, np.inf)
    )
    weak = mask & (away_m > NEXT_M)
    group, n = ndimage.label(_grown(weak, 0.5 * TOGETHER_M, resolution_m), structure=np.ones((3, 3)))
    sizes = np.bincount(group[mask & (away_m > APART_M)], minlength=n + 1)
    return np.asarray(weak & (sizes[group] >= LEAST_CELLS))


def _grown(mask: BoolArray, by_m: float, resolution_m: float) -> BoolArray:
    """Add the cells whose middles are this near to one of the mask's."""
    if not mask.any():
        return mask
    return np.asarray(ndimage.distance_transform_edt(~mask) * resolution_m <= by_m)
