"""A finished local map, as it is compared with others: points, normals, and a grid of agreement."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.loop_closure import _kernels
from slammot_graph.mapping.local_map import Keyframe
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid

CELL_M = 0.1
N_LEVELS = 5
OCCUPIED_SCORE, NEIGHBOUR_SCORE, FREE_SCORE = 4, 2, -2
_GRID = GridConfig(resolution_m=CELL_M)


class Place(NamedTuple):
    """Where and when a local map was finished.

    Attributes
    ----------
    number : int
        Running number, in the order of finishing.
    anchor : int
        Node of its anchor.
    path_m : float
        Way driven up to the middle keyframe.
    component : int
        How often the robot had been lost before: of the way between two pieces nothing is known.
    """

    number: int
    anchor: int
    path_m: float
    component: int


@dataclass(frozen=True, eq=False)
class Submap:
    """Keyframes that hang rigidly on the first of them, the anchor.

    Attributes
    ----------
    number, path_m, component
        As of its `Place`.
    keyframes : tuple of Keyframe
    """

    number: int
    keyframes: tuple[Keyframe, ...]
    path_m: float
    component: int = 0

    @property
    def place(self) -> Place:
        """Where and when, without the keyframes."""
        return Place(self.number, self.anchor, self.path_m, self.component)

    @property
    def anchor(self) -> int:
        """Node of the anchor."""
        return self.keyframes[0].node

    @cached_property
    def T_anchor_keyframes(self) -> FloatArray:
        """(k, 3) poses of the keyframes in the anchor's frame."""
        T_local = np.array([keyframe.T_local_base for keyframe in self.keyframes])
        return se2.between(T_local[:1], T_local)

    @cached_property
    def centre(self) -> FloatArray:
        """(2,) mean place of the robot, anchor frame [m]."""
        return np.asarray(self.T_anchor_keyframes[:, :2].mean(axis=0))

    @cached_property
    def points_and_normals(self) -> tuple[FloatArray, FloatArray]:
        """(m, 2) points and normals in the anchor's frame, one for each 5 cm."""
        points, normals = [], []
        for T, keyframe in zip(self.T_anchor_keyframes, self.keyframes, strict=True):
            points.append(se2.transform(T, keyframe.points_base))
            normals.append(keyframe.normals_base @ se2.rotation(T[2]).T)
        all_points, all_normals = np.vstack(points), np.vstack(normals)
        key = np.floor(all_points / 0.05).astype(np.int64) @ np.array([1 << 24, 1])
        _, first = np.unique(key, return_index=True)
        first.sort()
        return all_points[first], all_normals[first]

    def as_keyframe(self) -> Keyframe:
        """Give all its points as one keyframe, with the anchor at the origin of the local frame."""
        points, normals = self.points_and_normals
        return Keyframe(
            node=self.anchor,
            T_local_base=se2.IDENTITY,
            points_base=points,
            normals_base=normals,
            laser_base=self.keyframes[0].laser_base,
        )

    @cached_property
    def search_points(self) -> FloatArray:
        """(m, 2) points thinned to the search's cells, at most 400."""
        points, _ = self.points_and_normals
        key = np.floor(points / (2 * CELL_M)).astype(np.int64) @ np.array([1 << 24, 1])
        _, first = np.unique(key, return_index=True)
        first.sort()
        thinned = points[first]
        return thinned[:: max(1, -(-len(thinned) // 400))]


class PreparedSubmap:
    """What it takes to find another submap in this one: a score pyramid and free space.

    Attributes
    ----------
    score : (rows, cols) int16 array
        What a point of another submap gains in a cell: most on a point, half beside one, a loss in free space.
    origin : (2,) array
        Lower left corner of the grids, anchor frame [m].
    pyramid : (levels, rows, cols) int16 array
    """

    def __init__(self, submap: Submap) -> None:
        self.submap = submap
        grid = OccupancyGrid(_GRID)
        for number, (T, keyframe) in enumerate(
            zip(submap.T_anchor_keyframes[::2], submap.keyframes[::2], strict=True)
        ):
            ends = se2.transform(T, np.vstack([keyframe.laser_base, keyframe.points_base]))
            all_beams = np.ones(len(ends) - 1, dtype=np.bool_)
            grid.update(number, ends[0], ends[1:], all_beams, all_beams)
        margin = 1 << (N_LEVELS - 1)
        seen = grid.to_map()
        points, _ = submap.points_and_normals
        # the search's bounds hold only if the margin holds no point, nor a cell beside one
        cells = np.floor((points - seen.origin) / CELL_M).astype(np.int64)
        below = margin + 1 + np.maximum(-cells.min(axis=0), 0)
        above = margin + 1 + np.maximum(cells.max(axis=0) + 1 - np.array(seen.p_occupied.shape)[::-1], 0)
        pads = ((below[1], above[1]), (below[0], above[0]))
        p = np.pad(seen.p_occupied, pads, constant_values=np.nan)
        self.origin = seen.origin - below * CELL_M
        is_point = np.zeros(p.shape, dtype=np.bool_)
        is_point[cells[:, 1] + below[1], cells[:, 0] + below[0]] = True
        from scipy.ndimage import maximum_filter

        is_beside = maximum_filter(is_point, size=3)
        with np.errstate(invalid="ignore"):
            is_free = p < 0.3
        self.is_free = is_free & ~is_beside
        self.score = np.zeros(p.shape, dtype=np.int16)
        self.score[self.is_free] = FREE_SCORE
        self.score[is_beside] = NEIGHBOUR_SCORE
        self.score[is_point] = OCCUPIED_SCORE
        self.pyramid = np.empty((N_LEVELS, *p.shape), dtype=np.int16)
        self.pyramid[0] = self.score
        for level in range(1, N_LEVELS):
            _kernels.max_pool(self.pyramid[level - 1], 1 << (level - 1), self.pyramid[level])

    def free_share(self, points: FloatArray) -> tuple[int, int]:
        """Count of (m, 2) points [m, anchor frame] that fall into free space, and of those on or beside points."""
        cells = np.floor((points - self.origin) / CELL_M).astype(np.int64)
        rows, cols = self.is_free.shape
        inside = (cells >= 0).all(axis=1) & (cells[:, 0] < cols) & (cells[:, 1] < rows)
        i, j = cells[inside, 1], cells[inside, 0]
        return int(self.is_free[i, j].sum()), int((self.score[i, j] > 0).sum())
