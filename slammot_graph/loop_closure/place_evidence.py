"""What speaks for a place where a lost robot's component may lie, and what against it: all of it, on all of the map."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.loop_closure.submap import Submap
from slammot_graph.mapping.local_map import Keyframe
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid

CELL_M, FREE_P = 0.1, 0.3
NEAR_CELLS = 1
"""A point this near to one of the other map lies on it."""

MAX_RANGE_M = 10.0
"""Of the beams that are used: farther away a turn of half a degree, or a grazing beam, frees cells of a wall."""

SQUARE_M = 0.5
"""Points in a square of this side count once: they are of one wall."""

REACH_M = 15.0
"""Keyframes of the map this near to one of the component show what it sees."""

PRIOR_SQUARES = 50
"""Of so many squares the share that is contrary in places that look alike is known beforehand."""


class PlacedKeyframe(NamedTuple):
    """A keyframe and where it lies."""

    T: FloatArray
    keyframe: Keyframe


class Evidence(NamedTuple):
    """Squares of wall that agree with the other map, and that it contradicts: it has seen through them."""

    n_agreeing: int
    n_contrary: int

    def log_ratio(self, p_same: float, p_other: float) -> float:
        """Give the logarithm of the likelihood ratio of this place against one that looks alike.

        By the binomial distribution, with the shares of squares that are contrary in the same place, which people and
        moved things make, and in another one.
        """
        agreeing, contrary = math.log((1.0 - p_same) / (1.0 - p_other)), math.log(p_same / p_other)
        return self.n_agreeing * agreeing + self.n_contrary * contrary

    def share(self, p: float) -> float:
        """Give the share of squares that are contrary, which is p before anything is seen."""
        return (self.n_contrary + p * PRIOR_SQUARES) / (self.n_agreeing + self.n_contrary + PRIOR_SQUARES)


def placed_keyframes(submaps: Sequence[Submap], T_map_anchors: FloatArray) -> list[PlacedKeyframe]:
    """Give each keyframe of local maps once, their anchors placed at poses (n, 3)."""
    placed: dict[int, PlacedKeyframe] = {}
    for submap, T_map_anchor in zip(submaps, T_map_anchors, strict=True):
        T_map_keyframes = se2.compose(T_map_anchor[None, :], submap.T_anchor_keyframes)
        for T, keyframe in zip(T_map_keyframes, submap.keyframes, strict=True):
            placed.setdefault(id(keyframe), PlacedKeyframe(T, keyframe))
    return list(placed.values())


class _Layout:
    """Walls and free space that keyframes show together."""

    def __init__(self, placed: Sequence[PlacedKeyframe]) -> None:
        from scipy.ndimage import maximum_filter

        grid = OccupancyGrid(GridConfig(resolution_m=CELL_M))
        points = []
        for number, (T, keyframe) in enumerate(placed):
            away = keyframe.points_base - keyframe.laser_base
            is_near = np.hypot(away[:, 0], away[:, 1]) < MAX_RANGE_M
            ends = se2.transform(T, np.vstack([keyframe.laser_base, keyframe.points_base[is_near]]))
            points.append(ends[1:])
            all_beams = np.ones(len(ends) - 1, dtype=np.bool_)
            grid.update(number, ends[0], ends[1:], all_beams, all_beams)
        seen = grid.to_map()
        self._origin = seen.origin
        all_points = _one_a_square(np.vstack(points), 0.5 * CELL_M)
        rows, cols, _ = self._cells(all_points, seen.p_occupied.shape)
        # what other scans have seen through was somebody who walked on
        is_there = seen.p_occupied[rows, cols] > 0.5
        self.points = all_points[is_there]
        is_point = np.zeros(seen.p_occupied.shape, dtype=np.bool_)
        is_point[rows[is_there], cols[is_there]] = True
        self.is_near = maximum_filter(is_point, size=2 * NEAR_CELLS + 1)
        with np.errstate(invalid="ignore"):
            self.is_free = (seen.p_occupied < FREE_P) & ~self.is_near

    def judge(self, points: FloatArray) -> Evidence:
        """Count the squares of points (m, 2) that agree, and those in free space."""
        rows, cols, inside = self._cells(points, self.is_near.shape)
        status = np.zeros(len(points), dtype=np.int64)
        status[inside] = self.is_near[rows, cols].astype(np.int64) - self.is_free[rows, cols]
        _, square = np.unique(_square_keys(points, SQUARE_M), return_inverse=True)
        n_agree = np.bincount(square, status > 0)
        n_contrary = np.bincount(square, status < 0)
        n_unknown = np.bincount(square, status == 0)
        is_told = n_agree + n_contrary > n_unknown
        return Evidence(
            int(np.count_nonzero(is_told & (n_agree >= n_contrary))),
            int(np.count_nonzero(is_told & (n_agree < n_contrary))),
        )

    def _cells(self, points: FloatArray, shape: tuple[int, ...]) -> tuple[IntArray, IntArray, BoolArray]:
        cells = np.floor((points - self._origin) / CELL_M).astype(np.int64)
        inside = (cells >= 0).all(axis=1) & (cells[:, 0] < shape[1]) & (cells[:, 1] < shape[0])
        return cells[inside, 1], cells[inside, 0], inside


def weigh_place(old: Sequence[PlacedKeyframe], new: Sequence[PlacedKeyframe]) -> Evidence:
    """Tell how a component fits onto the map where its keyframes lie: its walls on the map, and the map's on it.

    Parameters
    ----------
    old, new : sequence of PlacedKeyframe
        At least one each: all of the map, and all of the component.
    """
    from scipy.spatial import cKDTree

    T_new = np.array([one.T for one in new])
    centre = np.array([*T_new[:, :2].mean(axis=0), 0.0])
    distances, _ = cKDTree(T_new[:, :2]).query(np.array([one.T[:2] for one in old]))
    near = [old[k] for k in np.flatnonzero(distances < REACH_M).tolist()]
    if not near:
        return Evidence(0, 0)
    of_map, of_new = (
        _Layout([PlacedKeyframe(one.T - centre, one.keyframe) for one in placed]) for placed in (near, new)
    )
    a, b = of_map.judge(of_new.points), of_new.judge(of_map.points)
    return Evidence(a.n_agreeing + b.n_agreeing, a.n_contrary + b.n_contrary)


def _square_keys(points: FloatArray, side_m: float) -> IntArray:
    return np.asarray(np.floor(points / side_m).astype(np.int64) @ np.array([1 << 24, 1]))


def _one_a_square(points: FloatArray, side_m: float) -> FloatArray:
    _, first = np.unique(_square_keys(points, side_m), return_index=True)
    return points[np.sort(first)]
