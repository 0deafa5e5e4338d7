"""Where people can walk: clearances on a grid, and shortest paths that keep off the walls."""

import heapq
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from slammot_graph.core._numba import kernel
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import BoolArray, FloatArray, IntArray

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
        values = _clearances(self.clearance_m, self.origin[0], self.origin[1], self.resolution_m, flat)
        return values.reshape(np.shape(points)[:-1])

    def is_clear_line(self, start: FloatArray, end: FloatArray) -> bool:
        """Whether a person can walk straight from `start` to `end`, both (2,) [m]."""
        n_steps = max(2, int(np.hypot(*(end - start)) / (0.5 * self.resolution_m)) + 1)
        points = start + np.linspace(0.0, 1.0, n_steps)[:, None] * (end - start)
        return bool(np.all(self.clearance_at(points) >= self.person_radius_m))

    def way_to(self, goal: FloatArray, start: FloatArray) -> IntArray:
        """Shortest ways to a goal, from `start` and all cells that are nearer to the goal.

        Parameters
        ----------
        goal, start : (2,) arrays [m]
            Both taken to the nearest walkable cell.

        Returns
        -------
        (rows, cols) int array: flat index of the next cell on the way, the cell's own at the goal, -1 if unknown.
        """
        goal_row, goal_col = self.nearest_walkable_cell(goal)
        start_row, start_col = self.nearest_walkable_cell(start)
        return _shortest_ways(
            self.clearance_m, self.is_walkable, self.resolution_m, goal_row, goal_col, start_row, start_col
        )

    def nearest_walkable_cell(self, point: FloatArray) -> tuple[int, int]:
        """Row and column of the walkable cell nearest to a point (2,) [m]."""
        row, col = self.cell(point)
        if self.is_walkable[row, col]:
            return row, col
        nearest = self.walkable_cells[np.argmin(np.sum((self.walkable_points - point) ** 2, axis=1))]
        return int(nearest[0]), int(nearest[1])

    def ahead(self, way: IntArray, point: FloatArray, distance_m: float) -> FloatArray | None:
        """Point (2,) [m] that lies `distance_m` further on a way, or None where the way is not known."""
        row, col = self.nearest_walkable_cell(point)
        found = _descend(way, row, col, max(1, round(distance_m / self.resolution_m)))
        if found < 0:
            return None
        row, col = divmod(int(found), way.shape[1])
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
        A point in the free space [m], such as the robot's first way point.
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
    _lower_clearances(clearance_m, lower[0], lower[1], resolution_m, np.ascontiguousarray(segments))
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


@kernel
def _lower_clearances(
    clearance_m: FloatArray, x0: float, y0: float, resolution_m: float, segments: FloatArray
) -> None:
    """Lower each cell to its exact distance from the nearest segment, in place."""
    rows, cols = clearance_m.shape
    reach = clearance_m.max()
    for k in range(segments.shape[0]):
        ax, ay, bx, by = segments[k, 0], segments[k, 1], segments[k, 2], segments[k, 3]
        dx, dy = bx - ax, by - ay
        length2 = dx * dx + dy * dy
        row_0 = max(0, int((min(ay, by) - reach - y0) / resolution_m))
        row_1 = min(rows, int((max(ay, by) + reach - y0) / resolution_m) + 1)
        col_0 = max(0, int((min(ax, bx) - reach - x0) / resolution_m))
        col_1 = min(cols, int((max(ax, bx) + reach - x0) / resolution_m) + 1)
        for row in range(row_0, row_1):
            y = y0 + (row + 0.5) * resolution_m
            for col in range(col_0, col_1):
                x = x0 + (col + 0.5) * resolution_m
                t = 0.0
                if length2 > 0.0:
                    t = min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / length2))
                ex, ey = ax + t * dx - x, ay + t * dy - y
                distance = np.sqrt(ex * ex + ey * ey)
                clearance_m[row, col] = min(clearance_m[row, col], distance)


@kernel
def clearance(
    clearance_m: FloatArray, x0: float, y0: float, resolution_m: float, x: float, y: float
) -> float:
    """Clearance [m] at one point, bilinear between cell centres; zero outside the grid."""
    rows, cols = clearance_m.shape
    u = (x - x0) / resolution_m - 0.5
    v = (y - y0) / resolution_m - 0.5
    if not (0.0 <= u < cols - 1 and 0.0 <= v < rows - 1):
        return 0.0
    col, row = int(u), int(v)
    u -= col
    v -= row
    low = (1.0 - u) * clearance_m[row, col] + u * clearance_m[row, col + 1]
    high = (1.0 - u) * clearance_m[row + 1, col] + u * clearance_m[row + 1, col + 1]
    return float((1.0 - v) * low + v * high)


@kernel
def _clearances(
    clearance_m: FloatArray, x0: float, y0: float, resolution_m: float, points: FloatArray
) -> FloatArray:
    values = np.empty(points.shape[0])
    for k in range(points.shape[0]):
        values[k] = clearance(clearance_m, x0, y0, resolution_m, points[k, 0], points[k, 1])
    return values


@kernel
def _shortest_ways(
    clearance_m: FloatArray,
    is_walkable: BoolArray,
    resolution_m: float,
    goal_row: int,
    goal_col: int,
    start_row: int,
    start_col: int,
) -> IntArray:
    """Dijkstra from the goal until the start and 3 m beyond are settled; steps near walls cost more."""
    rows, cols = is_walkable.shape
    way = np.full((rows, cols), -1, dtype=np.int64)
    cost = np.full((rows, cols), np.inf)
    is_settled = np.zeros((rows, cols), dtype=np.bool_)
    cost[goal_row, goal_col] = 0.0
    way[goal_row, goal_col] = goal_row * cols + goal_col
    queue = [(0.0, goal_row * cols + goal_col)]
    limit = np.inf
    while len(queue) > 0:
        here_cost, here = heapq.heappop(queue)
        row, col = here // cols, here % cols
        if is_settled[row, col]:
            continue
        if here_cost > limit:
            break
        is_settled[row, col] = True
        if row == start_row and col == start_col:
            limit = here_cost + 3.0
        for d_row in range(-1, 2):
            for d_col in range(-1, 2):
                if d_row == 0 and d_col == 0:
                    continue
                r, c = row + d_row, col + d_col
                if r < 0 or r >= rows or c < 0 or c >= cols or not is_walkable[r, c] or is_settled[r, c]:
                    continue
                if not (is_walkable[row, c] and is_walkable[r, col]):
                    continue
                step = resolution_m * np.sqrt(float(d_row * d_row + d_col * d_col))
                step *= 1.0 + 1.5 * max(0.0, 0.8 - clearance_m[r, c])
                if here_cost + step < cost[r, c]:
                    cost[r, c] = here_cost + step
                    way[r, c] = here
                    heapq.heappush(queue, (here_cost + step, r * cols + c))
    for row in range(rows):
        for col in range(cols):
            if not is_settled[row, col]:
                way[row, col] = -1
    return way


@kernel
def _descend(way: IntArray, row: int, col: int, n_steps: int) -> int:
    """Flat index of the cell `n_steps` further on the way; -1 where it is not known."""
    cols = way.shape[1]
    here = row * cols + col
    if way[row, col] < 0:
        return -1
    for _ in range(n_steps):
        here = int(way[here // cols, here % cols])
    return int(here)
