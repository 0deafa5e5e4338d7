"""Clearances on a grid, and shortest paths over its cells."""

import heapq

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray, IntArray


@kernel
def lower_clearances(
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
def clearances(
    clearance_m: FloatArray, x0: float, y0: float, resolution_m: float, points: FloatArray
) -> FloatArray:
    values = np.empty(points.shape[0])
    for k in range(points.shape[0]):
        values[k] = clearance(clearance_m, x0, y0, resolution_m, points[k, 0], points[k, 1])
    return values


@kernel
def shortest_paths(
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
    path = np.full((rows, cols), -1, dtype=np.int64)
    cost = np.full((rows, cols), np.inf)
    is_settled = np.zeros((rows, cols), dtype=np.bool_)
    cost[goal_row, goal_col] = 0.0
    path[goal_row, goal_col] = goal_row * cols + goal_col
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
                    path[r, c] = here
                    heapq.heappush(queue, (here_cost + step, r * cols + c))
    for row in range(rows):
        for col in range(cols):
            if not is_settled[row, col]:
                path[row, col] = -1
    return path


@kernel
def descend(path: IntArray, row: int, col: int, n_steps: int) -> int:
    """Flat index of the cell `n_steps` further on the path; -1 where it is not known."""
    cols = path.shape[1]
    here = row * cols + col
    if path[row, col] < 0:
        return -1
    for _ in range(n_steps):
        here = int(path[here // cols, here % cols])
    return int(here)
