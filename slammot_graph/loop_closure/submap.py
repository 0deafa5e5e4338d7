"""A finished local map, as it is compared with others: points, normals, and a grid of agreement."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.checks import Checked, Count, Positive, Share
from slammot_graph.core.types import FloatArray
from slammot_graph.loop_closure import _kernels
from slammot_graph.mapping.local_map import Keyframe
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid


@dataclass(frozen=True, kw_only=True)
class SubmapConfig(Checked):
    """How a finished local map is prepared for the search.

    Attributes
    ----------
    cell_m : float
        Resolution of the score grid.
    n_levels : int
        Levels of its pyramid, each of half the resolution.
    occupied_score, neighbour_score, free_score : int
        What a point of another local map gains on a point, beside one, and in free space.
    max_free_probability : float
        Cells with a lower occupancy probability are free.
    point_spacing_m : float
        One point is kept for each square of this side.
    max_search_points : int
        The search is made with no more points than these.
    """

    cell_m: Positive = 0.1
    n_levels: Count = 5
    occupied_score: int = 4
    neighbour_score: int = 2
    free_score: int = -2
    max_free_probability: Share = 0.3
    point_spacing_m: Positive = 0.05
    max_search_points: Count = 400

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(
            self.free_score <= 0 <= self.neighbour_score <= self.occupied_score,
            "needs free_score <= 0 <= neighbour_score <= occupied_score",
        )


class Place(NamedTuple):
    """Where and when a local map was finished.

    Attributes
    ----------
    number : int
        Running number, in the order of finishing.
    anchor : int
        Node of its anchor.
    path_m : float
        Path length up to the middle keyframe.
    component : int
        Component of the graph, how often the robot had been lost before: of the motion between two nothing is known.
    """

    number: int
    anchor: int
    path_m: float
    component: int


@dataclass(frozen=True, eq=False)
class Submap:
    """Keyframes that are attached rigidly to the first of them, the anchor.

    Attributes
    ----------
    number, path_m, component
        As of its `Place`.
    keyframes : tuple of Keyframe
    config : SubmapConfig
    """

    number: int
    keyframes: tuple[Keyframe, ...]
    path_m: float
    component: int = 0
    config: SubmapConfig = SubmapConfig()

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
        """(m, 2) points and normals in the anchor's frame, one for each square of `point_spacing_m`."""
        points, normals = [], []
        for T, keyframe in zip(self.T_anchor_keyframes, self.keyframes, strict=True):
            points.append(se2.transform(T, keyframe.points_base))
            normals.append(keyframe.normals_base @ se2.rotation(T[2]).T)
        all_points, all_normals = np.vstack(points), np.vstack(normals)
        key = np.floor(all_points / self.config.point_spacing_m).astype(np.int64) @ np.array([1 << 24, 1])
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
        """(m, 2) points thinned to twice the search's cells, at most `max_search_points`."""
        points, _ = self.points_and_normals
        key = np.floor(points / (2 * self.config.cell_m)).astype(np.int64) @ np.array([1 << 24, 1])
        _, first = np.unique(key, return_index=True)
        first.sort()
        thinned = points[first]
        return thinned[:: max(1, -(-len(thinned) // self.config.max_search_points))]


class PreparedSubmap:
    """What it takes to find another submap in this one: a score pyramid and free space.

    Attributes
    ----------
    score : (rows, cols) int16 array
        What a point of another submap gains in a cell: most on a point, less beside one, a loss in free space.
    origin : (2,) array
        Lower left corner of the grids, anchor frame [m].
    pyramid : (levels, rows, cols) int16 array
    """

    def __init__(self, submap: Submap) -> None:
        self.submap = submap
        self.config = config = submap.config
        cell_m = config.cell_m
        grid = OccupancyGrid(GridConfig(resolution_m=cell_m))
        for number, (T, keyframe) in enumerate(
            zip(submap.T_anchor_keyframes[::2], submap.keyframes[::2], strict=True)
        ):
            ends = se2.transform(T, np.vstack([keyframe.laser_base, keyframe.points_base]))
            all_beams = np.ones(len(ends) - 1, dtype=np.bool_)
            grid.update(number, ends[0], ends[1:], all_beams, all_beams)
        margin = 1 << (config.n_levels - 1)
        seen = grid.to_map()
        points, _ = submap.points_and_normals
        # the search's bounds hold only if the margin holds no point, nor a cell beside one
        cells = np.floor((points - seen.origin) / cell_m).astype(np.int64)
        below = margin + 1 + np.maximum(-cells.min(axis=0), 0)
        above = margin + 1 + np.maximum(cells.max(axis=0) + 1 - np.array(seen.p_occupied.shape)[::-1], 0)
        pads = ((below[1], above[1]), (below[0], above[0]))
        p = np.pad(seen.p_occupied, pads, constant_values=np.nan)
        self.origin = seen.origin - below * cell_m
        is_point = np.zeros(p.shape, dtype=np.bool_)
        is_point[cells[:, 1] + below[1], cells[:, 0] + below[0]] = True
        from scipy.ndimage import maximum_filter

        is_beside = maximum_filter(is_point, size=3)
        with np.errstate(invalid="ignore"):
            is_free = p < config.max_free_probability
        self.is_free = is_free & ~is_beside
        self.score = np.zeros(p.shape, dtype=np.int16)
        self.score[self.is_free] = config.free_score
        self.score[is_beside] = config.neighbour_score
        self.score[is_point] = config.occupied_score
        self.pyramid = np.empty((config.n_levels, *p.shape), dtype=np.int16)
        self.pyramid[0] = self.score
        for level in range(1, config.n_levels):
            _kernels.max_pool(self.pyramid[level - 1], 1 << (level - 1), self.pyramid[level])

    def free_share(self, points: FloatArray) -> tuple[int, int]:
        """Count of (m, 2) points [m, anchor frame] that fall into free space, and of those on or beside points."""
        cells = np.floor((points - self.origin) / self.config.cell_m).astype(np.int64)
        rows, cols = self.is_free.shape
        inside = (cells >= 0).all(axis=1) & (cells[:, 0] < cols) & (cells[:, 1] < rows)
        i, j = cells[inside, 1], cells[inside, 0]
        return int(self.is_free[i, j].sum()), int((self.score[i, j] > 0).sum())
