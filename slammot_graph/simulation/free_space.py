"""Where people can walk: clearances on a grid, and shortest paths that keep off the walls."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.simulation import _path_kernels

MAX_CLEARANCE_M = 3.0
"""Clearances are cut off here: beyond it nothing is near."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeSpace:
    """Distance to the nearest obstacle at the centres of grid cells.

    Attributes
    ----------
    clearance_m : (rows, cols) array
        Distance from the cell's centre to the nearest obstacle [m], at most `MAX_CLEARANCE_M`.
    resolution_m : float
    origin : (2,) array
        Lower left corner of cell [0, 0] [m], world frame; row 0 has the lowest y.
    is_walkable : (rows, cols) bool array
        Cells that a person may stand in: clear by `person_radius_m` and connected with the robot's route.
    person_radius_m : float
        Clearance that a person's centre keeps [m].
    """

    clearance_m: FloatArray
    resolution_m: float
    origin: FloatArray
    is_walkable: BoolArray
    person_radius_m: float

    @cached_property
    def walkable_cells(self) -> IntArray:
        """(k, 2) row and column of every walkable cell."""
        return np.argwhere(self.is_walkable).astype(np.int64)

    @cached_property
    def walkable_points(self) -> FloatArray:
        """(k, 2) centres of the walkable cells [m]."""
        return self.origin + (self.walkable_cells[:, ::-1] + 0.5) * self.resolution_m

    def cell(self, point: npt.ArrayLike) -> tuple[int, int]:
        """Row and column of a point (2,) [m], held inside the grid."""
        x, y = (np.asarray(point, dtype=np.float64) - self.origin) / self.resolution_m
        rows, cols = self.clearance_m.shape
        return min(max(int(y), 0), rows - 1), min(max(int(x), 0), cols - 1)

    def clearance_at(self, points: FloatArray) -> FloatArray:
        """Clearance (...) [m] at points (..., 2) [m], bilinear; zero outside the grid."""
        flat = np.ascontiguousarray(np.reshape(points, (-1, 2)), dtype=np.float64)
        values = _path_kernels.clearances(
            self.clearance_m, self.origin[0], self.origin[1], self.resolution_m, flat
        )
        return values.reshape(np.shape(points)[:-1])

    def is_clear_line(self, start: FloatArray, end: FloatArray) -> bool:
        """Whether a person can walk straight from `start` to `end`, both (2,) [m]."""
        n_steps = max(2, int(np.hypot(*(end - start)) / (0.5 * self.resolution_m)) + 1)
        points = start + np.linspace(0.0, 1.0, n_steps)[:, None] * (end - start)
        return bool(np.all(self.clearance_at(points) >= self.person_radius_m))

    def path_to(self, goal: FloatArray, start: FloatArray) -> IntArray:
        """Shortest paths to a goal, from `start` and all cells that are nearer to the goal.

        Parameters
        ----------
        goal, start : (2,) arrays [m]
            Both taken to the nearest walkable cell.

        Returns
        -------
        (rows, cols) int array: flat index of the next cell on the path, the cell's own at the goal, -1 if unknown.
        """
        goal_row, goal_col = self.nearest_walkable_cell(goal)
        start_row, start_col = self.nearest_walkable_cell(start)
        return _path_kernels.shortest_paths(
            self.clearance_m, self.is_walkable, self.resolution_m, goal_row, goal_col, start_row, start_col
        )

    def nearest_walkable_cell(self, point: FloatArray) -> tuple[int, int]:
        """Row and column of the walkable cell nearest to a point (2,) [m]."""
        row, col = self.cell(point)
        if self.is_walkable[row, col]:
            return row, col
        nearest = self.walkable_cells[np.argmin(np.sum((self.walkable_points - point) ** 2, axis=1))]
        return int(nearest[0]), int(nearest[1])

    def ahead(self, path: IntArray, point: FloatArray, distance_m: float) -> FloatArray | None:
        """Point (2,) [m] that lies `distance_m` further on a path, or None where the path is not known."""
        row, col = self.nearest_walkable_cell(point)
        found = _path_kernels.descend(path, row, col, max(1, round(distance_m / self.resolution_m)))
        if found < 0:
            return None
        row, col = divmod(int(found), path.shape[1])
        return np.array(
            [
                self.origin[0] + (col + 0.5) * self.resolution_m,
                self.origin[1] + (row + 0.5) * self.resolution_m,
            ]
        )


def free_space_of_segments(
    segments: FloatArray, start: npt.ArrayLike, *, resolution_m: float = 0.1, person_radius_m: float = 0.33
) -> FreeSpace:
    """Free space of a world of line segments that is connected with `start`.

    Parameters
    ----------
    segments : (n, 4) array
        x1, y1, x2, y2 [m], world frame.
    start : (2,) array
        A point in the free space [m], such as the robot's first waypoint.
    resolution_m, person_radius_m : float

    Raises
    ------
    ConfigError
        `start` is nearer to a wall than `person_radius_m`.
    """
    lower = segments.reshape(-1, 2).min(axis=0) - 0.5
    upper = segments.reshape(-1, 2).max(axis=0) + 0.5
    cols, rows = np.ceil((upper - lower) / resolution_m).astype(int)
    clearance_m = np.full((rows, cols), MAX_CLEARANCE_M)
    _path_kernels.lower_clearances(
        clearance_m, lower[0], lower[1], resolution_m, np.ascontiguousarray(segments)
    )
    return connected_free_space(
        clearance_m, lower, np.atleast_2d(start), resolution_m=resolution_m, person_radius_m=person_radius_m
    )


def connected_free_space(
    clearance_m: FloatArray,
    origin: FloatArray,
    starts: FloatArray,
    *,
    resolution_m: float,
    person_radius_m: float,
) -> FreeSpace:
    """Free space made of the connected parts that hold one of `starts` ((k, 2) [m]).

    Raises
    ------
    ConfigError
        No start lies in cells that are clear by `person_radius_m`.
    """
    labels, _ = ndimage.label(clearance_m >= person_radius_m)
    rows, cols = clearance_m.shape
    indices = np.floor((starts - origin) / resolution_m).astype(int)
    indices = indices[(indices >= 0).all(axis=1) & (indices < (cols, rows)).all(axis=1)]
    found = np.unique(labels[indices[:, 1], indices[:, 0]])
    found = found[found > 0]
    if found.size == 0:
        raise ConfigError(
            f"no room for people: nowhere on the route is {person_radius_m} m clear of obstacles"
        )
    return FreeSpace(
        clearance_m=clearance_m,
        resolution_m=resolution_m,
        origin=np.asarray(origin, dtype=np.float64),
        is_walkable=np.isin(labels, found),
        person_radius_m=person_radius_m,
    )
